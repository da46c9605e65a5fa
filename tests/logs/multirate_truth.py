"""What a formula says of the messages that were sent, by the definitions of docs/explanation/messages.md.

Brute force, without `s2r_spec.robustness`. Times are in quarters of a millisecond, so that stamps, sums with the ends
of windows, and the middles between two of them are exact. A signal that is held changes at its messages only. So a
formula has one value at each of its instants of change, and one value between two of them. Every value is a pair: the
least and the greatest ρ that the messages allow.
"""

from __future__ import annotations

import itertools
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tests.logs.multirate_formulas import INF, Formula, Leaf, Node, edges, names, needed

MS = 4
"""Definition: ticks in a millisecond."""
SNAP = 1e-6
"""Tolerance [ticks]: two computed instants closer than this are one."""
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Signal:
    """The messages of a signal in order: times [ticks], not decreasing, and values; whether it is linear."""

    times: tuple[int, ...]
    values: tuple[float, ...]
    linear: bool = False

    @property
    def period(self) -> float:
        """Median interval [ticks]; NaN if it is sent on change."""
        steps = np.diff(np.unique(self.times)).astype(float)
        if steps.size < 10:
            return np.nan
        median = float(np.median(steps))
        low, high = np.quantile(steps, [0.1, 0.9])
        return median if low >= 0.5 * median and high <= 1.5 * median else np.nan

    @property
    def borderline(self) -> bool:
        """Whether rounding decides if it is periodic, or if it is silent."""
        steps = np.diff(np.unique(self.times)).astype(float)
        if steps.size < 10:
            return False
        median = float(np.median(steps))
        low, high = np.quantile(steps, [0.1, 0.9])
        near = [low / (0.5 * median), high / (1.5 * median), *(steps / (5 * median))]
        return bool((np.abs(np.array(near) - 1) < 1e-9).any())

    @property
    def end(self) -> float:
        """The time until which the last value is valid [ticks]."""
        if self.linear:
            return self.times[-1]
        return INF if np.isnan(self.period) else self.times[-1] + self.period

    def silences(self, until: float) -> list[tuple[float, float]]:
        """Return the open spans without a value: before the first message, in gaps, and after the end."""
        spans: list[tuple[float, float]] = [(-INF, self.times[0])]
        period, own = self.period, np.unique(self.times)
        if not np.isnan(period):
            gaps = np.flatnonzero(np.diff(own) > 5 * period)
            spans += [(own[k] + period, float(own[k + 1])) for k in gaps]
        return [*spans, (self.end, INF)]

    def at(self, time: float) -> set[float]:
        """Return all values that the signal may have at a time after its first message."""
        last = bisect_right(self.times, time + SNAP) - 1
        if self.linear and last + 1 < len(self.times) and time > self.times[last] + SNAP:
            part = (time - self.times[last]) / (self.times[last + 1] - self.times[last])
            return {self.values[last] + part * (self.values[last + 1] - self.values[last])}
        return set(self.values[bisect_left(self.times, self.times[last]) : last + 1])

    def crossings(self, level: float) -> list[float]:
        """Return where a linear signal crosses a level between two messages [ticks]."""
        found = []
        rows = zip(self.times, self.values, strict=True)
        for (t0, y0), (t1, y1) in itertools.pairwise(rows):
            if self.linear and (y0 - level) * (y1 - level) < 0:
                found.append(t0 + (level - y0) / (y1 - y0) * (t1 - t0))
        return found


# -- at every instant -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Steps:
    """Values at instants p_0 < … < p_m, and between: (2, 2m + 1) least and greatest, in the order of time."""

    points: FloatArray
    values: FloatArray

    def cell(self, time: float) -> int:
        """Return the number of the value at a time."""
        k = int(np.searchsorted(self.points, time - SNAP))
        if k < self.points.size and abs(self.points[k] - time) <= SNAP:
            return 2 * k
        return 2 * k - 1


def instants(points: FloatArray) -> FloatArray:
    """Return an instant of each value: the points, and the middles between."""
    found = np.empty(2 * points.size - 1)
    found[::2] = points
    found[1::2] = (points[:-1] + points[1:]) / 2
    return found


def _points(begin: float, end: float, more: Sequence[float]) -> FloatArray:
    """Return the begin, the end and what lies between, each once."""
    inner = sorted(at for at in more if begin + SNAP < at < end - SNAP)
    found = [begin]
    for at in inner:
        if at > found[-1] + SNAP:
            found.append(at)
    return np.array([*found, end] if end > begin else [begin], dtype=float)


@dataclass(frozen=True)
class Dense:
    """Formulas over signals at every instant from a begin to an end [ticks].

    Args:
        signals: name → signal.
        begin: the begin.
        end: the end.
        until: the end of the log.
        boolean: whether values are ±inf for true and false, instead of ρ.
        shift: ρ above which a predicate counts as true; 0 for its truth.
    """

    signals: Mapping[str, Signal]
    begin: float
    end: float
    until: float
    boolean: bool = False
    shift: float = 0.0

    def value(self, formula: Formula) -> tuple[float, float]:
        """Return the least and the greatest value at the begin."""
        low, high = self.steps(formula, 1).values[:, 0]
        return float(low), float(high)

    def steps(self, formula: Formula, sign: int) -> Steps:
        """Return a formula at every instant; the sign is −1 below an odd number of negations."""
        if isinstance(formula, Leaf):
            return self._leaf(formula, sign)
        match formula.op:
            case "not":
                return _minus(self.steps(formula.parts[0], -sign))
            case "and" | "or":
                left, right = (self.steps(part, sign) for part in formula.parts)
                return self._both(left, right, np.minimum if formula.op == "and" else np.maximum)
            case "->":
                left = _minus(self.steps(formula.parts[0], -sign))
                return self._both(left, self.steps(formula.parts[1], sign), np.maximum)
            case "rise":
                now, before = self.steps(formula.parts[0], sign), self.steps(formula.parts[0], -sign)
                return self._rise(now, before, bool(self.late & set(names(formula))))
            case "until":
                return self._until(formula, *(self.steps(part, sign) for part in formula.parts))
            case _:
                return self._window(formula, self.steps(formula.parts[0], sign))

    def _leaf(self, leaf: Leaf, sign: int) -> Steps:
        used = [self.signals[name] for name in leaf.names]
        spans = [span for one in used for span in one.silences(self.until)]
        more = [at for one in used for at in one.times] + [at for span in spans for at in span]
        crossed: list[float] = []
        shift = sign * self.shift if leaf.op != "flag" else 0.0
        level = leaf.level - shift if leaf.op[0] == "<" else leaf.level + shift
        for one in used:
            levels = [level] if not leaf.absolute else [level, -level] if level >= 0 else []
            crossed += [at for one_level in levels for at in one.crossings(one_level)]
        points = _points(self.begin, self.end, [*more, *crossed])
        values = np.empty((2, 2 * points.size - 1))
        for k, at in enumerate(instants(points)):
            if any(start + SNAP < at < stop - SNAP for start, stop in spans):
                values[:, k] = -INF, INF
                continue
            found = [leaf.value(chosen) for chosen in itertools.product(*(one.at(at) for one in used))]
            if any(abs(at - crossing) <= SNAP for crossing in crossed):
                found = [level]
            margins = [leaf.truth(one, shift) if self.boolean else leaf.margin(one) for one in found]
            values[:, k] = min(margins), max(margins)
        return Steps(points, values)

    def _on(self, x: Steps, points: FloatArray) -> FloatArray:
        at = instants(points)
        place = np.searchsorted(x.points, at - SNAP)
        on = np.abs(x.points[np.minimum(place, x.points.size - 1)] - at) <= SNAP
        return x.values[:, np.where(on, 2 * place, 2 * place - 1)]

    def _both(self, x: Steps, y: Steps, fold: np.ufunc) -> Steps:
        points = _points(self.begin, self.end, [*x.points, *y.points])
        return Steps(points, fold(self._on(x, points), self._on(y, points)))

    @property
    def late(self) -> set[str]:
        """The signals whose first message is at the begin, although another one came before."""
        if min(one.times[0] for one in self.signals.values()) >= self.begin:
            return set()
        return {name for name, one in self.signals.items() if one.times[0] >= self.begin}

    def _rise(self, now: Steps, before: Steps, late: bool) -> Steps:
        points = _points(self.begin, self.end, [*now.points, *before.points])
        here, there = self._on(now, points), self._on(before, points)
        values = np.empty_like(here)
        for k in range(values.shape[1]):
            if k == 0:
                values[:, k] = -INF, here[1, k] if late else -INF
            else:
                past = there[:, k - 1 + k % 2]  # within an interval the instant before is in it, too
                values[:, k] = min(here[0, k], -past[1]), min(here[1, k], -past[0])
        return Steps(points, values)

    def _window(self, node: Node, x: Steps) -> Steps:
        past, least = node.op in ("once", "historically"), node.op in ("always", "historically")
        way = -1 if past else 1
        ends = [end * MS for end in (node.low, node.high) if end < INF]
        points = _points(self.begin, self.end, [at - way * end for at in x.points for end in ends])
        values = np.empty((2, 2 * points.size - 1))
        for k, at in enumerate(instants(points)):
            near, far = at + way * node.low * MS, at + way * node.high * MS
            start, stop = max(min(near, far), self.begin), min(max(near, far), self.end)
            if start > stop + SNAP:
                values[:, k] = INF if least else -INF
                continue
            inside = x.values[:, x.cell(start) : x.cell(stop) + 1]
            values[:, k] = inside.min(axis=1) if least else inside.max(axis=1)
        return Steps(points, values)

    def _until(self, node: Node, left: Steps, right: Steps) -> Steps:
        both = _points(self.begin, self.end, [*left.points, *right.points])
        x, y = Steps(both, self._on(left, both)), Steps(both, self._on(right, both))
        ends = [0.0, *(end * MS for end in (node.low, node.high) if end < INF)]
        points = _points(self.begin, self.end, [at - end for at in both for end in ends])
        values = np.full((2, 2 * points.size - 1), -INF)
        for k, at in enumerate(instants(points)):
            start, stop = at + node.low * MS, min(at + node.high * MS, self.end)
            if start > stop + SNAP:
                continue
            here, first, last = x.cell(at), y.cell(start), y.cell(stop)
            witness = np.arange(here, last + 1)
            upto = np.minimum.accumulate(x.values[:, here : last + 1], axis=1)
            before = np.concatenate([[[INF], [INF]], upto[:, :-1]], axis=1)
            # before a witness between two instants of change, part of its own interval has passed
            rho = np.minimum(y.values[:, here : last + 1], np.where(witness % 2, upto, before))
            values[:, k] = rho[:, first - here :].max(axis=1)
            if node.low == 0:  # the witness is the instant itself
                values[:, k] = np.maximum(values[:, k], y.values[:, here])
        return Steps(points, values)


def _minus(x: Steps) -> Steps:
    return Steps(x.points, -x.values[::-1])


# -- at the messages of one topic -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sampled:
    """Formulas at the messages of one topic, as in a table; in a silence there may be a message at every period."""

    signals: Mapping[str, Signal]
    boolean: bool = False

    def value(self, formula: Formula) -> tuple[float, float]:
        """Return the least and the greatest value at the first message."""
        low, high = self.row(formula)[:, 0]
        return float(low), float(high)

    @property
    def times(self) -> FloatArray:
        """All instants [ticks]."""
        signal = next(iter(self.signals.values()))
        own = np.array(signal.times, dtype=float)
        period = signal.period
        more = [
            np.arange(own[k] + period, own[k + 1] - period / 2, period)
            for k in np.flatnonzero(np.diff(own) > 5 * period)
        ]
        return np.union1d(own, np.concatenate([[], *more]))

    def row(self, formula: Formula) -> FloatArray:
        """Return (2, n): the least and the greatest value at each instant."""
        times = self.times
        if isinstance(formula, Leaf):
            return self._leaf(formula, times)
        rows = [self.row(part) for part in formula.parts]
        match formula.op:
            case "not":
                return -rows[0][::-1]
            case "and":
                return np.minimum(*rows)
            case "or":
                return np.maximum(*rows)
            case "->":
                return np.maximum(-rows[0][::-1], rows[1])
            case "rise":
                before = -np.roll(rows[0][::-1], 1, axis=1)
                before[:, 0] = -INF
                return np.minimum(rows[0], before)
            case _:
                return np.stack([self._at(formula, rows, k, times) for k in range(times.size)], axis=1)

    def _leaf(self, leaf: Leaf, times: FloatArray) -> FloatArray:
        found = np.empty((2, times.size))
        own = next(iter(self.signals.values())).times
        for k, at in enumerate(times):
            if at not in own:
                found[:, k] = -INF, INF
                continue
            value = leaf.value([self.signals[name].values[own.index(at)] for name in leaf.names])
            found[:, k] = leaf.truth(value) if self.boolean else leaf.margin(value)
        return found

    def _at(self, node: Node, rows: Sequence[FloatArray], k: int, times: FloatArray) -> FloatArray:
        past, least = node.op in ("once", "historically"), node.op in ("always", "historically")
        away = (times[k] - times if past else times - times[k]) / MS
        inside = np.flatnonzero((away >= node.low) & (away <= node.high))
        if node.op == "until":
            best = np.array([-INF, -INF])
            for j in inside:
                sofar = rows[0][:, k:j].min(axis=1, initial=INF)
                best = np.maximum(best, np.minimum(rows[1][:, j], sofar))
            return best
        if not inside.size:
            return np.full(2, INF if least else -INF)
        return rows[0][:, inside].min(axis=1) if least else rows[0][:, inside].max(axis=1)


# -- the verdict ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Truth:
    """What the messages say.

    Args:
        rho: the least and the greatest ρ in the window.
        truth: whether it holds in the window; None if a silence decides.
        whole: whether it holds from the first message to the last, whatever is not known there; None if open.
        complete: whether the window reaches the horizon.
        begin: the begin [ticks].
        end: the end [ticks].
        sampled: whether it is evaluated at the messages of one topic.
    """

    rho: tuple[float, float]
    truth: bool | None
    whole: bool | None
    complete: bool
    begin: float
    end: float
    sampled: bool


def window(signals: Mapping[str, Signal], log_end: float = -INF) -> tuple[float, float, float]:
    """Return the begin, the end, and the end of what is evaluated [ticks].

    Values that are sent on change are valid until the end of the log, where no periodic signal ends earlier.
    """
    until = max(one.end if one.end < INF else one.times[-1] for one in signals.values())
    if all(np.isnan(one.period) for one in signals.values()):
        until = max(until, log_end)
    begin = max(one.times[0] for one in signals.values())
    last = max(log_end, *(one.times[-1] for one in signals.values()))
    ends = [
        min(one.end, until)
        for one in signals.values()
        if np.isnan(one.period) or last - one.times[-1] <= 5 * one.period
    ]
    return begin, max(min(ends, default=until), begin), until


def evaluated(formula: Formula, signals: Mapping[str, Signal], log_end: float = -INF) -> Truth:
    """Return what the messages of the formula's signals say of it, in a log with an end [ticks].

    Signals with the same stamps, each once, are evaluated at these, as in a table.
    """
    signals = {name: signals[name] for name in names(formula)}
    begin, end, until = window(signals, log_end)
    repeated = any(len(set(one.times)) < len(one.times) for one in signals.values())
    if len({one.times for one in signals.values()}) == 1 and not repeated:
        times = next(iter(signals.values())).times
        end = times[-1]
        sampled = Sampled(signals)
        decided = _decided(*replace(sampled, boolean=True).value(formula))
        # it is too short if it ends a period or more before the horizon
        slack = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        complete = begin + needed(formula) * MS < end + slack or begin + needed(formula) * MS == end
        return Truth(sampled.value(formula), decided, decided, complete, begin, end, True)
    dense = Dense(signals, begin, end, until)
    truth = replace(dense, boolean=True).value(formula)
    silent = any(_cuts(one, begin, end, until) for one in signals.values())
    decided = _decided(*truth)
    first = min(one.times[0] for one in signals.values())
    last = max(until, first + needed(formula) * MS)
    whole = replace(dense, boolean=True, begin=first, end=last).value(formula)
    unseen = any(dense.late & set(names(edge)) for edge in edges(formula))
    if decided is None and not silent and not unseen:
        decided = False  # several values with one stamp: the worse decides
    complete = begin + needed(formula) * MS <= end + SNAP
    linear = any(one.linear for one in signals.values())
    rho = (np.nan, np.nan) if linear else dense.value(formula)
    return Truth(rho, decided, _decided(*whole), complete, begin, end, False)


def _decided(low: float, high: float) -> bool | None:
    return True if low > 0 else False if high < 0 else None


def _cuts(one: Signal, begin: float, end: float, until: float) -> bool:
    return any(stop > begin and start < end and stop > start for start, stop in one.silences(until))
