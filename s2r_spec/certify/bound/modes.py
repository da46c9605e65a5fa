"""Confidence sets: the multipliers of the posterior standard deviation, and the prior scales."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.certify.bound import confidence
from s2r_spec.certify.bound.kernels import FAMILIES, Kernel
from s2r_spec.certify.bound.posterior import HasEvidence

PAPER = "paper"
"""Definition: the mode of the published algorithm. Its band rests on an event of its own, not on the data-fit set."""
LARGEST = 1e10
"""Tolerance: largest prior scale times rollouts, in units of R². Beyond it rounding is not small beside a variance."""


@dataclass(frozen=True)
class Bound:
    """|J(z) − μ_a(z)| ≤ width_a v_a(z) for each dual scale a and each norm bound, in units of R."""

    scales: FloatArray
    """(A,)"""
    widths: FloatArray
    """(rungs, A); NaN where no function of that norm fits the data."""
    radius: float
    """r_n of the data-fit set, which gives B_low."""


class Mode:
    """A mixture of scales, fixed before the data, and its dual.

    Args:
        mixture: (J,) scales c_j in units of R²; fixed before the data.
        dual: (A,) scales a at which the bound is evaluated; any set is valid, a dense one is tight.
    """

    def __init__(self, mixture: FloatArray, dual: FloatArray) -> None:
        self.mixture, self._dual = mixture, dual

    def bound(self, data: HasEvidence, rollouts: int, norms: FloatArray, delta: float) -> Bound:
        """Return the bound from data for (rungs,) norm bounds, in units of R."""
        radius = self.radius(data, delta)
        # Any set of dual scales is valid. Rounding is of order a·rollouts·1e-16.
        dual = self._dual[self._dual * rollouts <= max(LARGEST, float(self._dual[0]) * rollouts)]
        return Bound(dual, confidence.width(norms, dual, radius, data.evidence(dual).quadratic), radius)

    def radius(self, data: HasEvidence, delta: float) -> float:
        """Return r_n of the data-fit set."""
        return confidence.data_radius(data.evidence(self.mixture), delta)

    def before(self, norms: FloatArray) -> Bound:
        """Return the bound before any data: ‖J‖ ≤ B alone gives |J| ≤ B."""
        scale = self._dual[:1]
        return Bound(scale, norms[:, None] / np.sqrt(scale), 0.0)


class Paper(Mode):
    """Algorithm 1 of the paper with its published β_i, and the ridge λ_i = 1 + 2/i with which its proof holds."""

    def bound(self, data: HasEvidence, rollouts: int, norms: FloatArray, delta: float) -> Bound:
        """Return the bound from data; see :class:`Mode`."""
        ridge = 1 + 2 / rollouts
        scale = np.array([1 / ridge])
        # ln det(λI + K) over single rollouts, from merged points: det(λI + K) = λⁱ det(I + K/λ).
        log_det = rollouts * np.log(ridge) + float(data.evidence(scale).log_det[0])
        beta = confidence.published_beta(norms, 1.0, log_det, delta)
        # The paper's posterior has prior k and noise λ: its deviation is √λ times that of prior k/λ and noise 1.
        return Bound(scale, beta[:, None] * np.sqrt(ridge), self.radius(data, delta))


def _rigorous_mode(kernel: Kernel, norms: FloatArray) -> Mode:
    """Mix prior scales from B² down to B²/10⁴: how far the norm is below B need not be known."""
    square = float(norms[0]) ** 2
    return Mode(
        np.geomspace(1.0, 1e-4, 5) * square, np.geomspace(1e-5 * square, 30 * float(norms[-1]) ** 2, 33)
    )


def _one_scale(kernel: Kernel, norms: FloatArray) -> FloatArray:
    return np.array([float(norms[0]) ** 2 / FAMILIES[kernel.name].mixture])


MODES: dict[str, Callable[[Kernel, FloatArray], Mode]] = {
    "rigorous": _rigorous_mode,
    # One scale for both: an ordinary fixed-noise Gaussian process.
    "rigorous-simple": lambda kernel, norms: Mode(_one_scale(kernel, norms), _one_scale(kernel, norms)),
    PAPER: lambda kernel, norms: Paper(_one_scale(kernel, norms), np.ones(1)),
}
"""Name → maker from the kernel and (rungs,) norm bounds in units of R, the declared one first."""
