"""``s2r gap``: how far simulator and real machine are apart, with sign and probability."""

from __future__ import annotations

import typer
from rich.console import Console

from s2r_spec.cli.common import interrupted, new_or_old, pool, seconds, sentences
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
    Timeout,
    Workers,
)
from s2r_spec.cli.output import AsJson, Format, Output, Page, emit, pageable, save, settle


def gap(
    spec: SpecFile,
    real: RealMachine,
    sim: Simulator = "sim",
    requirement: OneRequirement = None,
    seed: Seed = 0,
    budget: RealBudget = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    timeout: Timeout = None,
    run: Run = None,
    resume: Resume = None,
    as_json: AsJson = False,
    form: Format = None,
    output: Output = None,
    page: Page = None,
    quiet: Quiet = False,
) -> None:
    """Bound the signed gap Δ = ρ_real − ρ_sim over the spec's test space."""
    with sentences(as_json or form == "json"):
        from s2r_spec.certify.gap import gap as bound
        from s2r_spec.cli.progress import Live
        from s2r_spec.report import gapped, html
        from s2r_spec.report.recompute import recompute_gap
        from s2r_spec.spec import load_spec

        form = settle(form, as_json, output)
        pageable(page)
        parsed = load_spec(spec)
        executor, machines = pool(workers, scheduler)
        folder = new_or_old(run, resume, f"gap-{spec.stem}-{sim}-{real}", seed)
        errors = Console(stderr=True, highlight=False)
        if not quiet:
            errors.print(f"run {folder}, seed {seed}, {machines}", markup=False, soft_wrap=True)
        try:
            with Live(errors, quiet) as live:
                result = bound(
                    parsed,
                    sim,
                    real,
                    folder,
                    requirement=requirement,
                    seed=seed,
                    budget=budget,
                    executor=executor,
                    timeout=seconds(timeout),
                    resume=resume is not None,
                    observer=live,
                )
        except KeyboardInterrupt:
            interrupted(folder)
            raise
        report = gapped.report(parsed, result)
        emit(report, form, output)
        if page is not None:
            save(html.render([recompute_gap(folder)]), page)
        # A gap has no verdict: 0 says that the interval is as narrow as asked, 3 that it is not.
        raise typer.Exit(report.exit_code)
