"""``s2r check``: certify the worst expected robustness in simulation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.cli.common import (
    interrupted,
    new_or_old,
    pool,
    refuse_without_operator,
    seconds,
    sentences,
    takes_turns,
)
from s2r_spec.cli.log_options import LogReading, reads_logs
from s2r_spec.cli.options import (
    Quiet,
    Resume,
    Run,
    Scheduler,
    Seed,
    SpecFile,
    Stop,
    Timeout,
    Void,
    Workers,
)
from s2r_spec.cli.output import AsJson, Format, Output, Page, emit, pageable, settle
from s2r_spec.cli.terminal import console
from s2r_spec.files import save


@reads_logs
def check(
    spec: SpecFile,
    backend: Annotated[
        str,
        typer.Option(
            "--backend",
            "-b",
            help="Simulator, machine or folder of logs that gives the traces; see `s2r backends`.",
        ),
    ] = "sim",
    requirement: Annotated[
        list[str] | None,
        typer.Option(
            "--requirement",
            "-r",
            help="Requirement to check; may be repeated.",
            show_default="all with a certify line",
        ),
    ] = None,
    seed: Seed = None,
    budget: Annotated[
        int | None,
        typer.Option(
            min=1, help="Most rollouts for each requirement.", show_default="until the interval is ε wide"
        ),
    ] = None,
    stop: Stop = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    timeout: Timeout = None,
    void: Void = "again",
    mode: Annotated[
        str, typer.Option(help="Method of the bound: rigorous, rigorous-simple or paper.")
    ] = "rigorous",
    engine: Annotated[
        str, typer.Option(help="Implementation of the Gaussian process: spectral or gpytorch.")
    ] = "spectral",
    *,
    reading: LogReading,
    run: Run = None,
    resume: Resume = None,
    as_json: AsJson = False,
    form: Format = None,
    output: Output = None,
    page: Page = None,
    quiet: Quiet = False,
) -> None:
    """Certify the worst expected robustness in simulation, over the spec's test space."""
    from s2r_spec.errors import UsageError

    with sentences(as_json or form == "json"):
        refuse_without_operator(backend)
        # Imported here, so that the help does not wait for numerical libraries.
        from s2r_spec.certify import check as checking
        from s2r_spec.certify.arguments import require_begun
        from s2r_spec.certify.from_spec import search_for
        from s2r_spec.certify.options import RunOptions
        from s2r_spec.certify.resumed_options import seed_of
        from s2r_spec.cli.progress import Live
        from s2r_spec.report import checked, html
        from s2r_spec.rollouts import layout
        from s2r_spec.rollouts.journal import Journal
        from s2r_spec.spec import load_spec

        form = settle(form, as_json, output)
        pageable(page)
        parsed = load_spec(spec)
        names = requirement or [name for name in parsed.requirements if name in parsed.certify]
        if not names:
            raise UsageError(f"{parsed.name} has no certify line, so there is nothing to certify")
        names = list(dict.fromkeys(names))
        for name in names:  # report a wrong name before anything runs
            search_for(
                parsed,
                name,
                RunOptions(seed=seed, budget=budget, stop=stop, mode=mode, engine=engine, void=void),
            )
        (machine,) = reading.backends([backend], parsed, names)
        executor, machines = pool(workers, scheduler)
        if takes_turns(machine):
            machines = "one rollout at a time"
        folder = new_or_old(run, resume, f"{spec.stem}-{backend}", seed or 0)
        places = layout.places(folder, names, _own(folder, names) if resume is not None else None)
        if resume is not None:
            require_begun([*places.values()], folder)
        seed = seed_of(seed, *(places.values() if resume is not None else ()))
        errors = console(stderr=True)
        results = []
        for name, place in places.items():
            opening = f"{name}: run {place}, seed {seed}, {machines}"
            try:
                with Live(errors, quiet, opening=opening) as live:
                    results.append(
                        checking.check(
                            parsed,
                            machine,
                            place,
                            requirement=name,
                            seed=seed,
                            budget=budget,
                            stop=stop,
                            mode=mode,
                            engine=engine,
                            executor=executor,
                            timeout=seconds(timeout),
                            # In an interrupted run the next requirement may not have begun.
                            resume=resume is not None and Journal.exists(place),
                            observer=live,
                            void=void,
                        )
                    )
            except KeyboardInterrupt:
                interrupted(layout.run_of(place, {"requirement": name}))
                raise
        report = checked.report([(parsed, result) for result in results])
        emit(report, form, output)
        if page is not None:
            save(page, html.from_runs([result.folder for result in results]))
        raise typer.Exit(report.exit_code)


def _own(folder: Path, names: Sequence[str]) -> str | None:
    """Return the requirement whose journal lies directly in a folder; None if the folder holds a whole run.

    Raises:
        UsageError: the journal is not of a requirement in ``names``.
    """
    from s2r_spec.errors import UsageError, one_of
    from s2r_spec.rollouts.journal import Journal

    header = Journal.header_in(folder)
    own = header.get("requirement")
    if header and (own not in names or "side" in header):
        of = f"of the requirement {own!r}" if own not in names else "a part of a gap"
        raise UsageError(
            f"the run in {folder} is {of}, but this command checks {one_of(names)}; begin a new run with --run"
        )
    return own
