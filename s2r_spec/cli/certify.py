"""``s2r certify``: what simulation and gap together promise about the real machine."""

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


def certify(
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
    """Certify the worst expected robustness in simulation, bound the gap, and add the two."""
    with sentences(as_json):
        from s2r_spec.certify.gap import certify as both
        from s2r_spec.cli.progress import Live
        from s2r_spec.report import gapform
        from s2r_spec.rollouts.runner import process_pool
        from s2r_spec.spec import load_spec

        parsed = load_spec(spec)
        folder = new_or_old(run, resume, f"{spec.stem}-{sim}-{real}", seed)
        errors = Console(stderr=True, highlight=False)
        if not quiet:
            errors.print(f"run {folder}, seed {seed}, {workers} workers", markup=False, soft_wrap=True)
        try:
            with Live(errors, quiet) as live:
                result = both(
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
            print(json.dumps(gapform.certify_json(result), allow_nan=False, indent=2, ensure_ascii=False))
        else:
            units = {axis.name: axis.unit for axis in parsed.space.axes}
            Console(highlight=False, soft_wrap=True).print(gapform.certify_text(result, units))
        raise typer.Exit(result.verdict.exit_code)
