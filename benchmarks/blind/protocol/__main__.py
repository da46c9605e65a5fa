"""``python -m benchmarks.blind.protocol seal|freeze|open``: a blinded test of the diagnosis."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.cli import main
from s2r_spec.cli.options.search import Quiet, Scheduler, Seed, Simulator, Workers
from s2r_spec.cli.terminal.common import pool, sentences
from s2r_spec.cli.terminal.terminal import console, say

app = typer.Typer(
    help="A blinded test of the diagnosis: seal labels, freeze the answers, open the labels.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Public = Annotated[
    Path, typer.Argument(help="Folder with one folder of rollouts for each case.", show_default=False)
]
Keys = Annotated[Path, typer.Option(help="Folder for labels and salts; keep it away from the diagnosis.")]
Answers = Annotated[Path, typer.Option(help="Folder of the answers.")]


@app.command()
def seal(
    public: Public,
    labels: Annotated[Path, typer.Option(help="Folder with one <id>.json for each case.")],
    keys: Keys,
) -> None:
    """Commit to every label with a salted hash beside its data, and take the label away."""
    with sentences():
        from benchmarks.blind.protocol.seal import seal as commit

        say(f"{commit(public, labels, keys)} labels sealed; salts and labels are in {keys}")


@app.command()
def freeze(
    public: Public,
    answers: Answers,
    sim: Simulator = "sim",
    seed: Seed = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    quiet: Quiet = False,
) -> None:
    """Diagnose every case of a sealed set from its logs, and fix the answers with one hash; answers there are kept."""
    with sentences():
        from benchmarks.blind.protocol.freeze import freeze as fix
        from s2r_spec.backend import load_backend
        from s2r_spec.cli.terminal.stages import Stages
        from s2r_spec.diagnose import diagnose
        from s2r_spec.diagnose.simulator.cache import source_of
        from s2r_spec.recordings.recorded import LogBackend
        from s2r_spec.spec import load_spec

        executor, _ = pool(workers, scheduler)
        errors = console(stderr=True)
        with Stages(errors, quiet) as stages:

            def answer(case: Path) -> dict[str, object]:
                began = time.process_time()
                found = diagnose(
                    load_spec(case / "spec.stl"),
                    sim,
                    LogBackend(str(case)),
                    seed=seed,
                    executor=executor,
                    progress=stages,
                    where=False,
                    passive=True,
                ).to_json()
                return {**found, "seconds": time.process_time() - began}

            source = source_of(type(load_backend(sim)))
            digest = fix(public, answers, answer, lambda name, done, of: stages("cases", done, of), source)
        say(f"frozen: {answers}, manifest {digest}; commit it before opening")


@app.command(name="open")
def open_(public: Public, keys: Keys, answers: Answers) -> None:
    """Compare answers, data and labels with the frozen and sealed hashes, and open the labels, once."""
    with sentences():
        from benchmarks.blind.protocol.unseal import unseal

        say(f"{len(unseal(public, keys, answers))} labels opened into {answers}")


if __name__ == "__main__":
    main(app)
