"""The noise of one rollout, from replicated tests.

Data: m_i outcomes y_ij at test i. Model: y_ij = J(x_i) + ε_ij, E ε_ij = 0, with one variance σ² for all tests.
Estimator: the pooled variance s² = Σ (y_ij − ȳ_i)² / ν, ν = Σ (m_i − 1). For Gaussian noise νs²/σ² is χ² with ν degrees
of freedom, so that σ ≤ s sqrt(ν/χ²_ν(0.05)) with probability 0.95. If one test scatters more than the others (F test),
its own deviation counts where it is above this limit. Units: those of the outcome.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError

FEWEST = 5
"""Budget: fewest degrees of freedom: replicates beyond the first of each test."""
UPPER = 0.95
"""Level: probability that the deviation is below its upper limit, for Gaussian noise."""
NOISIER = 0.01
"""Level: probability that equally noisy tests are called unequal."""


@dataclass(frozen=True)
class Noise:
    """The noise of one rollout.

    Attributes:
        std: its standard deviation, pooled over all tests; 0 if all replicates of every test are equal.
        upper: upper 95 % limit of the standard deviation; the deviation of the noisiest test, if that is larger.
        largest: the largest deviation of an outcome from the mean of its test.
        noisiest: the test with more noise than the others; None if they are alike.
        warning: one sentence if the noise looks heavy-tailed, else "".
    """

    std: float
    upper: float
    largest: float
    noisiest: int | None
    warning: str


def noise_of(groups: Sequence[ArrayLike]) -> Noise:
    """Estimate the noise from the outcomes of each test; a UsageError if there are too few replicates."""
    values = [np.asarray(group, dtype=np.float64) for group in groups]
    replicated = [i for i, group in enumerate(values) if len(group) > 1]
    degrees = np.array([len(values[i]) - 1 for i in replicated])
    if degrees.sum() < FEWEST:
        raise UsageError(
            f"the pilot has {degrees.sum()} replicates beyond the first of each test; it needs at least {FEWEST}"
        )
    scatter = np.array([float(((values[i] - values[i].mean()) ** 2).sum()) for i in replicated])
    if not scatter.sum():
        return Noise(0.0, 0.0, 0.0, None, "")
    noisiest = _noisiest(scatter, degrees)
    std = math.sqrt(scatter.sum() / degrees.sum())
    upper = std * _upper_factor(int(degrees.sum()))
    if noisiest is not None:
        upper = max(upper, math.sqrt(scatter[noisiest] / degrees[noisiest]))
    # Scaled, so that a residual from m outcomes has the variance of one outcome.
    plain = [values[i] - values[i].mean() for i in replicated]
    residuals = np.concatenate([r * math.sqrt(len(r) / (len(r) - 1)) for r in plain])
    largest = float(max(np.abs(r).max() for r in plain))
    place = None if noisiest is None else replicated[noisiest]
    return Noise(std, upper, largest, place, _tail(residuals))


def _noisiest(scatter: FloatArray, degrees: FloatArray) -> int | None:
    """Return the test whose variance is above that of all others together, by an F test for the largest of them."""
    from scipy.stats import f

    if len(scatter) < 2:
        return None
    place = int((scatter / degrees).argmax())
    others, free = scatter.sum() - scatter[place], degrees.sum() - degrees[place]
    if not others:
        return place
    ratio = (scatter[place] / degrees[place]) / (others / free)
    return place if len(scatter) * f.sf(ratio, degrees[place], free) < NOISIER else None


def _upper_factor(degrees: int) -> float:
    """Return sqrt(ν/χ²_ν(1 − UPPER)): upper limit of the standard deviation, over its estimate."""
    from scipy.stats import chi2

    return math.sqrt(degrees / chi2.ppf(1 - UPPER, degrees))


def _tail(residuals: FloatArray) -> str:
    """Return a sentence if (n,) residuals look heavy-tailed, "" if they do not."""
    std = math.sqrt(float(np.mean(residuals**2)))
    kurtosis = float(np.mean(residuals**4)) / std**4
    farthest = float(np.abs(residuals).max()) / std
    # Four standard errors of a Gaussian sample's kurtosis, and a residual that Gaussian noise shows once in 10⁴ pilots.
    tail = kurtosis > 3 + 4 * math.sqrt(24 / len(residuals))
    rare = farthest > NormalDist().inv_cdf(1 - 0.5e-4 / len(residuals))
    if not (tail or rare):
        return ""
    return (
        f"the noise looks heavy-tailed (kurtosis {kurtosis:.1f}, largest residual {farthest:.1f} standard "
        f"deviations): a standard deviation is not a proxy for it; use a proven range, R = (b − a)/2"
    )
