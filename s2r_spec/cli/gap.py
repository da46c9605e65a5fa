"""``s2r gap``: how far simulator and real machine are apart, with sign and probability."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from s2r_spec.cli.common import cores, interrupted, new_or_old, sentences


def gap(
    spec: Annotated[Path, typer.Argument(help="The specification, a .stl file.", show_default=False)],
    real: Annotated[
        str, typer.Option(help="The real machine: a robot, its logs, a twin.", show_default=False)
    ],
    sim: Annotated[str, typer.Option(help="The simulator.")] = "sim",
    requirement: Annotated[
        str | None, typer.Option("--requirement", "-r", help="If the spec has several.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Fixes the whole run.")] = 0,
    budget: Annotated[
        int | None, typer.Option(min=1, help="Most real rollouts; without it, as many as ε takes.")
    ] = None,
    workers: Annotated[
        int, typer.Option(min=1, help="Parallel rollouts; the numbers do not depend on it.")
    ] = cores(),
    run: Annotated[
        Path | None, typer.Option(help="Folder for the rollouts.", show_default="s2r-runs/…")
    ] = None,
    resume: Annotated[Path | None, typer.Option(help="Go on with the run in this folder.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing while running.")] = False,
) -> None:
    """Bound the signed gap Δ = ρ_real − ρ_sim over the spec's test space."""
    with sentences(as_json):
        from s2r_spec.certify.certificate import Label
        from s2r_spec.certify.gap import gap as bound
        from s2r_spec.cli.progress import Live
        from s2r_spec.report import gapform
        from s2r_spec.rollouts.runner import process_pool
        from s2r_spec.spec import load_spec

        parsed = load_spec(spec)
        folder = new_or_old(run, resume, f"gap-{spec.stem}-{sim}-{real}", seed)
        errors = Console(stderr=True, highlight=False)
        if not quiet:
            errors.print(f"run {folder}, seed {seed}, {workers} workers", markup=False, soft_wrap=True)
        try:
            with Live(errors, quiet, symbol="Δ") as live:
                result = bound(
                    parsed,
                    sim,
                    real,
                    folder,
                    requirement=requirement,
                    seed=seed,
                    budget=budget,
                    executor=process_pool(workers),
                    resume=resume is not None,
                    observer=live,
                )
        except KeyboardInterrupt:
            interrupted(folder)
            raise
        if as_json:
            print(json.dumps(gapform.gap_json(result), allow_nan=False, indent=2, ensure_ascii=False))
        else:
            units = {axis.name: axis.unit for axis in parsed.space.axes}
            Console(highlight=False, soft_wrap=True).print(gapform.gap_text(result, units))
        # A gap has no verdict: 0 says that the interval is as narrow as asked, 3 that it is not.
        raise typer.Exit(0 if result.certificate.label is Label.CERTIFIED else 3)
