"""Options, run and report that the commands ``gap`` and ``certify`` share: they compare simulator and machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import typer

from s2r_spec.cli.options.groups import group_options
from s2r_spec.cli.options.logs import LogReading
from s2r_spec.cli.options.output import Writing
from s2r_spec.cli.options.search import (
    OneRequirement,
    RealBudget,
    RealMachine,
    Rules,
    Running,
    Simulator,
    SpecFile,
)
from s2r_spec.cli.terminal.common import begin_run, refuse_without_operator, resumable, sentences
from s2r_spec.cli.terminal.terminal import console


@dataclass(frozen=True)
class SearchOptions:
    """The search that a command runs, and its reports.

    Attributes:
        run: the search, a function of the library.
        report: a function that makes a report from the spec and the result.
        page: a function that makes the run for the HTML page, from the run's folder and the machine's name.
        places: folders of journals in a run's folder; one exists as soon as the run has begun.
        journals: folders of all journals.
    """

    run: Callable[..., Any]
    report: Callable[..., Any]
    page: Callable[[Path, str], Any]
    places: tuple[str, ...]
    journals: tuple[str, ...]


def against(prefix: str, help_: str, search: Callable[[], SearchOptions]) -> Callable[..., None]:
    """Return a command: ``prefix`` begins the name of its runs' folders; ``search`` is loaded when it is called."""

    def command(
        spec: SpecFile,
        real: RealMachine,
        sim: Simulator = "sim",
        requirement: OneRequirement = None,
        budget: RealBudget = None,
        *,
        rules: Rules,
        reading: LogReading,
        running: Running,
        writing: Writing,
    ) -> None:
        with sentences(writing.json):
            refuse_without_operator(real)
            from s2r_spec.report import html
            from s2r_spec.spec import load_spec

            chosen, form, parsed = search(), writing.settled(), load_spec(spec)
            compared = [requirement] if requirement else list(parsed.requirements)
            simulator, machine = reading.backends([sim, real], parsed, compared)
            run = _begin_search(chosen, f"{prefix}{spec.stem}-{sim}-{real}", rules, running, machine)
            with resumable(run.folder), run.live(running.quiet) as live:
                options = {"requirement": requirement, "budget": budget, "observer": live, **run.options}
                result = chosen.run(parsed, simulator, machine, run.folder, **options)
            report = chosen.report(parsed, result)
            writing.emit(report, form, lambda: html.render([chosen.page(run.folder, machine)]))
            raise typer.Exit(report.exit_code)

    command.__doc__ = help_
    return group_options(command)


@dataclass(frozen=True)
class _Begun:
    folder: Path
    opening: str
    options: dict[str, Any]

    def live(self, quiet: bool) -> Any:
        """Return the view of the search's progress."""
        from s2r_spec.cli.terminal.progress import Live

        return Live(console(stderr=True), quiet, opening=self.opening)


def _begin_search(search: SearchOptions, name: str, rules: Rules, running: Running, machine: str) -> _Begun:
    """Return the folder of a run, new or resumed, and the options of its search."""
    from s2r_spec.certify.options import seed_of
    from s2r_spec.runs.journal import Journal
    from s2r_spec.runs.layout import with_any

    resume = running.resume
    if resume is not None:
        resume = with_any(resume, search.places, Journal.exists)
        running = replace(running, resume=resume)
    seed = seed_of(rules.seed, *([] if resume is None else [resume / place for place in search.journals]))
    executor, folder, opening = begin_run(running, name, seed, machine)
    options = {
        "seed": seed,
        "stop": rules.stop,
        "executor": executor,
        "timeout": rules.limit,
        "resume": resume is not None,
        "void": rules.void,
    }
    return _Begun(folder, opening, options)
