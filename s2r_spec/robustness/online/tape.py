"""Bounded memory: the last values of a sequence, and sliding windows over them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Protocol, cast

import numpy as np

from s2r_spec.base.arrays import FloatArray

Reader = Callable[[], int]


class InstantSource(Protocol):
    """A sequence with a value at the instants 0, 1, 2, …, which become known in this order."""

    @property
    def end(self) -> int:
        """Number of instants with a known value."""

    def keep(self, reader: Reader) -> None:
        """Keep the values from the instant on that ``reader`` returns at any time."""

    def value(self, k: int) -> float:
        """Return the value of an instant with a known one."""


class Tape:
    """Numbers of consecutive instants; those that no reader needs any more are dropped.

    Appending takes constant time on average: the kept numbers are moved only after as many have been appended.
    """

    def __init__(self) -> None:
        self.end = 0
        self.base = 0  # the instant of data[0]
        self._hold(np.empty(64))
        self.readers: list[Reader] = []

    def keep(self, reader: Reader) -> None:
        """See :class:`InstantSource`."""
        self.readers.append(reader)

    def append(self, value: float) -> None:
        """Add the value of the next instant."""
        end = self.end
        try:
            self.cells[end - self.base] = value
        except IndexError:
            self._forget()
            self.cells[end - self.base] = value
        self.end = end + 1

    def value(self, k: int) -> float:
        """Return the value of an instant."""
        assert self.base <= k < self.end, "a reader needs a value that it did not keep"
        return self.cells[k - self.base]

    def values(self, first: int, stop: int) -> FloatArray:
        """Return (stop − first,): a view of the values of the instants first … stop − 1."""
        assert self.base <= first, "a reader needs a value that it did not keep"
        return self.data[first - self.base : stop - self.base]

    def _forget(self) -> None:
        first = min((reader() for reader in self.readers), default=self.end)
        kept = self.values(min(max(first, self.base), self.end), self.end)
        self.base = self.end - kept.size
        size = self.data.size if 2 * kept.size <= self.data.size else 2 * self.data.size
        data = np.empty(size)
        data[: kept.size] = kept
        self._hold(data)

    def _hold(self, data: FloatArray) -> None:
        self.data = data
        # the same memory: it reads and writes a single number in half the time
        self.cells = cast("memoryview[float]", data.data)


class SlidingSum:
    """A queue of numbers with their sum, without a subtraction, which would accumulate rounding.

    It consists of two stacks. When the front stack is empty, the back stack is reversed onto it, and each number is
    added to all newer ones. The time for a number is constant on average, for any length of the queue.

    Args:
        forgets: whether numbers leave; if not, none is kept.
    """

    def __init__(self, forgets: bool = True) -> None:
        self.forgets = forgets
        self.front: list[
            float
        ] = []  # sums of each old number and all newer ones in front; the oldest is last
        self.back: list[float] = []
        self.back_sum = 0.0

    def push(self, number: float) -> None:
        """Add the newest number."""
        self.back_sum += number
        if self.forgets:
            self.back.append(number)

    def pop(self) -> None:
        """Remove the oldest number."""
        if not self.front:
            total = 0.0
            while self.back:
                total += self.back.pop()
                self.front.append(total)
            self.back_sum = 0.0
        self.front.pop()

    @property
    def total(self) -> float:
        """The sum of all numbers."""
        return self.front[-1] + self.back_sum if self.front else self.back_sum


class SlidingLeast:
    """The least number of a window that moves on, by a queue of the numbers that are less than all later ones.

    Args:
        forgets: whether numbers leave; if not, only the least one is kept.
    """

    def __init__(self, forgets: bool = True) -> None:
        self.forgets = forgets
        self.queue: deque[tuple[int, float]] = deque()  # (instant, number), both increasing

    def push(self, k: int, number: float) -> None:
        """Add the number of an instant, which is later than all before."""
        queue = self.queue
        while queue and queue[-1][1] >= number:
            queue.pop()
        if self.forgets or not queue:
            queue.append((k, number))

    def since(self, first: int) -> float:
        """Forget the numbers before an instant, and return the least of the others; inf if there is none."""
        queue = self.queue
        while queue and queue[0][0] < first:
            queue.popleft()
        return queue[0][1] if queue else math.inf


def lesser(x: float, y: float) -> float:
    """Return the smaller number; NaN if one is."""
    return x if x < y or x != x else y


def greater(x: float, y: float) -> float:
    """Return the greater number; NaN if one is."""
    return x if x > y or x != x else y
