"""Are the certificates right as often as they say?

Random functions of exact norm B, noise exactly at the proxy R, δ = 0.1. A run
is wrong when the true maximum is outside the interval. The rigorous modes must
not be wrong; each mutant breaks one thing, and must be wrong in 15 % of its runs. At B = the norm
the guard (B ≥ 2 B_low) refuses nearly every run, honest or not: a refusal
tells nothing apart here, and only the interval is counted. ::

    OMP_NUM_THREADS=1 python -m benchmarks.certify.calibration          # about 15 minutes on 2 cores
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.certify.random_functions import Case, Outcome, binomial_interval, seeds, solve, solve_all
from benchmarks.machine import describe
from s2r_spec.certify.bound import confidence, modes, posterior

RESULTS = Path(__file__).parents[1] / "results" / "certify_calibration.json"
USUAL = Case(seed=0, norm=1.5, B=1.5, R=0.05, delta=0.1, epsilon=0.06, budget=20_000)

HONEST = {
    "rigorous": USUAL,
    "rigorous, Matérn-5/2": dataclasses.replace(USUAL, kernel="matern52"),
    "rigorous, R = 0.001": dataclasses.replace(USUAL, R=0.001),
    "rigorous, Rademacher noise": dataclasses.replace(USUAL, noise="rademacher"),
    "rigorous, uniform noise": dataclasses.replace(USUAL, noise="uniform"),
    "rigorous-simple": dataclasses.replace(USUAL, mode="rigorous-simple"),
    "paper (repaired)": dataclasses.replace(USUAL, mode="paper"),
}
# The declared settings are wrong, the code is right.
MISDECLARED = {
    "B is half the norm": dataclasses.replace(USUAL, B=0.75),
    "R is a tenth of the noise": dataclasses.replace(USUAL, R=0.005, true_noise=0.05),
    "lengthscale is three times the true one": dataclasses.replace(USUAL, assumed_lengthscale=0.6),
}


@contextmanager
def variance_for_deviation() -> Iterator[None]:
    """σ_n(z) = k_n(z, z), as the paper types it."""
    honest = posterior._Spectrum.moments

    def as_typed(self: posterior._Spectrum, scales: np.ndarray, points: np.ndarray) -> confidence.Moments:
        result = honest(self, scales, points)
        return dataclasses.replace(result, std=result.std**2 * USUAL.R)

    posterior._Spectrum.moments = as_typed  # type: ignore[method-assign]
    try:
        yield
    finally:
        posterior._Spectrum.moments = honest  # type: ignore[method-assign]


@contextmanager
def tiny_ridge() -> Iterator[None]:
    """The published β with a ridge λ = 1e-3 in place of 1 + 2/i."""
    honest = modes.Paper.bound

    def bound(self: modes.Paper, data, rollouts, norms, delta):  # type: ignore[no-untyped-def]
        ridge = 1e-3
        result = honest(self, data, rollouts, norms, delta)
        log_det = rollouts * np.log(1 + 2 / rollouts) + float(
            data.evidence(np.array([1 / (1 + 2 / rollouts)])).log_det[0]
        )
        beta = confidence.published_beta(norms, 1.0, log_det, delta)
        return dataclasses.replace(
            result, scales=np.array([1 / ridge]), widths=beta[:, None] * np.sqrt(ridge)
        )

    modes.Paper.bound = bound  # type: ignore[method-assign]
    try:
        yield
    finally:
        modes.Paper.bound = honest  # type: ignore[method-assign]


MUTANTS = {
    "variance for standard deviation": (variance_for_deviation, USUAL),
    "ridge 1e-3 with the paper's β": (tiny_ridge, dataclasses.replace(USUAL, mode="paper")),
}


def mutated(name: str, case: Case) -> Outcome:
    """Run a case with one line of the bound broken, in this process only."""
    with MUTANTS[name][0]():
        return solve(case)


def row(name: str, outcomes: list[Outcome]) -> dict[str, object]:
    """Count, print and return."""
    wrong = sum(outcome.wrong for outcome in outcomes)
    caught = sum(outcome.wrong or outcome.label == "REFUSED" for outcome in outcomes)
    silent = sum(outcome.wrong and outcome.label != "REFUSED" for outcome in outcomes)
    interval = binomial_interval(wrong, len(outcomes))
    rollouts = int(np.median([outcome.rollouts for outcome in outcomes]))
    print(
        f"{name:42} wrong {wrong:4d} of {len(outcomes)} [{interval[0]:.4f}, {interval[1]:.4f}], "
        f"wrong or refused {caught}, wrong and silent {silent}, median rollouts {rollouts}",
        flush=True,
    )
    return {
        "name": name,
        "runs": len(outcomes),
        "wrong": wrong,
        "wrong_95": interval,
        "wrong_or_refused": caught,
        "wrong_and_silent": silent,
        "median_rollouts": rollouts,
    }


def main() -> int:
    """Run all, print the table, write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--mutant-runs", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    honest = [
        row(name, solve_all(seeds(case, options.runs), options.workers)) for name, case in HONEST.items()
    ]
    wrong = [
        row(name, solve_all(seeds(case, options.mutant_runs), options.workers))
        for name, case in MISDECLARED.items()
    ]
    with ProcessPoolExecutor(options.workers) as pool:
        for name, (_, case) in MUTANTS.items():
            cases = seeds(case, options.mutant_runs)
            wrong.append(row(name, list(pool.map(mutated, [name] * len(cases), cases, chunksize=8))))
    record = {
        "machine": describe("numpy", "scipy", "torch", "gpytorch"),
        "delta": USUAL.delta,
        "honest": honest,
        "mutants": wrong,
    }
    options.output.write_text(json.dumps(record, indent=2, ensure_ascii=False) + "\n")
    right = all(entry["wrong"] == 0 for entry in honest)
    # Refusals do not count here: at B = the norm the guard refuses every run, the honest ones too.
    caught = all(entry["wrong"] >= 0.15 * entry["runs"] for entry in wrong)  # type: ignore[operator]
    print("as promised" if right and caught else "NOT AS PROMISED")
    return 0 if right and caught else 1


if __name__ == "__main__":
    sys.exit(main())
