"""Growing robustness signals: decided values, and bounds of the others.

A term is one operator. A followed term computes its values at the instants 0, 1, 2, … in this order, each as soon as
the samples decide it, in constant time on average. For other instants, :meth:`Term.bound` gives bounds, from the
bounds of its operands. If only one instant matters, :mod:`points` works without following the term.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.robustness.online.clock import Component, InstantNumber, OnlineClock
from s2r_spec.robustness.online.spans import ANY, Span, negate
from s2r_spec.robustness.online.tape import InstantSource, Reader, Tape, lesser
from s2r_spec.robustness.ties import rescale, rescale_number

LOWER, UPPER = 0, 1
"""Index of the lower and of the upper end of a span."""


class Term(ABC):
    """The robustness of a formula at every instant, from that of its operands."""

    def __init__(self, clock: OnlineClock, *operands: Term) -> None:
        self.clock, self.operands = clock, operands
        self.value: Component  # instant → ρ, where it is decided
        self.decided: InstantSource  # has as many known values
        self.ahead: Span = ANY  # contains ρ at every instant
        self.prompt = False  # whether every instant so far is decided
        self.flat = False, False  # whether either bound of each undecided instant is that of ``ahead``
        self._bounds: dict[tuple[int, int, int], FloatArray] = {}
        self._bounds_at = -1

    @property
    def end(self) -> int:
        """Number of instants with a decided value."""
        return self.decided.end

    def follow(self) -> None:
        """Begin to compute values; call it before the first sample."""
        for operand in self.operands:
            operand.follow()

    @abstractmethod
    def keep(self, reader: Reader) -> None:
        """See :class:`~s2r_spec.robustness.online.tape.InstantSource`."""

    @abstractmethod
    def span(self, *operands: Span) -> Span:
        """Return a span of ρ from spans of the operands, at the instants that they are read."""

    def foresee(self) -> None:
        """Compute :attr:`ahead` from the operands' ``ahead``."""
        self.ahead = self.span(*(operand.ahead for operand in self.operands))

    @abstractmethod
    def _bound(self, first: int, last: int, side: int) -> FloatArray:
        """See :meth:`bound`."""

    def bound(self, first: int, last: int, side: int) -> FloatArray:
        """Return (last − first + 1,): the lower or upper bound of ρ at instants up to now."""
        if self._bounds_at != self.clock.now:
            self._bounds.clear()
            self._bounds_at = self.clock.now
        key = (first, last, side)
        if key not in self._bounds:
            self._bounds[key] = self._bound(first, last, side)
        return self._bounds[key]


class Stored(Term):
    """A term that stores its values."""

    def __init__(self, clock: OnlineClock, *operands: Term) -> None:
        super().__init__(clock, *operands)
        self.decided = self.tape = Tape()
        self.value = self.tape.value
        self.followed = False

    def follow(self) -> None:
        """See :class:`Term`."""
        if not self.followed:
            self.followed = True
            self._prepare()
            super().follow()
            self.clock.streams.append(self)

    def keep(self, reader: Reader) -> None:
        """See :class:`Term`."""
        self.tape.readers.append(reader)

    def next(self) -> int:
        """Return the first instant that is not decided."""
        return self.tape.end

    def _bound(self, first: int, last: int, side: int) -> FloatArray:
        end = self.tape.end
        if first >= end:
            return self._pending(first, last, side)
        settled = self.tape.values(first, min(last + 1, end))
        if last < end:
            return settled
        return np.concatenate((settled, self._pending(end, last, side)))

    @abstractmethod
    def advance(self) -> None:
        """Compute all values that the samples so far decide."""

    @abstractmethod
    def _prepare(self) -> None:
        """Keep the values of the operands that are needed."""

    @abstractmethod
    def _pending(self, first: int, last: int, side: int) -> FloatArray:
        """Return bounds at instants that are all undecided."""


class Leaf(Stored):
    """A predicate, a boolean signal or a constant, without a window of its own; the algebra sets its ``ahead``.

    Args:
        clock: the clock of the trace.
        number: ρ.
        prompt: whether it reads samples alone, and is known at once.
    """

    def __init__(self, clock: OnlineClock, number: InstantNumber, prompt: bool) -> None:
        super().__init__(clock)
        self.prompt, self.flat = prompt, (True, True)
        self.number = number
        self.margin: Component = number.parts[0]

    def _prepare(self) -> None:
        self.number.keep(self.next)
        self.clock.positions.keep(self.next)  # for the message if a predicate is undefined

    def advance(self) -> None:
        """See :class:`Stored`."""
        tape, clock = self.tape, self.clock
        end = clock.now + 1 if self.prompt else self.number.end(clock)
        while (k := tape.end) < end:
            tape.append(self.margin(k))

    def span(self, *operands: Span) -> Span:
        """See :class:`Term`."""
        return self.ahead

    def _pending(self, first: int, last: int, side: int) -> FloatArray:
        return np.full(last - first + 1, self.ahead[side])


class Mapped(Term):
    """A term that computes its values from those of one operand, also of a neighbouring sample."""

    shift = 0
    """Definition: samples from an instant to the farthest one that is read."""

    def __init__(self, clock: OnlineClock, operand: Term) -> None:
        super().__init__(clock, operand)
        self.operand, self.decided = operand, operand.decided

    def keep(self, reader: Reader) -> None:
        """See :class:`Term`."""
        self.operand.keep((lambda: reader() + self.shift) if self.shift else reader)


class Negative(Mapped):
    """−x."""

    def __init__(self, clock: OnlineClock, operand: Term) -> None:
        super().__init__(clock, operand)
        value = operand.value
        self.value = lambda k: -value(k)

    def span(self, *operands: Span) -> Span:
        """See :class:`Term`."""
        return negate(*operands)

    def foresee(self) -> None:
        """See :class:`Term`."""
        super().foresee()
        self.prompt, self.flat = self.operand.prompt, self.operand.flat[::-1]

    def _bound(self, first: int, last: int, side: int) -> FloatArray:
        return -self.operand.bound(first, last, 1 - side)


class Scaled(Mapped):
    """factor · x, factor > 0."""

    def __init__(self, clock: OnlineClock, operand: Term, factor: float) -> None:
        super().__init__(clock, operand)
        self.factor = factor
        self.value = lambda k: rescale_number(operand.value(k), factor)

    def span(self, *operands: Span) -> Span:
        """See :class:`Term`."""
        ((low, high),) = operands
        return rescale_number(low, self.factor), rescale_number(high, self.factor)

    def foresee(self) -> None:
        """See :class:`Term`."""
        super().foresee()
        self.prompt, self.flat = self.operand.prompt, self.operand.flat

    def _bound(self, first: int, last: int, side: int) -> FloatArray:
        return rescale(self.operand.bound(first, last, side), self.factor)


class Least(Stored):
    """The smaller of x and y."""

    def __init__(self, clock: OnlineClock, left: Term, right: Term) -> None:
        super().__init__(clock, left, right)
        self.left, self.right = left, right

    def _prepare(self) -> None:
        for operand in self.operands:
            operand.keep(self.next)

    def advance(self) -> None:
        """See :class:`Stored`."""
        tape, left, right = self.tape, self.left, self.right
        while (k := tape.end) < left.decided.end and k < right.decided.end:
            x, y = left.value(k), right.value(k)
            tape.append(x if x < y else y)

    def span(self, *operands: Span) -> Span:
        """See :class:`Term`."""
        (a, b), (c, d) = operands
        return min(a, c), min(b, d)

    def foresee(self) -> None:
        """See :class:`Term`."""
        super().foresee()
        low, (x, y) = self.ahead[LOWER], self.operands
        self.prompt = x.prompt and y.prompt
        # one of the operands of an undecided instant is undecided, too
        self.flat = all(one.prompt or (one.flat[LOWER] and one.ahead[LOWER] == low) for one in (x, y)), False

    def _pending(self, first: int, last: int, side: int) -> FloatArray:
        return np.minimum(self.left.bound(first, last, side), self.right.bound(first, last, side))


class AdjacentSample(Mapped):
    """The operand at the next (or previous) sample, −inf where there is none."""

    def __init__(self, clock: OnlineClock, operand: Term, later: bool) -> None:
        super().__init__(clock, operand)
        self.decided, self.value = self, self._value
        self.shift = 1 if later else -1

    @property
    def end(self) -> int:
        """See :class:`Term`."""
        clock = self.clock
        if self.shift < 0:
            return min(self.operand.end, clock.now) + 1
        if clock.ended and self.operand.end == clock.now + 1:
            return clock.now + 1
        return max(self.operand.end - 1, 0)

    def _value(self, k: int) -> float:
        return self.operand.value(k + self.shift) if 0 <= k + self.shift <= self.clock.now else -math.inf

    def span(self, *operands: Span) -> Span:
        """See :class:`Term`."""
        ((low, high),) = operands
        return (-math.inf if self.shift < 0 else low), high

    def _bound(self, first: int, last: int, side: int) -> FloatArray:
        begin, stop = max(first + self.shift, 0), min(last + self.shift, self.clock.now)
        inner = self.operand.bound(begin, stop, side) if begin <= stop else np.empty(0)
        before = [-math.inf] * (begin - first - self.shift)
        return np.concatenate((before, inner, [self.operand.ahead[side]] * (last + self.shift - stop)))


class Rise(Mapped):
    """min(x now, −x one sample before); −inf at the first sample."""

    shift = -1

    def __init__(self, clock: OnlineClock, operand: Term) -> None:
        super().__init__(clock, operand)
        self.operands = operand, operand
        self.decided, self.value = self, self._value

    @property
    def end(self) -> int:
        """See :class:`Term`."""
        return min(max(self.operand.end, 1), self.clock.now + 1)

    def _value(self, k: int) -> float:
        return lesser(self.operand.value(k), -self.operand.value(k - 1)) if k else -math.inf

    def span(self, *operands: Span) -> Span:
        """See :class:`Term`."""
        now, before = operands
        return min(now[0], -before[1]), min(now[1], -before[0])

    def foresee(self) -> None:
        """See :class:`Term`."""
        super().foresee()
        self.ahead = -math.inf, self.ahead[1]

    def _bound(self, first: int, last: int, side: int) -> FloatArray:
        begin = max(first, 1)
        never = [-math.inf] * (begin - first)
        if begin > last:
            return np.array(never)
        now, before = self.operand.bound(begin, last, side), self.operand.bound(begin - 1, last - 1, 1 - side)
        return np.concatenate((never, np.minimum(now, -before)))
