"""``s2r gap``: how far simulator and real machine are apart, with sign and probability."""

from __future__ import annotations

import json

import typer
from rich.console import Console

from s2r_spec.cli.common import CORES, interrupted, new_or_old, sentences
from s2r_spec.cli.options import (
    AsJson,
    OneRequirement,
    Quiet,
    RealBudget,
    RealMachine,
    Resume,
    Run,
    Seed,
    Simulator,
    SpecFile,
    Workers,
)


def gap(
    spec: SpecFile,
    real: RealMachine,
    sim: Simulator = "sim",
    requirement: OneRequirement = None,
    seed: Seed = 0,
    budget: RealBudget = None,
    workers: Workers = CORES,
    run: Run = None,
    resume: Resume = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
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
