"""The gap at the tests that were run: ρ of real and simulated rollouts, test by test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GapAt:
    """ρ of all rollouts at one test.

    Args:
        params: the test.
        real: (r,) ρ of the real rollouts, r ≥ 1.
        simulated: (s,) ρ of the simulated ones, s ≥ 1.
    """

    params: Mapping[str, float]
    real: FloatArray
    simulated: FloatArray

    @property
    def signed(self) -> float:
        """Mean of Δρ = ρ_real − ρ_sim."""
        return float(self.real.mean() - self.simulated.mean())


@dataclass(frozen=True, eq=False)
class Measured:
    """Δρ at each test with its errors.

    Args:
        mean: (n,) E Δρ at each test.
        deviation: (n,) standard error of each mean.
        scatter: standard deviation of Δρ of one pair of rollouts around its mean.
    """

    mean: FloatArray
    deviation: FloatArray
    scatter: float


def measured(gaps: tuple[GapAt, ...]) -> Measured:
    """Return Δρ at each test, with errors from the scatter of replicates.

    Errors follow from the variance within tests, pooled over all tests. ``scatter`` follows from
    the median over tests, which a few falls hardly change.
    """
    real, simulated = [gap.real for gap in gaps], [gap.simulated for gap in gaps]
    own, other = np.array(_within(real)), np.array(_within(simulated))
    # a side without replicates has the variance of the other side; without any replicates it is 0
    own, other = (np.nan_to_num(np.where(np.isnan(a), b, a)) for a, b in ((own, other), (other, own)))
    error = own[0] / [r.size for r in real] + other[0] / [s.size for s in simulated]
    return Measured(np.array([gap.signed for gap in gaps]), np.sqrt(error), float(np.sqrt(own[1] + other[1])))


def folded(mean: FloatArray, scatter: float) -> FloatArray:
    """Return E|Δ| of normal Δ with this mean and standard deviation (the folded normal distribution)."""
    from scipy.special import erf

    if scatter == 0.0:
        return np.abs(mean)
    z = mean / scatter
    value: FloatArray = scatter * np.sqrt(2 / np.pi) * np.exp(-np.square(z) / 2) + mean * erf(z / np.sqrt(2))
    return value


def floor(gaps: tuple[GapAt, ...]) -> float:
    """Return E|ρ − ρ'| of two simulated rollouts of the same test: E|Δρ| of a perfect simulator.

    NaN if no test was simulated twice.
    """
    among = [
        float(np.abs(s[:, None] - s).sum() / (s.size * (s.size - 1)))
        for s in (gap.simulated for gap in gaps)
        if s.size > 1
    ]
    return float(np.mean(among)) if among else float("nan")


def replicated(gaps: tuple[GapAt, ...]) -> int:
    """Return the number of tests with three real rollouts or more."""
    return sum(gap.real.size >= 3 for gap in gaps)


def _within(samples: list[FloatArray]) -> tuple[float, float]:
    """Return the variance within tests, pooled and from the median over tests; NaN without replicates."""
    from scipy.stats import chi2

    repeated = [one for one in samples if one.size > 1]
    if not repeated:
        return float("nan"), float("nan")
    freedom = np.array([one.size - 1 for one in repeated])
    variances = np.array([one.var(ddof=1) for one in repeated])
    medians = variances / (chi2.median(freedom) / freedom)
    return float(np.average(variances, weights=freedom)), float(np.median(medians))
