"""``s2r check``: certify the worst expected robustness in simulation."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console

from s2r_spec.cli.common import interrupted, new_or_old, pool, seconds, sentences
from s2r_spec.cli.options import (
    Columns,
    Nan,
    Quiet,
    Resume,
    Run,
    Scheduler,
    Seed,
    SpecFile,
    Timeout,
    TimeUnit,
    Workers,
    logs,
)
from s2r_spec.cli.output import AsJson, Format, Output, Page, emit, pageable, save, settle


def check(
    spec: SpecFile,
    backend: Annotated[
        str, typer.Option("--backend", "-b", help="What makes the traces; see `s2r backends`.")
    ] = "sim",
    requirement: Annotated[
        list[str] | None,
        typer.Option("--requirement", "-r", help="Check only this requirement (may be repeated)."),
    ] = None,
    seed: Seed = 0,
    budget: Annotated[
        int | None, typer.Option(min=1, help="Most rollouts per requirement; without it, as many as ε takes.")
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    timeout: Timeout = None,
    mode: Annotated[
        str, typer.Option(help="Confidence set: rigorous, rigorous-simple or paper.")
    ] = "rigorous",
    engine: Annotated[str, typer.Option(help="Gaussian process: spectral or gpytorch.")] = "spectral",
    nan: Nan = None,
    time_unit: TimeUnit = None,
    columns: Columns = None,
    run: Run = None,
    resume: Resume = None,
    as_json: AsJson = False,
    form: Format = None,
    output: Output = None,
    page: Page = None,
    quiet: Quiet = False,
) -> None:
    """Certify the worst expected robustness over the spec's test space, with its probability."""
    from s2r_spec.errors import UsageError

    with sentences(as_json or form == "json"):
        # Imported here: the help must not wait for numerical libraries.
        from s2r_spec.certify import check as checking
        from s2r_spec.cli.progress import Live
        from s2r_spec.report import checked, html
        from s2r_spec.spec import load_spec

        form = settle(form, as_json, output)
        pageable(page)
        parsed = load_spec(spec)
        names = requirement or [name for name in parsed.requirements if name in parsed.certify]
        if not names:
            raise UsageError(f"{parsed.name} has no certify line, so there is nothing to certify")
        names = list(dict.fromkeys(names))
        for name in names:  # a wrong one is said before the first one has run
            checking.search_for(parsed, name, seed=seed, budget=budget, mode=mode, engine=engine)
        (machine,) = logs([backend], nan, time_unit, columns)
        executor, machines = pool(workers, scheduler)
        folder = new_or_old(run, resume, f"{spec.stem}-{backend}", seed)
        errors = Console(stderr=True, highlight=False)
        results = []
        for name in names:
            place = folder / name
            if not quiet:
                errors.print(f"{name}: run {place}, seed {seed}, {machines}", markup=False, soft_wrap=True)
            try:
                with Live(errors, quiet) as live:
                    results.append(
                        checking.check(
                            parsed,
                            machine,
                            place,
                            requirement=name,
                            seed=seed,
                            budget=budget,
                            mode=mode,
                            engine=engine,
                            executor=executor,
                            timeout=seconds(timeout),
                            resume=resume is not None,
                            observer=live,
                        )
                    )
            except KeyboardInterrupt:
                interrupted(folder)
                raise
        report = checked.report([(parsed, result) for result in results])
        emit(report, form, output)
        if page is not None:
            save(html.from_runs([result.folder for result in results]), page)
        raise typer.Exit(report.exit_code)
