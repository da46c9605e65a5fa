"""Kernels: the smoothness that a certificate assumes of the objective.

The covariances are closed forms; those of the engine ``gpytorch`` are GPyTorch's, which are equal up to rounding, and
need torch, which loads for seconds. This module adds the interpolation bound, which turns bounds at the corners of a
cell into one over the cell.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError, one_of, suggest
from s2r_spec.base.magnitude import number, positive

if TYPE_CHECKING:
    from gpytorch.kernels import Kernel as TorchKernel


@dataclass(frozen=True)
class _Family:
    words: str
    constant: float
    """Linear interpolation over a side h errs by at most ‖J‖ · constant · (h/ℓ)^power."""
    power: float
    slope: float
    """A function changes by at most ‖J‖ · slope · h/ℓ over a side h: sqrt(−k''(0)), in lengthscales."""
    mixture: float
    """B²/c of the one-scale mixture (dimensionless)."""
    covariance: Callable[[FloatArray], FloatArray]
    """k as a function of the distance, in lengthscales."""


def _rbf(distance: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-(distance**2) / 2))


def _matern52(distance: FloatArray) -> FloatArray:
    scaled = math.sqrt(5) * distance
    return np.asarray((1 + scaled + scaled**2 / 3) * np.exp(-scaled))


def _matern32(distance: FloatArray) -> FloatArray:
    scaled = math.sqrt(3) * distance
    return np.asarray((1 + scaled) * np.exp(-scaled))


FAMILIES = {
    # |J''| ≤ ‖J‖ sqrt(k''''(0)), which is √3/ℓ² and 5/ℓ², and the error is at most h²/8 max|J''|.
    "rbf": _Family("RBF (analytic functions: no kink, no step)", math.sqrt(3) / 8, 2.0, 1.0, 5.0, _rbf),
    "matern52": _Family(
        "Matérn-5/2 (twice differentiable functions)", 5 / 8, 2.0, math.sqrt(5 / 3), 20.0, _matern52
    ),
    # |J'(x) − J'(y)|² ≤ 2‖J‖²(k''(|x−y|) − k''(0)) ≤ ‖J‖² · 12√3 |x−y|/ℓ³, and the error is
    # w(1−w)h · max|J'(x) − J'(y)| over |x−y| ≤ h, at most h/4 of it.
    "matern32": _Family(
        "Matérn-3/2 (once differentiable functions)",
        math.sqrt(12 * math.sqrt(3)) / 4,
        1.5,
        math.sqrt(3),
        50.0,
        _matern32,
    ),
}


@dataclass(frozen=True)
class Kernel:
    """A stationary kernel k(z, z') with k(z, z) = 1.

    Args:
        name: ``rbf``, ``matern52`` or ``matern32``.
        lengthscale: one number for every axis, or one per axis, in the axes' units.
    """

    name: str
    lengthscale: float | tuple[float, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or self.name not in FAMILIES:
            valid = suggest(str(self.name), FAMILIES)
            raise UsageError(f"there is no kernel {self.name!r}{valid} the kernels are {one_of(FAMILIES)}")
        lengthscale: Any = self.lengthscale
        several = isinstance(lengthscale, Sequence | np.ndarray) and not isinstance(lengthscale, str | bytes)
        what = f"the lengthscale of {self.name}"
        values = tuple(number(what, value) for value in (lengthscale if several else (lengthscale,)))
        object.__setattr__(self, "lengthscale", values if several else values[0])
        if not values or min(values) <= 0:
            raise UsageError(f"{what} is {self.lengthscale}; it must be positive")
        for value in values:
            positive(what, value)

    def lengthscales(self, dim: int) -> FloatArray:
        """Return (dim,) lengthscales."""
        values = np.atleast_1d(np.asarray(self.lengthscale, dtype=np.float64))
        if values.size not in (1, dim):
            raise UsageError(
                f"{self.name} has {values.size} lengthscales, but the test space has {dim} parameters; "
                f"give one, or one per parameter"
            )
        return np.broadcast_to(values, (dim,))

    def torch(self, dim: int) -> TorchKernel:
        """Return the float64 GPyTorch kernel with these lengthscales."""
        import torch
        from gpytorch.kernels import MaternKernel, RBFKernel

        makers = {
            "rbf": RBFKernel,
            "matern52": partial(MaternKernel, 2.5),
            "matern32": partial(MaternKernel, 1.5),
        }
        kernel: Any = makers[self.name](ard_num_dims=dim).double()
        kernel.lengthscale = torch.from_numpy(self.lengthscales(dim).copy())
        return kernel.requires_grad_(False)

    def gram(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Return (n, m) values k(left_i, right_j) for (n, dim) and (m, dim) points."""
        squares = np.zeros((len(left), len(right)))
        for axis, lengthscale in enumerate(self.lengthscales(left.shape[1])):
            squares += ((left[:, axis, None] - right[:, axis]) / lengthscale) ** 2
        return FAMILIES[self.name].covariance(np.sqrt(squares))

    def hidden(self, sides: FloatArray) -> FloatArray:
        """Return (…, dim) contributions of each axis to e(h) = sup_z ‖φ(z) − Σ w_j(z) φ(g_j)‖ over (…, dim) cell sides.

        The weights w are multilinear on the cell's corners g. For ‖J‖ ≤ B it follows that J ≤ max over the corners +
        B e(h) in the cell, and J ≥ min − B e(h). One axis after another: interpolation along an axis averages
        functions, so the errors of the axes add up.
        """
        family = FAMILIES[self.name]
        with np.errstate(over="ignore"):  # a cell of too many lengthscales hides anything: inf
            scaled = (sides / self.lengthscales(sides.shape[-1])) ** family.power
        return np.asarray(family.constant * scaled)

    def change(self, sides: FloatArray) -> FloatArray:
        """Return (…, dim) bounds of |J(x) − J(y)| / ‖J‖ for x and y that differ by one of the (…, dim) sides.

        |J(x) − J(y)| ≤ ‖J‖ sqrt(2 − 2k(x, y)) by Cauchy–Schwarz, and 1 − k(x, y) ≤ −k''(0) |x − y|²/2.
        """
        return np.asarray(FAMILIES[self.name].slope * sides / self.lengthscales(sides.shape[-1]))

    def sides_for(self, error: float, dim: int) -> FloatArray:
        """Return (dim,) cell sides with an interpolation bound of ``error``, shared equally by the axes."""
        family = FAMILIES[self.name]
        return np.asarray(self.lengthscales(dim) * (error / (dim * family.constant)) ** (1 / family.power))
