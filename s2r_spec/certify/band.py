"""Confidence bands over a grid, for several norm bounds at once, from one event of probability 1 − δ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.certify import confidence
from s2r_spec.certify.kernels import FAMILIES, Kernel
from s2r_spec.certify.posterior import Engine
from s2r_spec.certify.samples import Samples
from s2r_spec.errors import UsageError, one_of

FloatArray = NDArray[np.float64]

MODES = ("rigorous", "rigorous-simple")


@dataclass(frozen=True)
class Scales:
    """What is fixed before the data, and what is not, in units of R²."""

    mixture: FloatArray
    """(J,) c_j of the mixture: fixed before the data, whatever they show."""
    dual: FloatArray
    """(A,) a at which the bound is evaluated; any set is valid, a dense one is tight."""


def scales_for(mode: str, kernel: Kernel, norms: FloatArray) -> Scales:
    """Return the scales of a mode for (rungs,) norm bounds, the declared one first.

    ``rigorous-simple`` has one scale for both: an ordinary fixed-noise Gaussian
    process. ``rigorous`` mixes five decades below B², so that it need not know
    how much smaller than B the norm really is.

    Raises:
        UsageError: no such mode.
    """
    square = float(norms[0]) ** 2
    if mode == "rigorous-simple":
        single = np.array([square / FAMILIES[kernel.name].mixture])
        return Scales(single, single)
    if mode == "rigorous":
        return Scales(
            np.geomspace(1.0, 1e-4, 5) * square, np.geomspace(1e-5 * square, 30 * float(norms[-1]) ** 2, 33)
        )
    raise UsageError(f"no mode {mode!r}; there are: {one_of(MODES)}")


@dataclass(frozen=True)
class Fit:
    """The posterior at the dual scales, and what multiplies its standard deviation."""

    posterior: confidence.Posterior
    width: FloatArray
    """(rungs, A) in units of R; NaN where no function of that norm fits the data."""
    radius: float
    """r_n of the data-fit set."""


def fit(engine: Engine, samples: Samples, scales: Scales, norms: FloatArray, delta: float) -> Fit:
    """Condition on the samples (at least one) and return the multipliers for every norm bound."""
    both = engine.posterior(
        samples.at, samples.counts, samples.means, np.concatenate([scales.mixture, scales.dual])
    )
    first = len(scales.mixture)
    radius = confidence.data_radius(both.log_det[:first], both.quadratic[:first], delta)
    dual = confidence.Posterior(
        both.mean[first:], both.std[first:], both.log_det[first:], both.quadratic[first:]
    )
    return Fit(dual, confidence.width(norms, scales.dual, radius, dual.quadratic), radius)


@dataclass(frozen=True)
class Band:
    """(rungs, G) bounds of J at the grid points, one row for each norm bound, in units of R."""

    lower: FloatArray
    upper: FloatArray

    @classmethod
    def prior(cls, norms: FloatArray, size: int) -> Band:
        """Before any data ‖J‖ ≤ B alone gives |J| ≤ B."""
        side = np.repeat(norms[:, None], size, axis=1)
        return cls(-side, side)

    def intersect(self, fit: Fit) -> Band:
        """Tighten by a new fit; the bounds hold for all times at once, so the tightest ever seen holds.

        A row whose norm bound is refuted stays as it was: an empty set bounds nothing.
        """
        lower, upper = self.lower.copy(), self.upper.copy()
        for row, width in enumerate(fit.width):
            if np.isnan(width).any():
                continue
            half = width[:, None] * fit.posterior.std
            upper[row] = np.minimum(upper[row], (fit.posterior.mean + half).min(axis=0))
            lower[row] = np.maximum(lower[row], (fit.posterior.mean - half).max(axis=0))
        return Band(lower, upper)
