"""Options, run and report that the commands ``gap`` and ``certify`` share: they compare simulator and machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from s2r_spec.cli.common import begun, interrupted, refuse_without_operator, seconds, sentences
from s2r_spec.cli.log_options import LogReading, reads_logs
from s2r_spec.cli.options import (
    OneRequirement,
    Quiet,
    RealBudget,
    RealMachine,
    Resume,
    Run,
    Scheduler,
    Seed,
    Simulator,
    SpecFile,
    Stop,
    Timeout,
    Void,
    Workers,
)
from s2r_spec.cli.output import AsJson, Format, Output, Page, emit, pageable, settle
from s2r_spec.cli.terminal import console
from s2r_spec.files import save


@dataclass(frozen=True)
class Search:
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


def against(prefix: str, help_: str, search: Callable[[], Search]) -> Callable[..., None]:
    """Return a command: ``prefix`` begins the name of its runs' folders; ``search`` is loaded when it is called."""

    @reads_logs
    def command(
        spec: SpecFile,
        real: RealMachine,
        sim: Simulator = "sim",
        requirement: OneRequirement = None,
        seed: Seed = None,
        budget: RealBudget = None,
        stop: Stop = None,
        workers: Workers = None,
        scheduler: Scheduler = None,
        timeout: Timeout = None,
        void: Void = "again",
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
        with sentences(as_json or form == "json"):
            refuse_without_operator(real)
            from s2r_spec.certify.resumed_options import seed_of
            from s2r_spec.cli.progress import Live
            from s2r_spec.report import html
            from s2r_spec.rollouts.journal import Journal
            from s2r_spec.rollouts.layout import with_any
            from s2r_spec.spec import load_spec

            chosen = search()
            form = settle(form, as_json, output)
            pageable(page)
            parsed = load_spec(spec)
            name = f"{prefix}{spec.stem}-{sim}-{real}"
            if resume is not None:
                resume = with_any(resume, chosen.places, Journal.exists)
            compared = [requirement] if requirement else list(parsed.requirements)
            simulator, machine = reading.backends([sim, real], parsed, compared)
            places = [] if resume is None else [resume / place for place in chosen.journals]
            seed = seed_of(seed, *places)
            executor, folder, opening = begun(run, resume, name, seed, workers, scheduler, machine)
            try:
                with Live(console(stderr=True), quiet, opening=opening) as live:
                    result = chosen.run(
                        parsed,
                        simulator,
                        machine,
                        folder,
                        requirement=requirement,
                        seed=seed,
                        budget=budget,
                        stop=stop,
                        executor=executor,
                        timeout=seconds(timeout),
                        resume=resume is not None,
                        observer=live,
                        void=void,
                    )
            except KeyboardInterrupt:
                interrupted(folder)
                raise
            report = chosen.report(parsed, result)
            emit(report, form, output)
            if page is not None:
                save(page, html.render([chosen.page(folder, machine)]))
            raise typer.Exit(report.exit_code)

    command.__doc__ = help_
    return command
