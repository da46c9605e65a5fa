"""Terms with a window: always and until, and their counterparts in the past."""

from __future__ import annotations

import math

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray, IntArray
from s2r_spec.base.errors import UsageError
from s2r_spec.lang.source import Span as Place
from s2r_spec.robustness.kernels import range_min, range_until, until
from s2r_spec.robustness.online.clock import OnlineClock
from s2r_spec.robustness.online.spans import Span
from s2r_spec.robustness.online.tape import Sliding, SlidingLeast, lesser
from s2r_spec.robustness.online.terms import LOWER, UPPER, Stored, Term
from s2r_spec.robustness.ticks import Reach

FAR = 2**60
"""Definition: more samples than any trace has."""


class Timed(Stored):
    """An operator with a window.

    Args:
        clock: the clock of the trace.
        reach: the window of the operator.
        past: whether it looks back.
        place: the place of the operator in the text.
        operands: its operands.
    """

    def __init__(self, clock: OnlineClock, reach: Reach, past: bool, place: Place, *operands: Term) -> None:
        super().__init__(clock, *operands)
        self.reach, self.past, self.place = reach, past, place
        self.first = 0  # the oldest instant in the window of the last decided one
        self.new = 0  # the first instant that was in no window yet
        self.low, high = (int(min(max(end, -FAR), FAR)) for end in (reach.low, reach.high))
        # with a period, the window of instant k has the instants k + low … k + lag - 1
        self.lag = None if clock.period is None else high + 1
        self._known = (-1, 0, 0), (np.empty(0, np.intp), np.empty(0, np.intp))  # windows, for either bound

    def _prepare(self) -> None:
        if self.reach.high == math.inf:
            raise UsageError(
                f"`{' '.join(self.place.text.split())}` ({self.place.place}) needs the whole rest of the trace "
                f"at every instant, which takes unbounded memory; give it a time bound"
            )
        self.clock.positions.keep(self.oldest)
        for operand in self.operands:
            operand.keep(self.oldest)

    @property
    def _now(self) -> bool:
        """Whether the window has the instant itself, at its nearer end."""
        reach = self.reach
        if self.past:
            return reach.high == 0 and reach.high_closed
        return reach.low == 0 and reach.low_closed

    def oldest(self) -> int:
        """Return the first instant of the operands that is still needed."""
        return min(self.new if self.reach.low == -math.inf else self.first, self.tape.end)

    def stop(self, k: int, new: int, end: int, at: float | None = None) -> int:
        """Return the number of instants that do not lie after the window of instant k.

        It is greater than ``end`` if instants from there on or later samples can lie in it. Those before ``new``, at
        most ``end``, do not lie after it. ``at``: the position of k, if it was not kept.
        """
        clock, reach = self.clock, self.reach
        if self.lag is not None:
            return k + self.lag
        at = clock.position(k) if at is None else at
        while new <= clock.now and not reach.after(clock.position(new), at, clock.snap):
            if new == end:
                return end + 1
            new += 1
        return new if clock.closed(reach, at) else clock.now + 2

    def begin(self, k: int, first: int, end: int, at: float | None = None) -> int:
        """Return the first instant from ``first`` on that does not lie before the window of instant k, or ``end``."""
        if self.lag is not None:
            begin = k + self.low
            return first if begin < first else begin if begin < end else end
        if self.reach.low > -math.inf:
            clock = self.clock
            at = clock.position(k) if at is None else at
            while first < end and self.reach.before(clock.position(first), at, clock.snap):
                first += 1
        return first

    def _windows(self, first: int, last: int) -> tuple[IntArray, IntArray]:
        """Return the first and the last instant in the windows of the instants ``first`` … ``last``.

        A window that later samples can enter ends with the instant after the newest one.
        """
        clock, base = self.clock, self.oldest()
        key = (clock.now, first, last)
        if self._known[0] != key:
            if self.lag is not None:
                begin = np.arange(first + self.low, last + self.low + 1)
                end = np.arange(first + self.lag - 1, last + self.lag)
                begin = np.minimum(np.maximum(begin, base), clock.now + 1)
                end = np.minimum(np.maximum(end, base - 1), clock.now + (not clock.ended))
                self._known = key, (begin, end)
                return begin, end
            positions = clock.positions.values(base, clock.now + 1)
            at = positions[first - base : last + 1 - base]
            begin, end = self.reach.samples(positions, at, clock.snap)
            if not clock.ended:
                end[at + self.reach.high - clock.snap > clock.latest] = positions.size
            self._known = key, (begin + base, end + base)
        return self._known[1]


class Always(Timed):
    """The least of x in the window; +inf where it is empty."""

    def __init__(self, clock: OnlineClock, operand: Term, reach: Reach, past: bool, place: Place) -> None:
        super().__init__(clock, reach, past, place, operand)
        self.operand = operand
        self.least = SlidingLeast(forgets=reach.low > -math.inf)

    def advance(self) -> None:
        """See :class:`Stored`."""
        clock, tape, operand, least = self.clock, self.tape, self.operand, self.least
        now, end, new, lag = clock.now, operand.decided.end, self.new, self.lag
        while (k := tape.end) <= now:
            stop = k + lag if lag is not None else self.stop(k, new, end)
            while new < stop and new < end:
                least.push(new, operand.value(new))
                new += 1
            self.new = new
            if new < stop and (new <= now or not clock.ended):
                return
            self.first = first = self.begin(k, self.first, new)
            if first == new:
                clock.check_empty(self.reach, k, clock.position(k))
            tape.append(least.since(first))

    def span(self, *operands: Span) -> Span:
        """See :class:`Term`."""
        ((low, high),) = operands
        # a window of the past may lie before the first sample, and be empty
        return low, (math.inf if self.past and not self._now else high)

    def foresee(self) -> None:
        """See :class:`Term`."""
        super().foresee()
        # an open window has any later instant, and another one has an undecided instant
        self.flat = self.operand.flat[LOWER], False

    def _pending(self, first: int, last: int, side: int) -> FloatArray:
        if self.reach.low == -math.inf:
            return np.full(last - first + 1, self.ahead[side])
        begin, end = self._windows(first, last)
        base, stop = int(begin[0]), min(int(end.max()), self.clock.now)
        seen = self.operand.bound(base, stop, side) if base <= stop else np.empty(0)
        values = np.concatenate((seen, [self.operand.ahead[side]]))
        if end[0] == end[-1] >= begin[-1]:  # all open windows end with the newest instant
            rest = np.minimum.accumulate(values[: end[0] - base + 1][::-1])[::-1]
            return rest[begin - base]
        return range_min(values, begin - base, end - base)


Clamp = tuple[float, float]
"""(p, q): the map of the robustness v of later witnesses to max(q, min(p, v))."""


def followed_by(first: Clamp, then: Clamp) -> Clamp:
    """Return the composition of two clamps; see :func:`s2r_spec.robustness.kernels.until`."""
    p, q = first
    guard, offer = then
    if p < offer:
        offer = p
    return p if p < guard else guard, q if q > offer else offer


class Until(Timed):
    """The robustness of the best witness; −inf where the window is empty."""

    def __init__(
        self, clock: OnlineClock, left: Term, right: Term, reach: Reach, past: bool, place: Place
    ) -> None:
        super().__init__(clock, reach, past, place, left, right)
        self.left, self.right = left, right
        self.witnesses = Sliding[Clamp](
            (lambda older, newer: followed_by(newer, older)) if past else followed_by,
            (math.inf, -math.inf),
            forgets=reach.low > -math.inf,
        )
        self.guard = SlidingLeast()  # left between an instant and its window
        self.guarded = 0  # the first instant that was not in the guard yet

    def advance(self) -> None:
        """See :class:`Stored`."""
        clock, tape, guard, witnesses = self.clock, self.tape, self.guard, self.witnesses
        left, right, past, lag = self.left.value, self.right.value, self.past, self.lag
        now, ready, end, new = clock.now, self.left.decided.end, self.right.decided.end, self.new
        if ready < end:
            end = ready
        while (k := tape.end) <= now:
            stop = k + lag if lag is not None else self.stop(k, new, end)
            while new < stop and new < end:
                witnesses.push((left(new), right(new)))
                new += 1
            self.new = new
            if (new < stop and (new <= now or not clock.ended)) or (past and ready <= k):
                return
            begin = self.begin(k, self.first, new)
            while self.first < begin:
                witnesses.pop()
                self.first += 1
            start, stop = (new, k + 1) if past else (k, begin)
            guarded = self.guarded if self.guarded > start else start
            while guarded < stop:
                guard.push(guarded, left(guarded))
                guarded += 1
            self.guarded = guarded
            if begin == new:
                clock.check_empty(self.reach, k, clock.position(k))
            best = witnesses.total()[1]
            tape.append(lesser(guard.since(start), best) if guard.queue else best)

    def span(self, *operands: Span) -> Span:
        """See :class:`Term`."""
        left, right = operands
        if self._now:
            return right
        # a window of the past may lie before the first sample, and be empty
        low = -math.inf if self.past else min(left[LOWER], right[LOWER])
        return low, min(left[UPPER], right[UPPER])

    def waits(self, at: FloatArray, side: int) -> BoolArray:
        """Return (m,): whether ``left`` matters at later instants before the windows of (m,) instants begin.

        Without a period there may be no such instant, so no upper bound uses it.
        """
        latest = self.clock.latest
        if self.clock.period is not None:
            return at + self.reach.low > latest + 1
        begin, _ = self.reach.samples(np.array([latest]), at, self.clock.snap)
        return np.asarray((begin > 0) & (side == LOWER))

    def _pending(self, first: int, last: int, side: int) -> FloatArray:
        if self.reach.low == -math.inf:
            return np.full(last - first + 1, self.ahead[side])
        if self.past:
            return self._pending_since(first, last, side)
        clock, now = self.clock, self.clock.now
        left = np.concatenate((self.left.bound(first, now, side), [math.inf]))
        right = np.concatenate((self.right.bound(first, now, side), [self.right.ahead[side]]))
        # any later instant may be the witness
        if self._now and not clock.closed(self.reach, clock.position(first)):
            return until(left, right, 0, None)[: last - first + 1]
        begin, end = (np.concatenate((ends, [now + 1])) - first for ends in self._windows(first, now))
        at = clock.positions.values(first, now + 1)
        bounds = range_until(left, right, begin, end)[:-1]
        bounds = np.where(self.waits(at, side), np.minimum(bounds, self.left.ahead[side]), bounds)
        return bounds[: last - first + 1]

    def _pending_since(self, first: int, last: int, side: int) -> FloatArray:
        base = min(int(self._windows(first, last)[0][0]), first)
        begin, end = (ends - base for ends in self._windows(base, last))
        # instants before the first one are not needed, so their windows may begin anywhere
        begin = np.maximum(begin, 0)
        left, right = (operand.bound(base, last, side)[::-1] for operand in (self.left, self.right))
        newest = last - base
        bounds = range_until(left, right, newest - end[::-1], newest - begin[::-1])
        return bounds[::-1][first - base :]
