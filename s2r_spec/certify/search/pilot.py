"""What replicated outcomes of a pilot say about R."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from s2r_spec.base.errors import UsageError
from s2r_spec.certify.bound import confidence

FEWEST = 5
"""Budget: fewest replicates beyond the first of each test."""


@dataclass(frozen=True)
class Pilot:
    """The noise of a pilot. Its outcomes must not be used for the certificate again.

    Attributes:
        rollouts: number of outcomes.
        std: within tests, pooled, in the unit of the outcome.
        refuted: the largest R that the e-test refutes at 1/20; the true proxy is hardly below it.
        kurtosis: the kurtosis of the residuals; 3 for Gaussian noise.
        warning: one sentence if the noise looks heavy-tailed, else "".
    """

    rollouts: int
    std: float
    refuted: float
    kurtosis: float
    warning: str


def read_pilot(groups: list[ArrayLike]) -> Pilot:
    """Estimate the noise from groups of replicated outcomes; a UsageError if they are too few, or all equal."""
    values = [np.asarray(group, dtype=np.float64) for group in groups]
    values = [group for group in values if len(group) > 1]
    degrees = sum(len(group) - 1 for group in values)
    if degrees < FEWEST:
        raise UsageError(
            f"the pilot has {degrees} replicates beyond the first of each test; it needs at least {FEWEST}"
        )
    # Scaled, so that a residual from m outcomes has the variance of one outcome.
    residuals = np.concatenate([(g - g.mean()) * math.sqrt(len(g) / (len(g) - 1)) for g in values])
    scatter = float(sum(((g - g.mean()) ** 2).sum() for g in values))
    std = math.sqrt(scatter / degrees)
    if std == 0:
        raise UsageError("the pilot's replicates are all equal: there is no noise to judge")
    low, high = std * 1e-3, std * 10
    for _ in range(60):
        middle = math.sqrt(low * high)
        log_e = confidence.noise_e_value(scatter / middle**2, degrees)
        low, high = (middle, high) if log_e >= math.log(20) else (low, middle)
    kurtosis = float(np.mean(residuals**4) / np.mean(residuals**2) ** 2)
    farthest = float(np.abs(residuals).max() / std)
    # Four standard errors of a Gaussian sample's kurtosis, and a residual that Gaussian noise shows once in 10⁴ pilots.
    tail = kurtosis > 3 + 4 * math.sqrt(24 / len(residuals))
    rare = farthest > NormalDist().inv_cdf(1 - 0.5e-4 / len(residuals))
    warning = ""
    if tail or rare:
        warning = (
            f"the noise looks heavy-tailed (kurtosis {kurtosis:.1f}, largest residual {farthest:.1f} standard "
            f"deviations): a standard deviation is not a proxy for it; use a proven range, R = (b − a)/2"
        )
    return Pilot(len(residuals), std, low, kurtosis, warning)
