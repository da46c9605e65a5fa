"""``s2r diagnose``: where the gap lies, which unmodelled effect causes it, how far it shrinks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from s2r_spec.cli.common import interrupted, new_or_old, pool, sentences
from s2r_spec.cli.options import (
    AsJson,
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

Budget = Annotated[int | None, typer.Option(min=6, help="Real rollouts to ask for, or to use at most.")]
Apply = Annotated[
    Path | None,
    typer.Option(help="Write the simulator with the named effects to this file, for --sim patched:FILE."),
]


def diagnose(
    spec: SpecFile,
    real: RealMachine,
    sim: Simulator = "sim",
    requirement: OneRequirement = None,
    seed: Seed = 0,
    budget: Budget = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    run: Run = None,
    resume: Resume = None,
    apply: Apply = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Say where the gap lies, which effect of the catalogue causes it, and how far it shrinks."""
    with sentences(as_json):
        from s2r_spec.cli.stages import Stages
        from s2r_spec.diagnose import diagnose as find
        from s2r_spec.report import diagnosed
        from s2r_spec.rollouts import patched
        from s2r_spec.spec import load_spec

        parsed = load_spec(spec)
        executor, machines = pool(workers, scheduler)
        folder = new_or_old(run, resume, f"diagnose-{spec.stem}-{sim}-{Path(real).name}", seed)
        errors = Console(stderr=True, highlight=False)
        if not quiet:
            errors.print(f"run {folder}, seed {seed}, {machines}", markup=False, soft_wrap=True)
        try:
            with Stages(errors, quiet) as stages:
                found = find(
                    parsed,
                    sim,
                    real,
                    budget,
                    requirement=requirement,
                    seed=seed,
                    executor=executor,
                    progress=stages,
                    folder=folder / "real",
                )
        except KeyboardInterrupt:
            interrupted(folder)
            raise
        text = json.dumps(found.to_json(), allow_nan=False, indent=2, ensure_ascii=False)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "diagnosis.json").write_text(text + "\n", encoding="utf-8")
        if apply is not None and found.patch:
            patched.write(apply, sim, found.patch)
        if as_json:
            print(text)
        else:
            Console(highlight=False, soft_wrap=True).print(diagnosed.markup(found))
            if apply is not None:
                said = (
                    f"use it as --sim patched:{apply}"
                    if found.patch
                    else f"{apply} is not written: no effect is named"
                )
                errors.print(said, markup=False, soft_wrap=True)
        # A diagnosis has no verdict on the machine: 0 says that a cause (or none) is named, 3 that it is not.
        raise typer.Exit(0 if found.verdict.value in ("named", "no material gap") else 3)
