"""Robustness of channels that have messages of their own, at every instant from a start to an end.

Data: for each signal its messages (t_i, y_i) of shape (m,), (width, m); see :mod:`s2r_spec.trace.messages`. Model:
between two messages a signal holds the last value, or is linear. So a predicate is a curve with breakpoints at the
messages of its own signals (:mod:`s2r_spec.robustness.curve`). No matrix of signals × stamps is made.

Functions of the past look at a signal's own messages: ``deriv``, ``delay`` and ``count`` are computed at these and held
between, so their operand must be of one topic. ``integral``, ``mean`` and ``duration`` of held signals are exact: an
integral is a sum of rectangles, and a duration grows with time. Sums, multiples, minima, ``if`` and products with held
values are exact, too; a value that is no straight line between messages is refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError
from s2r_spec.lang import formula as f
from s2r_spec.robustness import history
from s2r_spec.robustness.curve import Curve, align, split_at_zero
from s2r_spec.robustness.dense import ContinuousSignals, PredicateCurves, curve_algebra, margin_curve
from s2r_spec.robustness.evaluate import Algebra, Walk, Witness
from s2r_spec.robustness.numbers import Numbers, SampledSignals, margin
from s2r_spec.robustness.stream import Course
from s2r_spec.robustness.ticks import Ticks

MEAN_ERROR = 1e-7
"""Tolerance: error of a mean between two messages while its window grows, in parts of its change."""
_PRODUCT = {"*": np.multiply, "/": np.divide}


@dataclass(frozen=True, eq=False)
class Courses:
    """Signals and parameters from an instant 0 to an end.

    Args:
        signals: name → messages.
        params: name → (1, 1), in the declared unit.
        end: the last instant [s].
        snap: times closer than this are the same [s].
        until: see :class:`s2r_spec.robustness.evaluate.Walk`.
    """

    signals: Mapping[str, Course]
    params: Mapping[str, FloatArray]
    end: float
    snap: float
    until: Witness = "open"

    def stamps(self, read: frozenset[str]) -> FloatArray:
        """Return (n,): the start, the stamps of some signals, and the end."""
        own = {id(times): times for name in read for times in [self.signals[name].times]}.values()
        inner = [times[(times > 0.0) & (times < self.end)] for times in own]
        ends = np.array([0.0, self.end] if self.end > 0.0 else [0.0])
        result: FloatArray = np.unique(np.concatenate([ends, *inner]))
        return result

    def sampled(self, times: FloatArray, read: frozenset[str]) -> SampledSignals:
        """Return some signals at times."""
        signals = {name: self.signals[name].at(times) for name in read}
        return SampledSignals(Ticks(times, self.snap), signals, self.params, self.until)

    def needs_samples(self, node: f.Node) -> bool:
        """Return whether a value is known at samples alone: a function of the past of several topics."""
        return needs_samples(node, {name: self.signals[name].times for name in signals_of(node)})

    def walk(self) -> Walk[Curve]:
        """Return the walk that gives the robustness of a formula as a curve."""
        return Walk(held_algebra(self), self.until)


def held_algebra(courses: Courses) -> Algebra[Curve]:
    """Return the operations on curves whose predicates have breakpoints at the messages of their signals."""
    # Only the values of the last predicate, since those of many topics fill the memory.
    last: dict[frozenset[str], HeldValues] = {}

    def flag(node: f.Flag) -> Curve:
        times = courses.stamps(frozenset((node.name,)))
        states = np.where(courses.signals[node.name].at(times)[0] > 0, np.inf, -np.inf)
        return Curve.of(times, states, "hold")

    def margin_of(node: f.Comparison) -> Curve:
        read = signals_of(node)
        if read not in last:
            last.clear()
            last[read] = HeldValues.at_messages(courses, read)
        values = last[read]
        if values.recording.between == "linear" or _grows(node):
            return margin_curve(node, values)
        return Curve.of(values.recording.times, margin(node, values.sampled), "hold")

    ends = courses.sampled(courses.stamps(frozenset()), frozenset())
    algebra = curve_algebra(ContinuousSignals(ends, "hold", courses.snap))
    return replace(algebra, flag=flag, margin=margin_of)


def needs_samples(node: f.Node, times: Mapping[str, FloatArray]) -> bool:
    """Return whether a value is known at samples alone: the next sample, or a function of the past of several topics.

    Args:
        node: a formula or a value.
        times: signal → the stamps of its messages.
    """
    for part in f.walk(node):
        if isinstance(part, f.AdjacentSample):
            return True
        if isinstance(part, f.Count | f.Delayed | f.Derivative):
            stamps = [times[name] for name in signals_of(part)]
            if any(one is not stamps[0] and not np.array_equal(one, stamps[0]) for one in stamps[1:]):
                return True
    return False


def signals_of(node: f.Node) -> frozenset[str]:
    """Return the signals that a formula or a value reads."""
    return frozenset(part.name for part in f.walk(node) if isinstance(part, f.SignalValue | f.Flag))


@dataclass
class HeldValues(PredicateCurves):
    """The numbers that a predicate compares, as curves with breakpoints at the messages of its signals."""

    courses: Courses = field(kw_only=True)

    @classmethod
    def at_messages(cls, courses: Courses, read: frozenset[str]) -> HeldValues:
        """Return the values of some signals at their stamps."""
        samples = courses.sampled(courses.stamps(read), read)
        linear = any(courses.signals[name].linear for name in read)
        return cls(ContinuousSignals(samples, "linear" if linear else "hold", courses.snap), courses=courses)

    def __post_init__(self) -> None:
        self.sampled = _OwnNumbers(self.recording.samples, self.courses)

    def _value(self, node: f.Value) -> Curve:
        match node:
            case f.SignalValue():
                return self._join(node)
            case f.Duration():
                return _duration(self.courses.walk()(node.operand))
            case f.Accumulated():
                return self._accumulate(node)
            case f.Derivative() | f.Delayed() | f.Count() | f.Initial():
                return self._join(node)
            case f.Choice() if _grows(node):
                return self._chosen(node)
            case f.Arithmetic(operator="*" | "/") if _grows(node) and not self._has_steady_part(node):
                return self._product(node)
            case f.Elementary(function="sqrt") | f.Arithmetic(operator="^") | f.Norm() if _grows(node):
                raise _curved_error(node)
            case _ if _grows(node):
                return self._lines(node)
            case _:
                return super()._value(node)

    def _has_steady_part(self, node: f.Arithmetic) -> bool:
        return self._steady(node.right) or (node.operator == "*" and self._steady(node.left))

    def _product(self, node: f.Arithmetic) -> Curve:
        """Return a product of curves, or a quotient.

        Raises:
            TraceError: it is not linear between two messages.
        """
        x, y = align(self(node.left), self(node.right), self.recording.snap)
        flat = y.right == y.left
        if node.operator == "*":
            flat |= x.right == x.left
        if not flat.all():
            raise _curved_error(node)
        with np.errstate(all="ignore"):
            parts = [
                _PRODUCT[node.operator](*pair)
                for pair in ((x.at, y.at), (x.right, y.right), (x.left, y.left))
            ]
        return Curve(x.times, *parts)

    def _chosen(self, node: f.Choice) -> Curve:
        """Return the curve of ``if``, whose condition may change between two messages."""
        snap = self.recording.snap
        rho, x = align(split_at_zero(self.courses.walk()(node.condition), snap), self(node.left), snap)
        x, y = align(x, self(node.right), snap)
        rho = rho.refine(x.times)
        at, between = rho.at > 0, rho.right + rho.left > 0
        return Curve(
            x.times,
            np.where(at, x.at, y.at),
            np.where(between, x.right, y.right),
            np.where(between, x.left, y.left),
        )

    def _lines(self, node: f.Value) -> Curve:
        """Return a value that is linear between messages although its signals are held."""
        held, self.recording = self.recording, replace(self.recording, between="linear")
        try:
            return super()._value(node)
        finally:
            self.recording = held

    def _join(self, node: f.Value) -> Curve:
        """Return the curve through the values at the messages, with jumps where a held signal has one."""
        times, read = self.recording.times, signals_of(node)
        samples = np.broadcast_to(self.sampled(node)[0], times.shape)
        signals = self.courses.signals
        if not any(signals[name].linear for name in read):
            return Curve.of(times, samples, "hold")
        if all(signals[name].linear and signals[name].ends is None for name in read):
            return Curve.of(times, samples, "linear")
        before = {
            name: signals[name].before(times[1:]) if signals[name].linear else one[:, :-1]
            for name, one in self.recording.samples.signals.items()
        }
        ends = replace(self.recording.samples, clock=Ticks(times[1:], self.courses.snap), signals=before)
        left = np.broadcast_to(_OwnNumbers(ends, self.courses)(node)[0], times[1:].shape)
        return Curve(times, samples, samples[:-1], left)

    def _accumulate(self, node: f.Accumulated) -> Curve:
        if _grows(node.operand):
            raise _curved_error(node)
        operand = self(node.operand)
        total = _integral(operand, node.seconds)
        if node.function == "integral":
            return total
        total = total.refine(np.union1d(total.times, _along_hyperbolas(total.times, node.seconds)))
        elapsed = np.minimum(total.times, node.seconds)
        with np.errstate(invalid="ignore", divide="ignore"):
            at = np.where(elapsed > 0, total.at / elapsed, operand.at[0])
        return Curve.of(total.times, at, "linear")


def _along_hyperbolas(times: FloatArray, seconds: float) -> FloatArray:
    """Return instants between (n,) breakpoints at which a mean is computed, too.

    While its window grows, the mean of a held signal is c + K / t between two messages. Between two instants whose
    ratio is 1 + h, a line differs from it by h² K / 4 t.
    """
    inner = times[(times > 0.0) & (times <= seconds)]
    if inner.size < 2:
        return inner
    ratio = 1.0 + math.sqrt(4.0 * MEAN_ERROR)
    count = int(math.log(inner[-1] / inner[0]) / math.log(ratio)) + 1
    grid = inner[0] * ratio ** np.arange(1, count)
    piece = np.searchsorted(inner, grid, side="right") - 1
    wide = inner[np.minimum(piece + 1, inner.size - 1)] > ratio * inner[piece]
    result: FloatArray = grid[wide & (grid < inner[-1])]
    return result


def _curved_error(node: f.Value) -> TraceError:
    """Return the error of a value that is no straight line between messages."""
    return TraceError(
        f"`{' '.join(node.span.text.split())}` ({node.span.place}) is no straight line between messages, so s2r has no "
        f"exact value there; resample the trace"
    )


def _grows(node: f.Node) -> bool:
    """Return whether a value is linear in time between messages of held signals."""
    return any(isinstance(part, f.Duration | f.Accumulated) for part in f.walk(node))


def _integral(x: Curve, seconds: float) -> Curve:
    """Return the integral over [t − seconds, t] of a curve, from its begin on; exact if the curve is held."""
    areas = (x.right + x.left) / 2 * np.diff(x.times)
    total = np.concatenate(([0.0], np.cumsum(areas)))
    since = x.times + seconds
    times = np.union1d(x.times, since[since <= x.times[-1]]) if math.isfinite(seconds) else x.times
    if times.size == 1:
        return Curve.of(times, np.zeros(1), "linear")
    whole = _area(x, total, times)
    return Curve.of(times, whole - _area(x, total, np.maximum(times - seconds, x.times[0])), "linear")


def _area(x: Curve, total: FloatArray, times: FloatArray) -> FloatArray:
    """Return (n,) the integral of a curve from its begin to each time."""
    piece = np.clip(x.piece(times), 0, x.right.size - 1)
    part = times - x.times[piece]
    result: FloatArray = total[piece] + part * (x.right[piece] + x.along(piece, times)) / 2
    return result


def _duration(rho: Curve) -> Curve:
    """Return the time for which a condition has held without a break, from the curve of its robustness."""
    middle = rho.right + rho.left > 0
    at = rho.at > 0
    begins = at & np.concatenate(([True], ~at[:-1] | ~middle))
    # A run also begins just after a breakpoint at which the condition does not hold.
    starts = np.full(middle.size, -np.inf)
    starts[middle] = np.where(at[:-1][middle], -np.inf, rho.times[:-1][middle])
    starts[at[:-1] & begins[:-1] & middle] = rho.times[:-1][at[:-1] & begins[:-1] & middle]
    since = np.maximum.accumulate(starts) if starts.size else starts
    right = np.where(middle, rho.times[:-1] - since, 0.0)
    left = np.where(middle, rho.times[1:] - since, 0.0)
    here = np.concatenate(([0.0], np.where(middle, left, 0.0)))
    return Curve(rho.times, np.where(at, here, 0.0), right, left)


def _conditions(courses: Courses, times: FloatArray, node: f.Formula) -> FloatArray:
    """Return (n,): the robustness of a condition at times."""
    return courses.walk()(node).values(times, courses.snap)


class _OwnNumbers(Numbers):
    """Numbers at the messages of a predicate's signals; functions of the past look at their operand's own messages."""

    def __init__(self, samples: SampledSignals, courses: Courses) -> None:
        # Not a method of these numbers: a reference cycle would keep the samples in memory.
        conditions = partial(_conditions, courses, samples.clock.times)
        super().__init__(samples, lambda: conditions)
        self._courses = courses

    def _history(self, node: f.Value) -> FloatArray:
        times = self.clock.times
        if isinstance(node, f.Duration | f.Accumulated):
            values = HeldValues.at_messages(self._courses, signals_of(node))
            return values(node).values(times, self.clock.snap)[np.newaxis, :]
        own = self._own_stamps(node)
        if isinstance(node, f.Count):
            own = own[own >= 0.0]
            if not own.size:
                return np.zeros((1, times.size))
        samples = self._courses.sampled(own, signals_of(node))
        numbers = _OwnNumbers(samples, self._courses)
        match node:
            case f.Count():
                past = history.count(numbers.holds(node.operand), own, node.seconds, self.clock.snap)
            case f.Delayed():
                past = history.delay(numbers._along(node.operand), own, node.seconds, self.clock.snap)
            case f.Derivative():
                past = history.derivative(numbers._along(node.operand), own)
            case _:
                raise AssertionError(node)
        index = np.searchsorted(own, times, side="right") - 1
        return np.where(index < 0, 0.0 if isinstance(node, f.Count) else past[..., :1], past[..., index])

    def _own_stamps(self, node: f.Value) -> FloatArray:
        """Return (n,) the stamps of the one topic that an operand reads, from the last one before the start on.

        Raises:
            TraceError: it reads several topics.
        """
        read = sorted(signals_of(node))
        first, *others = (self._courses.signals[name].times for name in read)
        for name, times in zip(read[1:], others, strict=True):
            if times is not first and not np.array_equal(times, first):
                raise TraceError(
                    f"`{' '.join(node.span.text.split())}` ({node.span.place}) needs the messages of one topic, but "
                    f"{read[0]!r} and {name!r} have each their own; give --clock {read[0]}, or resample the trace"
                )
        return first[first <= self._courses.end]
