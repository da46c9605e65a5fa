"""Functions of a signal's past, computed online; see :mod:`s2r_spec.robustness.history`.

Each stream computes one number for each instant, in constant time on average, and keeps the samples of its window.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import add
from typing import Protocol

from s2r_spec.robustness.online.clock import OnlineClock
from s2r_spec.robustness.online.tape import InstantSource, Reader, Sliding, Tape


class Operand(Protocol):
    """The operand of a function."""

    def end(self, clock: OnlineClock) -> int:
        """Return the number of instants with a known value."""
        ...

    def keep(self, reader: Reader) -> None:
        """See :class:`~s2r_spec.robustness.online.tape.InstantSource`."""
        ...


class ConditionSource(InstantSource, Protocol):
    """The robustness of a condition."""

    def value(self, k: int) -> float:
        """Return ρ at an instant with a known value."""
        ...


class TapedNumber:
    """A number at each instant, stored on a tape."""

    def __init__(self, clock: OnlineClock) -> None:
        self.clock = clock
        self.tape = Tape()

    def advance(self) -> None:
        """Compute all values that the samples so far determine."""
        for k in range(self.tape.end, self.ready()):
            self.tape.append(self.compute(k))

    def ready(self) -> int:
        """Return the number of instants that can be computed."""
        raise AssertionError

    def compute(self, k: int) -> float:
        """Return the number at the next instant."""
        raise AssertionError


class Delayed(TapedNumber):
    """x at the last sample at or before t − seconds, or else the first one."""

    def __init__(
        self, clock: OnlineClock, part: Callable[[int], float], operand: Operand, seconds: float
    ) -> None:
        super().__init__(clock)
        self.part, self.operand, self.seconds = part, operand, seconds
        self.shown = 0
        operand.keep(lambda: self.shown)
        clock.positions.keep(lambda: self.shown)

    def ready(self) -> int:
        """Return as many instants as the operand has, so that both end together."""
        return self.operand.end(self.clock)

    def compute(self, k: int) -> float:
        """See :class:`TapedNumber`."""
        latest = self.clock.seconds(k) - self.seconds + self.clock.slack
        while self.shown < k and self.clock.seconds(self.shown + 1) <= latest:
            self.shown += 1
        return self.part(self.shown)


class Derivative(TapedNumber):
    """Backward difference quotient [1/s]; the first sample has the value of the second."""

    def __init__(self, clock: OnlineClock, part: Callable[[int], float], operand: Operand) -> None:
        super().__init__(clock)
        self.part, self.operand = part, operand
        operand.keep(self._oldest)
        clock.positions.keep(self._oldest)

    def _oldest(self) -> int:
        return self.tape.end - 1

    def ready(self) -> int:
        """Return the number of instants; the first one needs the second sample."""
        end = self.operand.end(self.clock)
        return end if end > 1 or self.clock.ended else 0

    def compute(self, k: int) -> float:
        """See :class:`TapedNumber`."""
        if k == 0 and self.operand.end(self.clock) == 1:
            return 0.0
        last = max(k, 1)
        step = self.clock.seconds(last) - self.clock.seconds(last - 1)
        return (self.part(last) - self.part(last - 1)) / step


class Accumulated(TapedNumber):
    """The integral of straight lines over the last ``seconds``, or their mean."""

    def __init__(
        self, clock: OnlineClock, part: Callable[[int], float], operand: Operand, seconds: float, mean: bool
    ) -> None:
        super().__init__(clock)
        self.part, self.operand, self.seconds, self.mean = part, operand, seconds, mean
        # a running total with subtraction would accumulate rounding
        self.areas = Sliding[float](add, 0.0, forgets=math.isfinite(seconds))
        self.samples = Tape()
        self.oldest = 0
        operand.keep(lambda: self.tape.end)
        self.samples.keep(self._oldest_needed)
        clock.positions.keep(self._oldest_needed)

    def _oldest_needed(self) -> int:
        return min(self.oldest, self.tape.end - 1) if math.isfinite(self.seconds) else self.tape.end - 1

    def ready(self) -> int:
        """Return as many instants as the operand has."""
        return self.operand.end(self.clock)

    def compute(self, k: int) -> float:
        """See :class:`TapedNumber`."""
        now = self.clock.seconds(k)
        self.samples.append(self.part(k))
        if k:
            self.areas.push(self._area(k - 1, k))
        total = self.areas.total
        if math.isfinite(self.seconds):
            start = max(now - self.seconds, 0.0)
            while self.oldest < k and self.clock.seconds(self.oldest + 1) <= start:
                self.areas.pop()
                self.oldest += 1
            total = self.areas.total - self._oldest_part(start, k)
        if not self.mean:
            return total
        elapsed = min(now, self.seconds)
        return total / elapsed if elapsed > 0 else self.samples.value(k)

    def _area(self, left: int, right: int) -> float:
        step = self.clock.seconds(right) - self.clock.seconds(left)
        return step * (self.samples.value(right) + self.samples.value(left)) / 2

    def _oldest_part(self, start: float, k: int) -> float:
        """Return the part of the oldest piece that lies before ``start``."""
        if self.oldest == k:
            return 0.0
        begin, end = self.clock.seconds(self.oldest), self.clock.seconds(self.oldest + 1)
        x = self.samples.value(self.oldest)
        part, slope = start - begin, (self.samples.value(self.oldest + 1) - x) / (end - begin)
        return part * (x + slope * part / 2)


class Duration(TapedNumber):
    """Time for which a condition has held at every sample [s]."""

    def __init__(self, clock: OnlineClock, condition: ConditionSource) -> None:
        super().__init__(clock)
        self.condition = condition
        self.since: float | None = None
        condition.keep(lambda: self.tape.end)
        clock.positions.keep(lambda: self.tape.end)

    def ready(self) -> int:
        """Return as many instants as the condition has."""
        return self.condition.end

    def compute(self, k: int) -> float:
        """See :class:`TapedNumber`."""
        now = self.clock.seconds(k)
        if self.condition.value(k) < 0:
            self.since = None
            return 0.0
        if self.since is None:
            self.since = now
        return now - self.since


class Count(TapedNumber):
    """Number of samples in the last ``seconds`` at which a condition held."""

    def __init__(self, clock: OnlineClock, condition: ConditionSource, seconds: float) -> None:
        super().__init__(clock)
        self.condition, self.seconds = condition, seconds
        self.first, self.total = 0, 0
        condition.keep(self._oldest_needed)
        clock.positions.keep(self._oldest_needed)

    def _oldest_needed(self) -> int:
        return self.first if math.isfinite(self.seconds) else self.tape.end

    def ready(self) -> int:
        """Return as many instants as the condition has."""
        return self.condition.end

    def compute(self, k: int) -> float:
        """See :class:`TapedNumber`."""
        self.total += self.condition.value(k) > 0
        if math.isfinite(self.seconds):
            begin = self.clock.seconds(k) - self.seconds - self.clock.slack
            while self.clock.seconds(self.first) < begin:
                self.total -= self.condition.value(self.first) > 0
                self.first += 1
        return float(self.total)
