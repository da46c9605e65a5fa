"""Options, run and report that the commands ``gap`` and ``certify`` share: they compare simulator and machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Annotated, Any

import typer

from s2r_spec.cli.options.groups import group_options, search_option
from s2r_spec.cli.options.logs import LogReading
from s2r_spec.cli.options.output import Writing
from s2r_spec.cli.options.search import Compared, Rules, Running, SpecFile
from s2r_spec.cli.terminal.common import begin_run, refuse_without_operator, resumable, sentences
from s2r_spec.cli.terminal.terminal import console

RealBudget = Annotated[
    int | None, search_option(min=1, help="Most real rollouts.", show_default="until the interval is ε wide")
]
Search = tuple[Callable[..., Any], Sequence[str], Sequence[str]]
"""A search of the library, the folders of which one has a journal as soon as a run has begun, and the folders of all
journals."""


def against(prefix: str, help_: str, search: Callable[[], Search]) -> Callable[..., None]:
    """Return a command: ``prefix`` begins the name of its runs' folders; ``search`` is loaded when it is called."""

    def command(
        spec: SpecFile,
        *,
        compared: Compared,
        budget: RealBudget = None,
        rules: Rules,
        reading: LogReading,
        running: Running,
        writing: Writing,
    ) -> None:
        with sentences(writing.json):
            refuse_without_operator(compared.real)
            from s2r_spec.certify.options import seed_of
            from s2r_spec.cli.terminal.progress import Live
            from s2r_spec.report.certify import report_of
            from s2r_spec.runs.journal import Journal
            from s2r_spec.runs.layout import with_any
            from s2r_spec.spec import load_spec

            (run, places, journals), form, parsed = search(), writing.settled(), load_spec(spec)
            names = [compared.sim, compared.real]
            simulator, machine = reading.backends(names, parsed, compared.requirements(parsed))
            if (resume := running.resume) is not None:
                resume = with_any(resume, places, Journal.exists)
                running = replace(running, resume=resume)
            seed = seed_of(rules.seed, *(resume / place for place in journals if resume is not None))
            name = "-".join([f"{prefix}{spec.stem}", *names])
            executor, folder, opening = begin_run(running, name, seed, machine)
            with resumable(folder), Live(console(stderr=True), running.quiet, opening=opening) as live:
                result = run(
                    parsed,
                    simulator,
                    machine,
                    folder,
                    requirement=compared.requirement,
                    budget=budget,
                    observer=live,
                    seed=seed,
                    stop=rules.stop,
                    executor=executor,
                    timeout=rules.limit,
                    resume=resume is not None,
                    void=rules.void,
                )
            report = report_of([result])
            writing.emit(report, form, [result])
            raise typer.Exit(report.exit_code)

    command.__doc__ = help_
    return group_options(command)
