"""Parts of a batch of traces that are small enough to stay in the processor's cache.

Several traces lie in one flat array, each with room after it for the samples
that its windows reach. An operation on the whole array then mixes neighbours,
but only in that room, which nobody reads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

A = TypeVar("A")  # of numpy or of torch


@dataclass(slots=True)
class Piece(Generic[A]):
    """Samples ``start`` to ``end`` of some ``rows`` of a (k, n) batch, and flat arrays to work in.

    Each array of ``room`` has ``start`` to ``end`` and the samples ahead for row
    after row. What it holds is left over from the piece before.
    """

    rows: slice
    start: int
    end: int
    room: list[A]
    count: int

    def view(self, flat: A) -> Any:
        """Return (rows, end − start + ahead): one of the arrays, row by row."""
        array: Any = flat
        return array.reshape(self.count, -1)

    def read(self, x: Any, flat: A, low: int, fill: float) -> None:
        """Copy the samples from ``start + low`` on out of (k, n), with ``fill`` past the end."""
        part = self.view(flat)
        first = self.start + low
        there = x[self.rows, first : first + part.shape[1]]
        part[:, : there.shape[1]] = there
        part[:, there.shape[1] :] = fill

    def write(self, flat: A, y: Any) -> None:
        """Copy what stands at ``start`` to ``end`` into (k, n)."""
        y[self.rows, self.start : self.end] = self.view(flat)[:, : self.end - self.start]


def pieces(
    shape: tuple[int, ...], ahead: int | None, make: Sequence[Callable[[int], A]], size: int
) -> Iterator[Piece[A]]:
    """Yield the pieces of a (k, n) batch.

    Args:
        shape: (k, n).
        ahead: how many samples after a piece its windows reach; None for one more than
            the piece has itself, and the last piece first.
        make: for each array to work in, what makes it of a length.
        size: about how many samples each of them is to have.
    """
    k, n = shape
    length = min(n, size if ahead is None else max(size, 2 * ahead))
    rows = min(k, max(1, size // length))
    room: list[Any] = [empty(rows * (2 * length if ahead is None else length + ahead)) for empty in make]
    for row in range(0, k, rows):
        here = min(rows, k - row)
        starts = range(0, n, length)
        for start in starts if ahead is not None else reversed(starts):
            end = min(start + length, n)
            total = here * (end - start + (end - start if ahead is None else ahead))
            yield Piece(slice(row, row + here), start, end, [flat[:total] for flat in room], here)
