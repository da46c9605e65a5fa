"""Kernels: the smoothness that a certificate assumes of the objective.

The covariance functions are GPyTorch's; what is added is the interpolation
constant that turns a maximum over a grid into one over the box.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import UsageError, one_of, suggest

if TYPE_CHECKING:
    from gpytorch.kernels import Kernel as TorchKernel

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class _Family:
    words: str
    curvature: float
    """sqrt(d⁴k/dr⁴(0)) at lengthscale 1; scales with 1/ℓ²."""
    mixture: float
    """B²/c, the scale of the one-scale mixture relative to the norm ball (see `confidence`)."""


FAMILIES = {
    "rbf": _Family("RBF (analytic functions only: no kink, no step)", math.sqrt(3.0), 5.0),
    "matern52": _Family("Matérn-5/2 (twice differentiable functions)", 5.0, 20.0),
}


@dataclass(frozen=True)
class Kernel:
    """A stationary kernel k(z, z') with k(z, z) = 1.

    Args:
        name: ``rbf`` or ``matern52``.
        lengthscale: one number for every axis, or one per axis, in the axes' units.
    """

    name: str
    lengthscale: float | tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse an unknown name or a lengthscale that is not positive."""
        if self.name not in FAMILIES:
            raise UsageError(
                f"no kernel {self.name!r}{suggest(self.name, FAMILIES)} there are {one_of(FAMILIES)}"
            )
        if isinstance(self.lengthscale, Sequence):
            object.__setattr__(self, "lengthscale", tuple(float(value) for value in self.lengthscale))
        values = np.atleast_1d(self.lengthscale)
        if values.size == 0 or not (np.isfinite(values) & (values > 0)).all():
            raise UsageError(f"the lengthscale of {self.name} is {self.lengthscale}; it must be positive")

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

        kernel: Any = (
            MaternKernel(nu=2.5, ard_num_dims=dim) if self.name == "matern52" else RBFKernel(ard_num_dims=dim)
        )
        kernel = kernel.double()
        kernel.lengthscale = torch.from_numpy(self.lengthscales(dim).copy())
        return kernel.requires_grad_(False)

    def gram(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Return (n, m) values k(left_i, right_j) for (n, dim) and (m, dim) points."""
        import torch

        with torch.no_grad():
            kernel = _torch(self, left.shape[1])
            values = kernel(torch.from_numpy(np.array(left)), torch.from_numpy(np.array(right))).to_dense()
        return values.numpy()  # type: ignore[no-any-return]

    def interpolation(self, steps: FloatArray) -> float:
        """Bound e(h) = sup_z ‖φ(z) − Σ w_j(z) φ(g_j)‖ for multilinear weights on cells of (dim,) sides.

        For ‖J‖ ≤ B it follows that J(z) ≤ max over the cell's corners + B e(h).
        Linear interpolation errs by at most h²/8 max|∂²J| along each axis, and
        |∂²J| ≤ ‖J‖ sqrt(∂⁴k(0)) in the RKHS.
        """
        scales = self.lengthscales(steps.size)
        return float(np.sum(steps**2 / 8 * FAMILIES[self.name].curvature / scales**2))

    def steps_for(self, error: float, dim: int) -> FloatArray:
        """Return (dim,) cell sides whose interpolation bound is ``error``, shared equally by the axes."""
        return np.asarray(
            self.lengthscales(dim) * math.sqrt(8 * error / (dim * FAMILIES[self.name].curvature))
        )


@cache
def _torch(kernel: Kernel, dim: int) -> Any:
    return kernel.torch(dim)
