"""Random functions of an exact RKHS norm, and searches on them: shared by the certify_* benchmarks."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.search.search import Search
from s2r_spec.space import Space

Noise = Callable[[np.random.Generator, int], np.ndarray]

NOISES: dict[str, Noise] = {
    # Each with sub-Gaussian proxy 1.
    "gaussian": lambda rng, n: rng.normal(size=n),
    "rademacher": lambda rng, n: rng.choice([-1.0, 1.0], size=n),
    "uniform": lambda rng, n: rng.uniform(-np.sqrt(3), np.sqrt(3), size=n),
}


@dataclass(frozen=True)
class Case:
    """One search on one random function."""

    seed: int
    norm: float
    B: float
    R: float
    delta: float
    epsilon: float
    kernel: str = "rbf"
    lengthscale: float = 0.2
    mode: str = "rigorous"
    noise: str = "gaussian"
    true_noise: float | None = None
    assumed_lengthscale: float | None = None
    budget: int | None = None
    dim: int = 1
    batch: float = 0.1
    spread: int = 4


@dataclass(frozen=True)
class Outcome:
    """What came of a case."""

    rollouts: int
    iterations: int
    lower: float
    upper: float
    truth: float
    label: str
    B_low: float

    @property
    def wrong(self) -> bool:
        """Whether the true maximum is outside the interval."""
        return not self.lower <= self.truth <= self.upper


def solve(case: Case) -> Outcome:
    """Run one case."""
    rng = np.random.default_rng([case.seed, 99])
    space = Space.of({f"x{i}": (-0.2, 0.3) for i in range(case.dim)})
    truth = Kernel(case.kernel, case.lengthscale)
    centres = rng.uniform(space.lower, space.upper, (12, case.dim))
    weights = rng.normal(size=12)
    weights *= case.norm / np.sqrt(weights @ truth.gram(centres, centres) @ weights)
    search = Search(
        space,
        kernel=Kernel(case.kernel, case.assumed_lengthscale or case.lengthscale),
        B=case.B,
        R=case.R,
        delta=case.delta,
        epsilon=case.epsilon,
        mode=case.mode,
        seed=case.seed,
        budget=case.budget,
        batch=case.batch,
        spread=case.spread,
    )
    draw, scale = NOISES[case.noise], case.true_noise if case.true_noise is not None else case.R
    while not search.done:
        queries = search.ask()
        points = np.array([space.vector(query.point) for query in queries])
        for query, mean in zip(queries, truth.gram(points, centres) @ weights, strict=True):
            search.tell(query, mean + scale * draw(rng, query.replicates))
    fine = space.grid(({1: 2001, 2: 201, 3: 41}[case.dim],) * case.dim)
    certificate = search.certificate()
    best = max(
        float((truth.gram(fine[i : i + 20_000], centres) @ weights).max())
        for i in range(0, len(fine), 20_000)
    )
    return Outcome(
        certificate.rollouts,
        certificate.iterations,
        certificate.lower,
        certificate.upper,
        best,
        certificate.label.name,
        certificate.B_low,
    )


def solve_all(cases: list[Case], workers: int) -> list[Outcome]:
    """Run many cases on local processes, in order."""
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(solve, cases, chunksize=8))


def seeds(case: Case, count: int) -> list[Case]:
    """Return the case with ``count`` different seeds."""
    return [replace(case, seed=seed) for seed in range(count)]


def binomial_interval(wrong: int, runs: int) -> list[float]:
    """Return the exact (Clopper–Pearson) 95 % interval of a proportion."""
    from scipy.stats import binomtest

    interval: Any = binomtest(wrong, runs).proportion_ci(0.95, "exact")
    return [float(interval.low), float(interval.high)]
