"""Window and until operators on torch tensors, with the exact sub-gradient.

The numbers are those of :mod:`s2r_spec.robustness.kernels`, found in the same
way. Each is one of the samples that went in; its place is found along with it,
and the gradient goes there whole (to the earliest of equal ones). A gradient
that went back through every pass would take ten times as long.

Nothing imports this module before there is a tensor: it needs torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch  # noqa: TID253
from torch import Tensor  # noqa: TID253

from s2r_spec.robustness.pieces import pieces

PIECE = 1 << 14
"""How many samples a processor works on at once: with their places they fill its second cache."""
RUN = 1 << 12
"""The same for windows without an end, where fewer samples take fewer passes."""

INF = float("inf")

least = torch.minimum


def window_min(x: Tensor, low: int, high: int | None) -> Tensor:
    """Return (…, n); see :func:`s2r_spec.robustness.kernels.window_min`."""
    return _taken(partial(_windows, least=True), (x,), (INF,), low, high)


def window_max(x: Tensor, low: int, high: int | None) -> Tensor:
    """Return (…, n); see :func:`s2r_spec.robustness.kernels.window_max`."""
    return _taken(partial(_windows, least=False), (x,), (-INF,), low, high)


def until(left: Tensor, right: Tensor, high: int | None) -> Tensor:
    """Return (…, n): :func:`s2r_spec.robustness.kernels.until` with the first witness now."""
    return _taken(_untils, (left, right), (INF, -INF), 0, high)


class Side(NamedTuple):
    """Flat samples, and the place that each was taken from, if that is asked for."""

    values: Tensor
    places: Tensor | None

    def part(self, first: int, last: int) -> Side:
        """Return the samples from ``first`` to before ``last``."""
        return Side(self.values[first:last], None if self.places is None else self.places[first:last])


Work = Callable[[Sequence[Side], Side, Tensor, int], Side]


def _taken(
    work: Work, sources: Sequence[Tensor], fills: Sequence[float], low: int, high: int | None
) -> Tensor:
    """Return (…, n): what ``work`` takes of the samples of all sources, (…, n) each."""
    if torch.is_grad_enabled() and any(source.requires_grad for source in sources):
        taken: Tensor = _Taken.apply(work, fills, low, high, *sources)  # type: ignore[no-untyped-call]
        return taken
    return _found(work, sources, fills, low, high, places=False).values


class _Taken(torch.autograd.Function):
    """Samples taken from several sources; each gradient goes where its sample came from."""

    @staticmethod
    def forward(
        ctx: Any, work: Work, fills: Sequence[float], low: int, high: int | None, *sources: Tensor
    ) -> Tensor:
        values, places = _found(work, sources, fills, low, high, places=True)
        ctx.save_for_backward(places)
        ctx.counts = [source.shape[-1] for source in sources]
        return values

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        (places,), (grad,) = ctx.saved_tensors, grads
        samples = sum(ctx.counts)
        # the place after all samples is where an empty window takes its infinity
        into = grad.new_zeros((*grad.shape[:-1], samples + 1)).scatter_add(-1, places.long(), grad)
        return None, None, None, None, *torch.split(into[..., :samples], ctx.counts, -1)


def _found(
    work: Work, sources: Sequence[Tensor], fills: Sequence[float], low: int, high: int | None, places: bool
) -> Side:
    """Return (…, n) values, and places in the sources one after another, found piece by piece.

    Args:
        work: makes the result of a piece out of its samples, in the room of these.
        sources: (…, n) each, of one shape.
        fills: what is past the end of each.
        low: first sample of a window, counted from now.
        high: last one; None for the end.
        places: whether they are asked for.
    """
    like, n = sources[0], sources[0].shape[-1]
    low, width = min(low, n), None if high is None or high - low >= n - 1 else high - low + 1
    reals = partial(torch.empty, dtype=like.dtype, device=like.device)
    wholes = partial(torch.empty, dtype=torch.int32, device=like.device)
    flags = partial(torch.empty, dtype=torch.bool, device=like.device)
    count = len(sources) + 1
    make = [*[reals] * count, flags, *[wholes] * (count if places else 0)]
    rows = [source.reshape(-1, n) for source in sources]
    result = Side(torch.empty_like(rows[0]), wholes(rows[0].shape) if places else None)
    numbers = [_numbers(part * n, n, 2 * n + low, count * n - n, like.device) for part in range(count - 1)]
    size = like.numel() if like.device.type != "cpu" else RUN if width is None else PIECE
    for piece in pieces(rows[0].shape, None if width is None else width - 1, make, max(size, 1)):
        values, mask, positions = piece.room[:count], piece.room[count], piece.room[count + 1 :]
        sides = [Side(real, positions[i] if places else None) for i, real in enumerate(values)]
        for side, source, fill, number in zip(sides, rows, fills, numbers, strict=False):
            piece.read(source, side.values, low, fill)
            if side.places is not None:
                part = piece.view(side.places)
                part[:] = number[piece.start + low : piece.start + low + part.shape[1]]
        m = piece.end - piece.start
        if width is None and piece.end < n:
            # what later pieces offer counts as one more sample of the last source
            for into, known in zip(sides[-2], result, strict=True):
                if into is not None and known is not None:
                    piece.view(into)[:, m] = known[piece.rows, piece.end]
        done = work(sides[:-1], sides[-1], mask, m + 1 if width is None else width)
        for out, known in zip(done, result, strict=True):
            if out is not None:
                piece.write(out, known)
    return Side(
        result.values.reshape(like.shape),
        result.places.reshape(like.shape) if result.places is not None else None,
    )


def _numbers(first: int, n: int, count: int, nowhere: int, device: torch.device) -> Tensor:
    """Return (count,): the places of n samples, and ``nowhere`` after them."""
    numbers = torch.full((count,), nowhere, dtype=torch.int32, device=device)
    torch.arange(first, first + n, out=numbers[:n])
    return numbers


def _windows(sides: Sequence[Side], spare: Side, mask: Tensor, width: int, least: bool) -> Side:
    """Return the least or the greatest of ``width`` samples from each one on."""
    (block,), size, m = sides, 1, mask.numel()
    while size < width:
        step = min(size, width - size)
        size, m = size + step, m - step
        _join(block.part(0, m), block.part(step, step + m), spare.part(0, m), mask[:m], least)
        block, spare = spare, block
    return block


def _untils(sides: Sequence[Side], spare: Side, mask: Tensor, width: int) -> Side:
    """Return the until over ``width`` witnesses from each sample on, as in ``kernels``."""
    (p, q), size, m = sides, 1, mask.numel()
    while size < width:
        step = min(size, width - size)
        size, m = size + step, m - step
        before, now, later = p.part(0, m), q.part(0, m), spare.part(0, m)
        _join(before, q.part(step, step + m), later, mask[:m], least=True)
        _join(now, later, now, mask[:m], least=False)
        _join(before, p.part(step, step + m), later, mask[:m], least=True)
        p, spare = spare, p
    return q


def _join(one: Side, other: Side, out: Side, mask: Tensor, least: bool) -> None:
    """Write the least or the greatest of both into ``out``; of equals, ``one``."""
    if out.places is not None:
        assert one.places is not None
        assert other.places is not None
        (torch.lt if least else torch.gt)(other.values, one.values, out=mask)
        torch.where(mask, other.places, one.places, out=out.places)
    (torch.minimum if least else torch.maximum)(one.values, other.values, out=out.values)
