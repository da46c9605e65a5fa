"""``s2r check``: certify the worst expected robustness in simulation."""

from __future__ import annotations

import typer

from s2r_spec.cli.options.groups import group_options, options, search_option
from s2r_spec.cli.options.logs import LogReading
from s2r_spec.cli.options.output import Writing
from s2r_spec.cli.options.search import Mode, Rules, Running, SpecFile
from s2r_spec.cli.terminal.common import (
    new_or_old,
    pool,
    print_preflight,
    refuse_without_operator,
    resumable,
    sentences,
    takes_turns,
)
from s2r_spec.cli.terminal.terminal import console


@options
class Checked:
    """What is checked, and by which method; each field is an option."""

    backend: str = typer.Option(
        "sim",
        "--backend",
        "-b",
        help="Simulator, machine, folder of logs or PATH.py:NAME that gives the traces; see `s2r backends`.",
    )
    requirement: list[str] | None = typer.Option(
        None,
        "--requirement",
        "-r",
        help="Requirement to check; may be repeated.",
        show_default="all with a certify line",
    )
    budget: int | None = search_option(
        None, min=1, help="Most rollouts for each requirement.", show_default="until --stop"
    )
    mode: Mode = "rigorous"
    engine: str = search_option(
        "spectral", help="Implementation of the Gaussian process: spectral or gpytorch."
    )


@group_options
def check(
    spec: SpecFile,
    *,
    checked: Checked,
    rules: Rules,
    reading: LogReading,
    running: Running,
    writing: Writing,
) -> None:
    """Certify the worst expected robustness in simulation, over the spec's test space."""
    with sentences(writing.json):
        backend = checked.backend
        refuse_without_operator(backend)
        # Imported here, so that the help does not wait for numerical libraries.
        from s2r_spec.certify import check as checking
        from s2r_spec.certify.from_spec import certified_requirements
        from s2r_spec.certify.options import RunKeywords, RunOptions, places_of, seed_of
        from s2r_spec.cli.terminal.progress import Live
        from s2r_spec.report import check as check_report
        from s2r_spec.runs.journal import Journal
        from s2r_spec.runs.layout import run_of
        from s2r_spec.spec import load_spec

        form, parsed, resume = writing.settled(), load_spec(spec), running.resume is not None
        keywords: RunKeywords = {
            "seed": rules.seed,
            "budget": checked.budget,
            "stop": rules.stop,
            "mode": checked.mode,
            "engine": checked.engine,
            "void": rules.void,
        }
        names = certified_requirements(parsed, checked.requirement, RunOptions(**keywords))
        (machine,) = reading.backends([backend], parsed, names)
        print_preflight(machine, running.quiet)
        executor, machines = pool(running.workers, running.scheduler)
        if takes_turns(machine):
            machines = "one rollout at a time"
        folder = new_or_old(running.run, running.resume, f"{spec.stem}-{backend}", rules.seed or 0)
        places = places_of(folder, names, resume)
        seed = seed_of(rules.seed, *(places.values() if resume else ()))
        keywords |= {"seed": seed, "executor": executor, "timeout": rules.limit}
        results = []
        for name, place in places.items():
            opening = f"{name}: run {place}, seed {seed}, {machines}"
            with (
                resumable(run_of(place, {"requirement": name})),
                Live(console(stderr=True), running.quiet, opening=opening) as live,
            ):
                # In an interrupted run the next requirement may not have begun.
                begun = resume and Journal.exists(place)
                keywords |= {"requirement": name, "resume": begun, "observer": live}
                results.append(checking.check(parsed, machine, place, **keywords))
        report = check_report.report([(parsed, result) for result in results])
        writing.emit(report, form, results)
        raise typer.Exit(report.exit_code)
