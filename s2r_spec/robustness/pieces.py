"""Parts of a batch of traces that fit into the processor's cache.

Several traces lie in one flat array, each followed by space for the samples that its windows reach. An operation on
the whole array mixes neighbours only in that space, which is not read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

A = TypeVar("A")  # of numpy or of torch


@dataclass(slots=True)
class BatchPiece(Generic[A]):
    """Samples ``start`` to ``end`` of some ``rows`` of a (k, n) batch, and flat work arrays.

    Each array of ``room`` has space for ``start`` to ``end`` and for the samples ahead, row after row. Its content is
    left over from the piece before.
    """

    rows: slice
    start: int
    end: int
    room: list[A]
    count: int

    def view(self, flat: A) -> Any:
        """Return (rows, end − start + ahead): a view of one work array by rows."""
        array: Any = flat
        return array.reshape(self.count, -1)

    def read(self, x: Any, flat: A, low: int, fill: float) -> None:
        """Copy the samples of x (k, n), from ``start + low`` on, into ``flat``, with ``fill`` past the end."""
        part = self.view(flat)
        first = self.start + low
        samples = x[self.rows, first : first + part.shape[1]]
        part[:, : samples.shape[1]] = samples
        part[:, samples.shape[1] :] = fill

    def write(self, flat: A, y: Any) -> None:
        """Copy the results at ``start`` to ``end`` from ``flat`` into y (k, n)."""
        y[self.rows, self.start : self.end] = self.view(flat)[:, : self.end - self.start]


def pieces(
    shape: tuple[int, ...], ahead: int | None, make: Sequence[Callable[[int], A]], size: int
) -> Iterator[BatchPiece[A]]:
    """Yield the pieces of a (k, n) batch.

    Args:
        shape: (k, n).
        ahead: samples after a piece that its windows reach; None for one more than the piece itself has, with
            the last piece first.
        make: the function for each work array that makes an array of a given length.
        size: approximate number of samples in each of them.
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
            yield BatchPiece(slice(row, row + here), start, end, [flat[:total] for flat in room], here)
