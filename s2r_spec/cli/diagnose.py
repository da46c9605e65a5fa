"""``s2r diagnose``: where the gap is, which effect causes it, and how far the effect closes it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.cli.campaign_options import Next, NoProtocols, Passive, Protocols, playable, protocol_names
from s2r_spec.cli.common import begun, interrupted, sentences
from s2r_spec.cli.log_options import LogReading, reads_logs
from s2r_spec.cli.options import (
    OneRequirement,
    Quiet,
    RealMachine,
    Resume,
    Run,
    Scheduler,
    Seed,
    Simulator,
    SpecFile,
    Workers,
)
from s2r_spec.cli.output import AsJson, Output, Page, pageable, settle, writable
from s2r_spec.cli.terminal import console, print_json
from s2r_spec.errors import UsageError
from s2r_spec.files import save
from s2r_spec.printable import one_line

REAL, ANSWER = "real", "diagnosis.json"
"""In the folder of a run: the folder of the real rollouts, and the file of the diagnosis."""

if TYPE_CHECKING:
    from s2r_spec.diagnose import Diagnosis

Form = Annotated[
    str | None,
    typer.Option("--format", help="Format of the diagnosis: text, json or markdown.", show_default="text"),
]
Budget = Annotated[
    int | None,
    typer.Option(
        min=6,
        help="Most real rollouts to run, or to use from logs.",
        show_default="30 from a machine, all from a log",
    ),
]
Apply = Annotated[
    Path | None,
    typer.Option(help="File for the simulator with the named effects; use it as --sim patched:FILE."),
]

Tuned = Annotated[
    bool,
    typer.Option(
        "--tuned", help="With --apply: add every other effect, too, with a small size fitted to the data."
    ),
]


@reads_logs
def diagnose(
    spec: SpecFile,
    real: RealMachine,
    sim: Simulator = "sim",
    requirement: OneRequirement = None,
    seed: Seed = None,
    budget: Budget = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    *,
    reading: LogReading,
    run: Run = None,
    resume: Resume = None,
    apply: Apply = None,
    tuned: Tuned = False,
    protocols: Protocols = None,
    no_protocols: NoProtocols = False,
    passive: Passive = False,
    following: Next = None,
    as_json: AsJson = False,
    form: Form = None,
    output: Output = None,
    page: Page = None,
    quiet: Quiet = False,
) -> None:
    """Find where the gap is, which effect of the catalogue causes it, and how far that effect closes it."""
    with sentences(as_json or form == "json"):
        from s2r_spec.cli.stages import Stages
        from s2r_spec.diagnose import diagnose as find
        from s2r_spec.json_values import document
        from s2r_spec.report import diagnosed, diagnosed_page
        from s2r_spec.report.diagnosed_markdown import markdown
        from s2r_spec.rollouts import patched
        from s2r_spec.rollouts.seeds import NEW_SEED
        from s2r_spec.spec import load_spec

        forms = {
            "text": diagnosed.text,
            "json": lambda found, _: document(found),
            "markdown": markdown,
        }
        form = settle(form, as_json, output, forms)
        pageable(page)
        writable(apply)
        if tuned and apply is None:
            raise UsageError("--tuned changes what --apply writes; give --apply FILE with it")
        names = protocol_names(protocols, no_protocols, passive)
        playable(following)
        parsed = load_spec(spec)
        name = f"diagnose-{spec.stem}-{sim}-{Path(real).name}"
        compared = [requirement] if requirement else list(parsed.requirements)
        (machine,) = reading.backends([real], parsed, compared)
        if resume is not None:
            resume = _recorded(resume)
            seed = _seed(resume, seed)
        seed = NEW_SEED if seed is None else seed
        executor, folder, opening = begun(run, resume, name, seed, workers, scheduler, machine)
        errors = console(stderr=True)
        try:
            with Stages(errors, quiet, opening=opening) as stages:
                found = find(
                    parsed,
                    sim,
                    machine,
                    budget,
                    requirement=requirement,
                    seed=seed,
                    executor=executor,
                    progress=stages,
                    folder=folder / REAL,
                    protocols=names,
                    passive=passive,
                )
        except KeyboardInterrupt:
            interrupted(folder)
            raise
        folder.mkdir(parents=True, exist_ok=True)
        save(folder / ANSWER, document(found) + "\n")
        if apply is not None and (added := found.improved(tuned)):
            patched.write(apply, sim, added)
        if output is not None:
            save(output, forms[form](found, parsed) + "\n")
        elif form == "text":
            console().print(diagnosed.markup(found, parsed))
        elif form == "json":
            print_json(document(found))
        else:
            print(forms[form](found, parsed))
        if page is not None:
            save(page, diagnosed_page.render(found, parsed, real))
        if apply is not None and form != "json":
            sentence = (
                f"use it as --sim patched:{apply}" if added else f"{apply} is not written: no effect is named"
            )
            errors.print(one_line(sentence), markup=False, soft_wrap=True)
        if following is not None:
            errors.print(one_line(_next(found, sim, machine, following)), markup=False, soft_wrap=True)
        raise typer.Exit(found.exit_code)


def _next(found: Diagnosis, sim: str, machine: object, path: Path) -> str:
    """Return which experiment to run next; write the references of a protocol to a file if the robot has them."""
    from s2r_spec.diagnose.data.protocols import next_words
    from s2r_spec.diagnose.simulate import Bench
    from s2r_spec.protocols import HasPlayable

    if found.which.next_test is None:
        return f"{path} is not written: no further experiment would separate what is open"
    assert found.spec is not None
    bench = Bench.of(found.spec, str(found.provenance["requirement"]), sim)
    robot = machine if isinstance(machine, HasPlayable) else bench.backend
    return next_words(bench, found.which.next_test.candidate.experiment, robot, path)


def _recorded(folder: Path) -> Path:
    """Return the folder of a diagnosis to continue, from that folder or from its folder of real rollouts.

    Raises:
        UsageError: nothing was recorded there.
    """
    run = folder.parent if folder.name == REAL and not (folder / REAL).exists() else folder
    real = run / REAL
    if not (run / ANSWER).exists() and not (real.is_dir() and any(real.iterdir())):
        raise UsageError(
            f"no run to resume in {folder}: there is no rollout in {real} and no {ANSWER}; begin a new run with --run"
        )
    return run


def _seed(run: Path, given: int | None) -> int | None:
    """Return the seed of a diagnosis to continue; the given one if its folder has none.

    Raises:
        UsageError: it has another seed.
    """
    from s2r_spec.diagnose.data.journal import Journal
    from s2r_spec.rollouts.seeds import inherited

    recorded = Journal.seed_in(run / REAL)
    if recorded is None:
        try:
            recorded = int(json.loads((run / ANSWER).read_text(encoding="utf-8"))["provenance"]["seed"])
        except (OSError, ValueError, KeyError, TypeError):
            return given
    return inherited(run, recorded, given)
