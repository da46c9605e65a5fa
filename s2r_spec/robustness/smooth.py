"""Minimum, windows and until on torch tensors, smooth in all their samples.

At a temperature T the smooth minimum of N numbers is −T·ln Σ exp(−x/T), which is below the exact minimum by at most
T·ln N. No sample may count twice, unlike in the exact minimum, so blocks do not overlap.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

_INF = float("inf")
Clamp = tuple["Tensor", ...]
Join = Callable[[Clamp, Clamp], Clamp]


class Smooth:
    """The operators at a temperature, in the unit of ρ."""

    def __init__(self, temperature: float) -> None:
        import torch

        self.torch, self.temperature = torch, temperature

    def least(self, x: Tensor, y: Tensor, /) -> Tensor:
        """Return the smooth minimum; with infinities the exact one, since the smooth one has no gradient there."""
        torch, t = self.torch, self.temperature
        infinite = torch.isinf(x) | torch.isinf(y)
        finite = [torch.where(infinite, 0.0, operand) for operand in (x, y)]
        smooth = -t * torch.logaddexp(-finite[0] / t, -finite[1] / t)
        result: Tensor = torch.where(infinite, torch.minimum(x, y), smooth)
        return result

    def window_min(self, x: Tensor, low: int, high: int | None) -> Tensor:
        """Return (…, n); see :func:`s2r_spec.robustness.kernels.window_min`."""
        n = x.shape[-1]
        (y,) = self._blocks((x,), n if high is None else min(high - low + 1, n), self._joined)
        return shift(y, low, _INF)

    def window_max(self, x: Tensor, low: int, high: int | None) -> Tensor:
        """Return (…, n); see :func:`s2r_spec.robustness.kernels.window_max`."""
        return -self.window_min(-x, low, high)

    def until(self, left: Tensor, right: Tensor, high: int | None) -> Tensor:
        """Return (…, n): :func:`s2r_spec.robustness.kernels.until` with the first witness now."""
        n = left.shape[-1]
        return self._blocks((left, right), n if high is None else min(high + 1, n), self._clamped)[1]

    def _joined(self, here: Clamp, there: Clamp) -> Clamp:
        return (self.least(here[0], there[0]),)

    def _clamped(self, here: Clamp, there: Clamp) -> Clamp:
        (p, q), (next_p, next_q) = here, there
        return self.least(p, next_p), -self.least(-q, -self.least(p, next_q))

    def _blocks(self, block: Clamp, count: int, join: Join) -> Clamp:
        """Join ``count`` consecutive samples from each one on, or all that are left, by doubling."""
        result: Clamp | None = None
        size, done = 1, 0
        while True:
            if count & 1:
                result = block if result is None else self._after(result, block, done, join)
                done += size
            count >>= 1
            if not count:
                assert result is not None
                return result
            block = self._after(block, block, size, join)
            size *= 2

    def _after(self, here: Clamp, there: Clamp, steps: int, join: Join) -> Clamp:
        n = here[0].shape[-1]
        if steps >= n:
            return here
        joined = join(tuple(x[..., : n - steps] for x in here), tuple(x[..., steps:] for x in there))
        return tuple(
            self.torch.cat((new, old[..., n - steps :]), -1) for new, old in zip(joined, here, strict=True)
        )


def shift(x: Tensor, steps: int, fill: float) -> Tensor:
    """Return y with y[t] = x[t + steps], steps ≥ 0; ``fill`` where there is no such sample."""
    import torch

    steps = min(steps, x.shape[-1])
    tail = x.new_full((*x.shape[:-1], steps), fill)
    return torch.cat((x[..., steps:], tail), -1)
