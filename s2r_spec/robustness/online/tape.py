"""Bounded memory: the last values of a sequence, and sliding windows over them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar, cast

import numpy as np

from s2r_spec.base.arrays import FloatArray

Reader = Callable[[], int]
T = TypeVar("T")


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


class Sliding(Generic[T]):
    """A queue with the combination of all its elements, for any associative operation.

    It consists of two stacks. When the front stack is empty, the back stack is reversed onto it, and each element is
    combined with all newer ones. The time for an element is constant on average, for any length of the queue.

    Args:
        combine: (older, newer) → both together; associative.
        neutral: neutral element, the combination of an empty queue.
        forgets: whether elements leave; if not, none is kept.
    """

    def __init__(self, combine: Callable[[T, T], T], neutral: T, forgets: bool = True) -> None:
        self.combine = combine
        self.neutral = neutral
        self.forgets = forgets
        self.front: list[T] = []  # of each old element and all newer ones in front; the oldest is last
        self.back: list[T] = []
        self.back_all = neutral

    def push(self, element: T) -> None:
        """Add the newest element."""
        self.back_all = self.combine(self.back_all, element)
        if self.forgets:
            self.back.append(element)

    def pop(self) -> None:
        """Remove the oldest element."""
        if not self.front:
            total, combine = self.neutral, self.combine
            while self.back:
                total = combine(self.back.pop(), total)
                self.front.append(total)
            self.back_all = self.neutral
        self.front.pop()

    def total(self) -> T:
        """Return the combination of all elements, oldest first."""
        return self.combine(self.front[-1], self.back_all) if self.front else self.back_all


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
