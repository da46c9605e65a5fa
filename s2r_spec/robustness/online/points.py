"""Robustness at one instant, as an interval that only shrinks.

If a formula needs an operator only at the first instant, nothing has to be computed for later instants: the minimum
so far is enough, however long the window is. Instants in the window whose values are not known yet enter with the
bounds of :meth:`~s2r_spec.robustness.online.terms.Term.bound`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from s2r_spec.robustness.online.clock import OnlineClock
from s2r_spec.robustness.online.spans import Span
from s2r_spec.robustness.online.tape import lesser
from s2r_spec.robustness.online.terms import LOWER, UPPER, AdjacentSample, Least, Negative, Rise, Scaled, Term
from s2r_spec.robustness.online.timed import Always, Clamp, Timed, Until, followed_by

OFTEN = 1024
"""Budget: undecided instants that are updated at each sample; h of them are updated at every (h / OFTEN)-th one."""


class Points:
    """Makes the points of terms; each point is made once."""

    def __init__(self) -> None:
        self.done: dict[tuple[int, int], Point] = {}

    def __call__(self, term: Term, k: int) -> Point:
        """Return the point of a term at instant k; call it before the first sample."""
        key = (id(term), k)
        if key not in self.done:
            self.done[key] = self._point(term, k)
        return self.done[key]

    def _point(self, term: Term, k: int) -> Point:
        match term:
            case Scaled() | Negative() | Least():
                return MappedAt(term, *(self(operand, k) for operand in term.operands))
            case AdjacentSample():
                near = k + term.shift
                return MinusInfinity(term.clock) if near < 0 else StepAt(self(term.operand, near), near)
            case Rise() if k == 0:
                return MinusInfinity(term.clock)
            case Rise():
                return MappedAt(term, self(term.operand, k), self(term.operand, k - 1))
            case Always(past=False):
                return AlwaysAt(term, k)
            case Until(past=False):
                return UntilAt(term, k)
            case _:
                return FollowedAt(term, k)


class Point(ABC):
    """ρ of a formula at one instant: in [lower, upper] for every continuation of the trace."""

    def __init__(self, clock: OnlineClock) -> None:
        self.clock = clock
        self.lower, self.upper = -math.inf, math.inf
        self.settled = False
        self._round = -1

    def refresh(self) -> None:
        """Update the bounds with the samples so far."""
        if self.settled or self._round == self.clock.round:
            return
        self._round = self.clock.round
        (low, high), self.settled = self._evaluate()
        if not self.settled:
            # earlier bounds stay valid, also if not every instant was updated
            low, high = max(self.lower, low), min(self.upper, high)
        self.lower, self.upper = low, high

    @abstractmethod
    def _evaluate(self) -> tuple[Span, bool]:
        """Return bounds, and whether they are final."""


class MinusInfinity(Point):
    """−inf."""

    def _evaluate(self) -> tuple[Span, bool]:
        return (-math.inf, -math.inf), True


class MappedAt(Point):
    """The value of a term without a window, from points of its operands."""

    def __init__(self, term: Term, *operands: Point) -> None:
        super().__init__(term.clock)
        self.term, self.operands = term, operands

    def _evaluate(self) -> tuple[Span, bool]:
        for operand in self.operands:
            operand.refresh()
        span = self.term.span(*((operand.lower, operand.upper) for operand in self.operands))
        return span, all(operand.settled for operand in self.operands)


class StepAt(Point):
    """The operand at the neighbouring sample; −inf if the trace has none."""

    def __init__(self, operand: Point, k: int) -> None:
        super().__init__(operand.clock)
        self.operand, self.k = operand, k

    def _evaluate(self) -> tuple[Span, bool]:
        exists = self.k <= self.clock.now
        if self.clock.ended and not exists:
            return (-math.inf, -math.inf), True
        self.operand.refresh()
        return (self.operand.lower, self.operand.upper), self.operand.settled and exists


class FollowedAt(Point):
    """The value of a followed term at one instant."""

    def __init__(self, term: Term, k: int) -> None:
        super().__init__(term.clock)
        self.term, self.k = term, k
        term.follow()
        term.keep(lambda: term.end if self.settled else k)

    def _evaluate(self) -> tuple[Span, bool]:
        term, k = self.term, self.k
        if k < term.end:
            value = term.value(k)
            return (value, value), True
        if k > self.clock.now:
            return term.ahead, False
        return (float(term.bound(k, k, LOWER)[0]), float(term.bound(k, k, UPPER)[0])), False


class WindowPoint(Point):
    """An operator with a window, at one instant; the monitor follows its operands.

    Args:
        term: the operator.
        k: the instant.
    """

    def __init__(self, term: Timed, k: int) -> None:
        super().__init__(term.clock)
        self.term, self.k, self.operands = term, k, term.operands
        self.at = 0.0  # position of the instant
        self.new = k  # the first instant that was not added
        self.taken = 0  # how many of them lie in the window
        self.waiting = False  # whether some instants of the window are not decided yet
        self.looked = -1  # the instant of the last update of undecided instants
        for operand in self.operands:
            operand.follow()
            operand.keep(self._oldest)
        self.clock.positions.keep(self._oldest)

    def _oldest(self) -> int:
        return max(operand.end for operand in self.operands) if self.settled else self.new

    def _evaluate(self) -> tuple[Span, bool]:
        clock, term, k = self.clock, self.term, self.k
        if k > clock.now:
            return term.ahead, False
        if self.new == k:
            self.at = clock.position(k)
        end = min([operand.decided.end for operand in self.operands])
        begin, stop = term.begin(k, self.new, end, self.at), term.stop(k, self.new, end, self.at)
        while self.new < end and self.new < stop:
            self._take(self.new, self.new >= begin)
            self.new += 1
        self.waiting = self.new <= clock.now and self.new < stop
        closed = clock.closed(term.reach, self.at)
        if closed and not self.waiting:
            if not self.taken:
                clock.check_empty(term.reach, k, self.at)
            value = self._value()
            return (value, value), True
        if not self.waiting or self._looks_away():
            return self._bounds(None, not closed or self.waiting), False
        self.looked = clock.now
        return self._bounds(self._undecided_range(), not closed), False

    def _looks_away(self) -> bool:
        """Return whether to treat undecided instants as unknown this time, to keep the cost of a sample constant."""
        return self.clock.now - self.looked < (self.clock.now - self.new + 1) // OFTEN

    def _undecided_range(self) -> tuple[int, int, int]:
        """Return (first, begin, last): the undecided instants, and the first one in the window."""
        clock, new, term = self.clock, self.new, self.term
        if term.lag is not None:
            return new, max(new, self.k + term.low), min(clock.now, self.k + term.lag - 1)
        positions = clock.positions.values(new, clock.now + 1)
        begin, end = term.reach.samples(positions, np.array([self.at]), clock.snap)
        return new, new + int(begin[0]), new + int(end[0])

    @abstractmethod
    def _take(self, k: int, inside: bool) -> None:
        """Add the decided values of an instant, which lies before the window or ``inside`` it."""

    @abstractmethod
    def _value(self) -> float:
        """Return ρ of the instants that were added."""

    @abstractmethod
    def _bounds(self, unsettled: tuple[int, int, int] | None, more: bool) -> Span:
        """Return bounds of ρ, with the undecided instants and, if ``more``, with later unknown ones."""


class AlwaysAt(WindowPoint):
    """The least of x in the window."""

    def __init__(self, term: Always, k: int) -> None:
        super().__init__(term, k)
        self.operand = term.operand
        self.least = math.inf

    def _take(self, k: int, inside: bool) -> None:
        if inside:
            self.taken += 1
            self.least = lesser(self.least, self.operand.value(k))

    def _value(self) -> float:
        return self.least

    def _bounds(self, unsettled: tuple[int, int, int] | None, more: bool) -> Span:
        x, ends = self.operand, [self.least, self.least]
        for side in (LOWER, UPPER):
            # no undecided instant is below the least possible value of later ones
            if unsettled is not None and not (more and side == LOWER):
                new, begin, last = unsettled
                if (first := max(new, begin)) <= last:
                    least = x.ahead[side] if x.flat[side] else float(x.bound(first, last, side).min())
                    ends[side] = min(ends[side], least)
            if more:
                ends[side] = min(ends[side], x.ahead[side])
        return ends[LOWER], ends[UPPER]


class UntilAt(WindowPoint):
    """The best witness in the window."""

    def __init__(self, term: Until, k: int) -> None:
        super().__init__(term, k)
        self.until = term
        self.clamp: Clamp = (math.inf, -math.inf)

    def _take(self, k: int, inside: bool) -> None:
        self.taken += inside
        right = self.until.right.value(k) if inside else -math.inf
        self.clamp = followed_by(self.clamp, (self.until.left.value(k), right))

    def _value(self) -> float:
        return self.clamp[1]

    def _bounds(self, unsettled: tuple[int, int, int] | None, more: bool) -> Span:
        return self._bound(unsettled, more, LOWER), self._bound(unsettled, more, UPPER)

    def _bound(self, unsettled: tuple[int, int, int] | None, more: bool, side: int) -> float:
        until = self.until
        p, q = self.clamp
        if unsettled is not None:
            new, begin, last = unsettled
            left, right = until.left.bound(new, last, side), until.right.bound(new, last, side)
            guards = np.minimum.accumulate(np.concatenate(([p], left)))
            offers = np.minimum(guards[:-1], right)[max(begin - new, 0) :]
            p, q = float(guards[-1]), max(q, float(offers.max(initial=-math.inf)))
        if more:
            # an instant that was not updated counts as a later one, which may matter or not
            waits = until.waits(np.array([self.at]), side)[0] or (
                side == LOWER and unsettled is None and self.waiting
            )
            guard = min(p, until.left.ahead[side]) if waits else p
            q = max(q, min(guard, until.right.ahead[side]))
        return q
