"""``s2r check``: certify the worst expected robustness in simulation."""

from __future__ import annotations

import typer

from s2r_spec.cli.options.groups import group_options
from s2r_spec.cli.options.logs import LogReading
from s2r_spec.cli.options.output import Writing
from s2r_spec.cli.options.search import (
    CheckBudget,
    CheckedRequirements,
    Engine,
    Mode,
    Rules,
    Running,
    SpecFile,
    Traces,
)
from s2r_spec.cli.terminal.common import (
    new_or_old,
    pool,
    refuse_without_operator,
    resumable,
    sentences,
    takes_turns,
)
from s2r_spec.cli.terminal.terminal import console


@group_options
def check(
    spec: SpecFile,
    backend: Traces = "sim",
    requirement: CheckedRequirements = None,
    budget: CheckBudget = None,
    mode: Mode = "rigorous",
    engine: Engine = "spectral",
    *,
    rules: Rules,
    reading: LogReading,
    running: Running,
    writing: Writing,
) -> None:
    """Certify the worst expected robustness in simulation, over the spec's test space."""
    with sentences(writing.json):
        refuse_without_operator(backend)
        # Imported here, so that the help does not wait for numerical libraries.
        from s2r_spec.certify import check as checking
        from s2r_spec.certify.from_spec import certified_requirements
        from s2r_spec.certify.options import RunKeywords, RunOptions
        from s2r_spec.certify.resumed_options import places_of, seed_of
        from s2r_spec.cli.terminal.progress import Live
        from s2r_spec.report import check as check_report
        from s2r_spec.runs.journal import Journal
        from s2r_spec.runs.layout import run_of
        from s2r_spec.spec import load_spec

        form, parsed, resume = writing.settled(), load_spec(spec), running.resume is not None
        options: RunKeywords = {
            "seed": rules.seed,
            "budget": budget,
            "stop": rules.stop,
            "mode": mode,
            "engine": engine,
            "void": rules.void,
        }
        names = certified_requirements(parsed, requirement, RunOptions(**options))
        (machine,) = reading.backends([backend], parsed, names)
        executor, machines = pool(running.workers, running.scheduler)
        if takes_turns(machine):
            machines = "one rollout at a time"
        folder = new_or_old(running.run, running.resume, f"{spec.stem}-{backend}", rules.seed or 0)
        places = places_of(folder, names, resume)
        seed = seed_of(rules.seed, *(places.values() if resume else ()))
        options |= {"seed": seed, "executor": executor, "timeout": rules.limit}
        results = []
        for name, place in places.items():
            opening = f"{name}: run {place}, seed {seed}, {machines}"
            with (
                resumable(run_of(place, {"requirement": name})),
                Live(console(stderr=True), running.quiet, opening=opening) as live,
            ):
                # In an interrupted run the next requirement may not have begun.
                begun = resume and Journal.exists(place)
                options |= {"requirement": name, "resume": begun, "observer": live}
                results.append(checking.check(parsed, machine, place, **options))
        report = check_report.report([(parsed, result) for result in results])
        writing.emit(report, form, results)
        raise typer.Exit(report.exit_code)
