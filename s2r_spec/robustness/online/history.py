"""Functions of a signal's past, computed online; see :mod:`s2r_spec.robustness.history`.

Each stream computes one number for each instant, in constant time on average, and keeps the samples of its window.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from operator import add

from s2r_spec.robustness.online.clock import Component, InstantNumber, OnlineClock
from s2r_spec.robustness.online.tape import Sliding, Tape


class TapedNumber(ABC):
    """A number at each instant, stored on a tape.

    Args:
        clock: the clock of the trace.
        operand: the operand, or the robustness of the condition.
        part: its component that is read.
    """

    def __init__(self, clock: OnlineClock, operand: InstantNumber, part: Component) -> None:
        self.clock, self.operand, self.part = clock, operand, part
        self.tape = Tape()
        operand.keep(self._oldest)
        clock.positions.keep(self._oldest)

    def advance(self) -> None:
        """Compute all values that the samples so far determine."""
        tape, ready = self.tape, self._ready()
        while (k := tape.end) < ready:
            tape.append(self._compute(k))

    def _oldest(self) -> int:
        """Return the first instant that is still needed."""
        return self.tape.end

    def _ready(self) -> int:
        """Return the number of instants that can be computed."""
        return self.operand.end(self.clock)

    @abstractmethod
    def _compute(self, k: int) -> float:
        """Return the number at the next instant."""


class Delayed(TapedNumber):
    """x at the last sample at or before t − seconds, or else the first one."""

    def __init__(self, clock: OnlineClock, operand: InstantNumber, part: Component, seconds: float) -> None:
        super().__init__(clock, operand, part)
        self.seconds = seconds
        self.shown = 0

    def _oldest(self) -> int:
        return self.shown

    def _compute(self, k: int) -> float:
        latest = self.clock.seconds(k) - self.seconds + self.clock.slack
        while self.shown < k and self.clock.seconds(self.shown + 1) <= latest:
            self.shown += 1
        return self.part(self.shown)


class Derivative(TapedNumber):
    """Backward difference quotient [1/s]; the first sample has the value of the second."""

    def _oldest(self) -> int:
        return self.tape.end - 1

    def _ready(self) -> int:
        end = self.operand.end(self.clock)
        return end if end > 1 or self.clock.ended else 0

    def _compute(self, k: int) -> float:
        if k == 0 and self.operand.end(self.clock) == 1:
            return 0.0
        last = max(k, 1)
        step = self.clock.seconds(last) - self.clock.seconds(last - 1)
        return (self.part(last) - self.part(last - 1)) / step


class Accumulated(TapedNumber):
    """The integral of straight lines over the last ``seconds``, or their mean."""

    def __init__(
        self, clock: OnlineClock, operand: InstantNumber, part: Component, seconds: float, mean: bool
    ) -> None:
        super().__init__(clock, operand, part)
        self.seconds, self.mean = seconds, mean
        # a running total with subtraction would accumulate rounding
        self.areas = Sliding[float](add, 0.0, forgets=math.isfinite(seconds))
        self.samples = Tape()
        self.oldest = 0
        self.last = self.last_x = 0.0  # time [s] and number of the last instant
        self.samples.keep(self._oldest_needed)
        clock.positions.keep(self._oldest_needed)

    def _oldest_needed(self) -> int:
        return min(self.oldest, self.tape.end - 1) if math.isfinite(self.seconds) else self.tape.end - 1

    def _compute(self, k: int) -> float:
        seconds, samples, areas = self.clock.seconds, self.samples, self.areas
        now, x = seconds(k), self.part(k)
        samples.append(x)
        if k:
            areas.push((now - self.last) * (x + self.last_x) / 2)
        self.last, self.last_x, elapsed = now, x, now
        if math.isfinite(self.seconds):
            elapsed = now if now < self.seconds else self.seconds
            start = now - self.seconds if now > self.seconds else 0.0
            while self.oldest < k and seconds(self.oldest + 1) <= start:
                areas.pop()
                self.oldest += 1
            total = areas.total() - self._oldest_part(start, k)
        else:
            total = areas.total()
        if not self.mean:
            return total
        return total / elapsed if elapsed > 0 else x

    def _oldest_part(self, start: float, k: int) -> float:
        """Return the part of the oldest piece that lies before ``start``."""
        oldest, seconds, samples = self.oldest, self.clock.seconds, self.samples
        if oldest == k:
            return 0.0
        begin, x = seconds(oldest), samples.value(oldest)
        part, slope = start - begin, (samples.value(oldest + 1) - x) / (seconds(oldest + 1) - begin)
        return part * (x + slope * part / 2)


class Duration(TapedNumber):
    """Time for which a condition has held at every sample [s]."""

    since: float | None = None

    def _compute(self, k: int) -> float:
        now = self.clock.seconds(k)
        if self.part(k) < 0:
            self.since = None
            return 0.0
        if self.since is None:
            self.since = now
        return now - self.since


class Count(TapedNumber):
    """Number of samples in the last ``seconds`` at which a condition held."""

    def __init__(self, clock: OnlineClock, operand: InstantNumber, part: Component, seconds: float) -> None:
        super().__init__(clock, operand, part)
        self.seconds = seconds
        self.first, self.total = 0, 0

    def _oldest(self) -> int:
        return self.first if math.isfinite(self.seconds) else self.tape.end

    def _compute(self, k: int) -> float:
        self.total += self.part(k) > 0
        if math.isfinite(self.seconds):
            begin = self.clock.seconds(k) - self.seconds - self.clock.slack
            while self.clock.seconds(self.first) < begin:
                self.total -= self.part(self.first) > 0
                self.first += 1
        return float(self.total)
