"""``s2r diagnose``: where the gap is, which effect causes it, and how far the effect closes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from s2r_spec.base.errors import UsageError
from s2r_spec.base.files import refuse_existing, save
from s2r_spec.base.json_values import document
from s2r_spec.base.printable import one_line
from s2r_spec.cli.options.groups import group_options, options, output_option, search_option
from s2r_spec.cli.options.logs import READ, LogReading
from s2r_spec.cli.options.output import Form, writable, write
from s2r_spec.cli.options.search import Compared, Running, Seed, SpecFile
from s2r_spec.cli.terminal.common import begin_run, pool, resumable, sentences
from s2r_spec.cli.terminal.terminal import console

if TYPE_CHECKING:
    from s2r_spec.backend import WritesFound
    from s2r_spec.diagnose import Diagnosis
    from s2r_spec.spec import Spec


@options
class Diagnosed(Compared):
    """What is diagnosed, from how many rollouts; each field is an option."""

    real: str | None = typer.Option(  # type: ignore[assignment]  # optional here alone
        None,
        help="Backend of the real machine: a robot, its logs as log:FOLDER, or a twin. Without it, the answer is which "
        "effects tests and protocols would identify.",
        show_default=False,
    )
    seed: Seed = None
    budget: int | None = search_option(
        None,
        min=6,
        help="Most real rollouts to run, or to use from logs.",
        show_default="30 from a machine, all from a log",
    )
    open_loop: bool = search_option(
        False,
        "--open-loop",
        help="Simulate each recorded test with the commands that were recorded, without the controller.",
    )


@options
class Campaign:
    """Which protocols may run, and what is written beside the diagnosis; each field is an option."""

    apply: Path | None = output_option(
        None, help="File for the simulator with the named effects; use it as --sim patched:FILE."
    )
    as_found: Path | None = output_option(
        None,
        help="New folder for the simulator's own files with what is named, and a deploy file without it.",
    )
    tuned: bool = output_option(
        False,
        "--tuned",
        help="With --apply or --as-found: add every other effect, too, with a small size fitted to the data.",
    )
    protocols: str | None = search_option(
        None,
        help="Protocols that may run, separated by commas; `s2r backends NAME` lists them.",
        show_default="all that the simulator and the machine have",
    )
    no_protocols: bool = search_option(
        False, "--no-protocols", help="Run no protocols. Those in logs are still used."
    )
    passive: bool = search_option(
        False, "--passive", help="Use tests of the specification alone, from a machine or from logs."
    )
    following: Path | None = output_option(
        None,
        "--next",
        help="Print the experiment to run next. If it is a protocol, its references go to this .csv file.",
        show_default=False,
    )

    def names(self) -> tuple[str, ...] | None:
        """Return the names of the protocols that may run, None for all, after all checks.

        Raises:
            UsageError: the options contradict each other, a name is empty, or a file cannot be written.
        """
        writable(self.apply)
        if self.as_found is not None:
            refuse_existing(self.as_found)
        if self.tuned and self.apply is None and self.as_found is None:
            raise UsageError("--tuned changes what --apply and --as-found write; give one of them with it")
        if (self.protocols is not None) + self.no_protocols + self.passive > 1:
            raise UsageError("give only one of --protocols, --no-protocols and --passive")
        names = None if self.protocols is None else tuple(map(str.strip, self.protocols.split(",")))
        if names is not None and not all(names):
            raise UsageError(
                f"--protocols {self.protocols!r} has an empty name; give names such as squat,sway, or use "
                f"--no-protocols"
            )
        if self.following is not None and self.following.suffix.lower() != ".csv":
            raise UsageError(f"--next {self.following}: the file of a protocol must end in .csv")
        writable(self.following)
        return () if self.no_protocols or self.passive else names


@options
class Writing(Form):
    """The form and the files of the diagnosis; each field is an option."""

    form: str | None = output_option(
        None, "--format", help="Format of the diagnosis: text, json or markdown.", show_default="text"
    )


@group_options
def diagnose(
    spec: SpecFile,
    *,
    compared: Diagnosed,
    running: Running,
    reading: LogReading,
    campaign: Campaign,
    writing: Writing,
) -> None:
    """Find where the gap is, which effect of the catalogue causes it, and how far that effect closes it."""
    with sentences(writing.json):
        from s2r_spec.cli.terminal.stages import Stages
        from s2r_spec.diagnose import diagnose as find
        from s2r_spec.diagnose.data.journal import ANSWER, REAL, begun_in, seed_of
        from s2r_spec.report import diagnosis as diagnosis_report
        from s2r_spec.report import diagnosis_page
        from s2r_spec.spec import load_spec

        forms = _forms()
        form = writing.settled(forms)
        names = campaign.names()
        if not compared.real:
            _before(spec, compared, running, reading, campaign, writing)
            return
        if campaign.as_found is not None:
            _writer(compared.sim)
        sim, real, parsed = compared.sim, compared.real, load_spec(spec)
        (machine,) = reading.backends([real], parsed, compared.requirements(parsed))
        if running.resume is not None:
            running = replace(running, resume=begun_in(running.resume))
        seed = seed_of(running.resume, compared.seed)
        name = f"diagnose-{spec.stem}-{sim}-{Path(real).name}"
        executor, folder, opening = begin_run(running, name, seed, machine)
        errors = console(stderr=True)
        with resumable(folder), Stages(errors, running.quiet, opening=opening) as stages:
            diagnosis = find(
                parsed,
                sim,
                machine,
                compared.budget,
                requirement=compared.requirement,
                seed=seed,
                executor=executor,
                progress=stages,
                folder=folder / REAL,
                protocols=names,
                passive=campaign.passive,
                open_loop=compared.open_loop,
            )
        folder.mkdir(parents=True, exist_ok=True)
        save(folder / ANSWER, document(diagnosis) + "\n")
        written = [_patch(diagnosis, sim, campaign), *_files(diagnosis, sim, campaign)]
        texts = [partial(each, diagnosis, parsed) for each in (forms[form], diagnosis_report.markup)]
        write(form, writing.output, *texts)
        writing.write_page(lambda: diagnosis_page.render(diagnosis, parsed, real))
        following = [_next(diagnosis, compared, real, campaign.following)]
        for sentence in following if form == "json" else [*written, *following]:
            if sentence:
                errors.print(one_line(sentence), markup=False, soft_wrap=True)
        raise typer.Exit(diagnosis.exit_code)


def _before(
    spec: Path,
    compared: Diagnosed,
    running: Running,
    reading: LogReading,
    campaign: Campaign,
    writing: Writing,
) -> None:
    """Print what tests and protocols would identify, for a machine without any data."""
    from rich.markup import escape

    from s2r_spec.cli.terminal.stages import Stages
    from s2r_spec.diagnose.before import before_data
    from s2r_spec.report.before import text
    from s2r_spec.spec import load_spec

    if compared.real is not None:
        raise UsageError("--real is empty; name a machine or log:FOLDER, or leave the option out")
    needs: dict[str, object] = {"apply": campaign.apply, "as-found": campaign.as_found}
    needs |= {"next": campaign.following, "report": writing.page, "budget": compared.budget}
    needs |= {"seed": compared.seed, "run": running.run, "resume": running.resume}
    if given := [name for name, value in needs.items() if value is not None]:
        raise UsageError(f"--{given[0]} is for a machine or its logs; give --real, too")
    reading.backends((), load_spec(spec), ())
    form = writing.settled(("text", "json"))
    executor, _ = pool(running.workers, running.scheduler)
    opening = "no recordings (--real) are given; this says what runs would identify, by the simulator alone"
    with Stages(console(stderr=True), running.quiet, opening=opening) as stages:
        found = before_data(
            spec,
            compared.sim,
            compared.requirement,
            executor=executor,
            progress=stages,
            protocols=campaign.names(),
            open_loop=compared.open_loop,
        )
    render = document if form == "json" else text
    write(form, writing.output, lambda: render(found), lambda: escape(text(found)))


def _forms() -> dict[str, Callable[[Diagnosis, Spec], str]]:
    """Return name → form of a diagnosis, as ``--format`` takes it."""
    from s2r_spec.report import diagnosis as diagnosis_report

    return {
        "text": diagnosis_report.text,
        "json": lambda diagnosis, _: document(diagnosis),
        "markdown": diagnosis_report.markdown,
    }


def _patch(diagnosis: Diagnosis, sim: str, campaign: Campaign) -> str:
    """Write the simulator with the named effects if it is asked for; return a sentence on it."""
    from s2r_spec.runs import patched

    if campaign.apply is None:
        return ""
    if not (added := diagnosis.improved(campaign.tuned)):
        return f"{campaign.apply} is not written: no effect is named"
    patched.write(campaign.apply, sim, added)
    lacks = "; it lacks the mistake of the loop, which --as-found writes" if diagnosis.mistakes else ""
    return f"use it as --sim patched:{campaign.apply}{lacks}"


def _writer(sim: str) -> WritesFound:
    """Return a simulator that has files of its own; a UsageError names what others have."""
    from s2r_spec.backend import WritesFound, load_backend

    backend = load_backend(sim)
    if not isinstance(backend, WritesFound):
        raise UsageError(
            f"--as-found writes the files of a robot file (robot.toml), and {sim} has none; use --apply FILE"
        )
    return backend


def _files(diagnosis: Diagnosis, sim: str, campaign: Campaign) -> list[str]:
    """Write the simulator's files with what is named if they are asked for; return sentences on them."""
    if campaign.as_found is None:
        return []
    added, mistakes = diagnosis.improved(campaign.tuned), diagnosis.mistakes
    if not (added or mistakes):
        return [f"{campaign.as_found} is not written: nothing is named"]
    found = _writer(sim).write_found(added, campaign.as_found, mistakes)
    return [line for one in found for line in (one.words, *one.table)]


def _next(diagnosis: Diagnosis, compared: Diagnosed, real: str, path: Path | None) -> str:
    """Return which experiment to run next; write a protocol's references to a file if machine or simulator has them."""
    from s2r_spec.backend import load_backend
    from s2r_spec.diagnose.data.protocols import next_words

    if path is None:
        return ""
    if (following := diagnosis.which.next_test) is None:
        return f"{path} is not written: no further experiment would separate what is open"
    assert diagnosis.spec is not None
    units, simulator = diagnosis.spec.space.units, load_backend(compared.sim)
    # Recordings have no references, and opening them reads them all again.
    machine = None if real.startswith(READ) else load_backend(real)
    return next_words(following.candidate.shown, units, simulator, path, compared.open_loop, machine)
