"""Δρ at the tests that were run, with errors from replicates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.gap.materiality import RolloutsAtTest

FloatArray = NDArray[np.float64]


def measured(tests: Sequence[RolloutsAtTest]) -> tuple[FloatArray, FloatArray, float]:
    """Return (n,) E Δρ at each test, (n,) the standard error of each, and the standard deviation of Δρ of one pair.

    Errors follow from the variance within tests, pooled over all tests. The scatter of one pair follows from
    the median over tests, which a few falls hardly change.
    """
    real, simulated = [test.real for test in tests], [test.simulated for test in tests]
    own, other = np.array(_within(real)), np.array(_within(simulated))
    # a side without replicates has the variance of the other side; without any replicates it is 0
    own, other = (np.nan_to_num(np.where(np.isnan(a), b, a)) for a, b in ((own, other), (other, own)))
    error = own[0] / [r.size for r in real] + other[0] / [s.size for s in simulated]
    return np.array([test.gap for test in tests]), np.sqrt(error), float(np.sqrt(own[1] + other[1]))


def folded(mean: FloatArray, scatter: float) -> FloatArray:
    """Return E|Δ| of normal Δ with this mean and standard deviation (the folded normal distribution)."""
    from scipy.special import erf

    if scatter == 0.0:
        return np.abs(mean)
    z = mean / scatter
    value: FloatArray = scatter * np.sqrt(2 / np.pi) * np.exp(-np.square(z) / 2) + mean * erf(z / np.sqrt(2))
    return value


def floor(tests: Sequence[RolloutsAtTest]) -> float:
    """Return E|ρ − ρ'| of two simulated rollouts of the same test: E|Δρ| of a perfect simulator.

    NaN if no test was simulated twice.
    """
    several = [test.simulated for test in tests if test.simulated.size > 1]
    among = [float(np.abs(s[:, None] - s).sum() / (s.size * (s.size - 1))) for s in several]
    return float(np.mean(among)) if among else float("nan")


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
