"""Window and until operators on torch tensors, with the exact sub-gradient.

The numbers and the method are the same as in :mod:`s2r_spec.robustness.kernels`. Each result is one of the input
samples. Its index is computed along with it, and the whole gradient goes to that sample (to the earliest of equal
ones). A gradient through every pass would take ten times as long.

This module needs torch, so it is imported only when there is a tensor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch  # noqa: TID253
from torch import Tensor  # noqa: TID253

from s2r_spec.robustness.pieces import pieces

PIECE = 1 << 14
"""Budget: samples in one pass on a processor; with their indices they fill its second-level cache."""
RUN = 1 << 12
"""Budget: the same for unbounded windows, for which fewer samples take fewer passes."""

INF = float("inf")

least = torch.minimum


def window_min(x: Tensor, low: int, high: int | None) -> Tensor:
    """Return (…, n); see :func:`s2r_spec.robustness.kernels.window_min`."""
    return _take(partial(_windows, least=True), (x,), (INF,), low, high)


def window_max(x: Tensor, low: int, high: int | None) -> Tensor:
    """Return (…, n); see :func:`s2r_spec.robustness.kernels.window_max`."""
    return _take(partial(_windows, least=False), (x,), (-INF,), low, high)


def until(left: Tensor, right: Tensor, high: int | None) -> Tensor:
    """Return (…, n): :func:`s2r_spec.robustness.kernels.until` with the first witness now."""
    return _take(_untils, (left, right), (INF, -INF), 0, high)


class Selected(NamedTuple):
    """Flat samples, and the index of the input sample that each was taken from; None without gradients."""

    values: Tensor
    places: Tensor | None

    def part(self, first: int, last: int) -> Selected:
        """Return the samples from ``first`` to before ``last``."""
        return Selected(self.values[first:last], None if self.places is None else self.places[first:last])


Work = Callable[[Sequence[Selected], Selected, Tensor, int], Selected]


def _take(
    work: Work, sources: Sequence[Tensor], fills: Sequence[float], low: int, high: int | None
) -> Tensor:
    """Return (…, n): the samples that ``work`` selects from all sources, (…, n) each."""
    if torch.is_grad_enabled() and any(source.requires_grad for source in sources):
        taken: Tensor = _Taken.apply(work, fills, low, high, *sources)  # type: ignore[no-untyped-call]
        return taken
    return _select(work, sources, fills, low, high, places=False).values


class _Taken(torch.autograd.Function):
    """Selects samples from several sources; each gradient goes to the selected sample."""

    @staticmethod
    def forward(
        ctx: Any, work: Work, fills: Sequence[float], low: int, high: int | None, *sources: Tensor
    ) -> Tensor:
        values, places = _select(work, sources, fills, low, high, places=True)
        ctx.save_for_backward(places)
        ctx.counts = [source.shape[-1] for source in sources]
        return values

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        (places,), (grad,) = ctx.saved_tensors, grads
        samples = sum(ctx.counts)
        # the index after all samples stands for the infinity of an empty window
        into = grad.new_zeros((*grad.shape[:-1], samples + 1)).scatter_add(-1, places.long(), grad)
        return None, None, None, None, *torch.split(into[..., :samples], ctx.counts, -1)


def _select(
    work: Work, sources: Sequence[Tensor], fills: Sequence[float], low: int, high: int | None, places: bool
) -> Selected:
    """Return (…, n) values, and with ``places`` their indices in the concatenated sources, computed piece by piece.

    Args:
        work: computes the result of a piece from its samples, in place.
        sources: (…, n) each, of one shape.
        fills: the value for each source past its end.
        low: first sample of a window, relative to the present one.
        high: last one; None for the end.
        places: whether to return indices.
    """
    like, n = sources[0], sources[0].shape[-1]
    low, width = min(low, n), None if high is None or high - low >= n - 1 else high - low + 1
    reals = partial(torch.empty, dtype=like.dtype, device=like.device)
    wholes = partial(torch.empty, dtype=torch.int32, device=like.device)
    flags = partial(torch.empty, dtype=torch.bool, device=like.device)
    count = len(sources) + 1
    make = [*[reals] * count, flags, *[wholes] * (count if places else 0)]
    rows = [source.reshape(-1, n) for source in sources]
    result = Selected(torch.empty_like(rows[0]), wholes(rows[0].shape) if places else None)
    numbers = [_numbers(part * n, n, 2 * n + low, count * n - n, like.device) for part in range(count - 1)]
    size = like.numel() if like.device.type != "cpu" else RUN if width is None else PIECE
    for piece in pieces(rows[0].shape, None if width is None else width - 1, make, max(size, 1)):
        values, mask, positions = piece.room[:count], piece.room[count], piece.room[count + 1 :]
        arrays = [Selected(real, positions[i] if places else None) for i, real in enumerate(values)]
        for array, source, fill, number in zip(arrays, rows, fills, numbers, strict=False):
            piece.read(source, array.values, low, fill)
            if array.places is not None:
                part = piece.view(array.places)
                part[:] = number[piece.start + low : piece.start + low + part.shape[1]]
        m = piece.end - piece.start
        if width is None and piece.end < n:
            # the value of all later pieces counts as one more sample of the last source
            for into, known in zip(arrays[-2], result, strict=True):
                if into is not None and known is not None:
                    piece.view(into)[:, m] = known[piece.rows, piece.end]
        done = work(arrays[:-1], arrays[-1], mask, m + 1 if width is None else width)
        for out, known in zip(done, result, strict=True):
            if out is not None:
                piece.write(out, known)
    return Selected(
        result.values.reshape(like.shape),
        result.places.reshape(like.shape) if result.places is not None else None,
    )


def _numbers(first: int, n: int, count: int, nowhere: int, device: torch.device) -> Tensor:
    """Return (count,): the indices of n samples, then ``nowhere``."""
    numbers = torch.full((count,), nowhere, dtype=torch.int32, device=device)
    torch.arange(first, first + n, out=numbers[:n])
    return numbers


def _windows(arrays: Sequence[Selected], spare: Selected, mask: Tensor, width: int, least: bool) -> Selected:
    """Return the least or the greatest of ``width`` samples from each one on."""
    (block,), size, m = arrays, 1, mask.numel()
    while size < width:
        step = min(size, width - size)
        size, m = size + step, m - step
        _join(block.part(0, m), block.part(step, step + m), spare.part(0, m), mask[:m], least)
        block, spare = spare, block
    return block


def _untils(arrays: Sequence[Selected], spare: Selected, mask: Tensor, width: int) -> Selected:
    """Return the until over ``width`` witnesses from each sample on, as in ``kernels``."""
    (p, q), size, m = arrays, 1, mask.numel()
    while size < width:
        step = min(size, width - size)
        size, m = size + step, m - step
        before, now, later = p.part(0, m), q.part(0, m), spare.part(0, m)
        _join(before, q.part(step, step + m), later, mask[:m], least=True)
        _join(now, later, now, mask[:m], least=False)
        _join(before, p.part(step, step + m), later, mask[:m], least=True)
        p, spare = spare, p
    return q


def _join(one: Selected, other: Selected, out: Selected, mask: Tensor, least: bool) -> None:
    """Write the least or the greatest of both into ``out``; of equals, ``one``."""
    if out.places is not None:
        assert one.places is not None
        assert other.places is not None
        (torch.lt if least else torch.gt)(other.values, one.values, out=mask)
        torch.where(mask, other.places, one.places, out=out.places)
    (torch.minimum if least else torch.maximum)(one.values, other.values, out=out.values)
