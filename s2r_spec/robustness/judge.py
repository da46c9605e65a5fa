"""The verdict on one requirement from channels that have messages of their own.

Data: a trace of messages. Window: a requirement begins when each of its signals has had a message, and lasts as long as
the last value of each is valid. Model: ρ of :mod:`s2r_spec.robustness.held` over this window, with bounds where a
signal is silent or has several values with one stamp (:mod:`s2r_spec.robustness.silence`).

No message outside of the window is ignored unseen: the requirement is evaluated once more from the first message to the
last, with bounds where a signal has no value. If this decides otherwise, the verdict is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError
from s2r_spec.base.printable import count_messages
from s2r_spec.lang import formula as f
from s2r_spec.robustness.account import Instants, instants_of
from s2r_spec.robustness.at_start import bounds_at_start
from s2r_spec.robustness.evaluate import Witness
from s2r_spec.robustness.evaluation import End, Evaluation
from s2r_spec.robustness.explain import Explanation
from s2r_spec.robustness.explain_held import HeldExplainer
from s2r_spec.robustness.held import Courses
from s2r_spec.robustness.horizon import horizon, seconds_needed
from s2r_spec.robustness.narrow import narrowest, refuse_short
from s2r_spec.robustness.silence import HeldBounds, edge_signals
from s2r_spec.robustness.stream import Course, SignalMessages, in_one_turn
from s2r_spec.robustness.ties import restore_zero, restore_zeros
from s2r_spec.trace.instants import instant
from s2r_spec.trace.messages import Span, union

MOST_VARIANTS = 64
"""Budget: combinations of several values with one stamp that are evaluated."""


@dataclass(frozen=True)
class Judgement:
    """The verdict on a requirement, from channels that have messages of their own.

    Args:
        lower: the least ρ that the messages allow, at the begin; equal to ``upper`` if ρ is known.
        upper: the greatest ρ that the messages allow.
        signed: ``lower``, never 0: its sign is the verdict if ρ is known.
        satisfied: whether the requirement is true; None if the messages do not decide it.
        start: the begin, on the clock of the trace [s].
        end: the end of the window [s].
        complete: whether the window reaches the requirement's horizon.
        instants: signal → its instants in the window.
        unevaluated: signal → (messages before the window, messages after it).
        period: shortest period of a periodic signal [s]; None if there is none.
        several: whether ρ is uncertain only because a signal has several values with one stamp.
        open: why the verdict is unknown, as a sentence without its subject; "" if it is not, or the trace is too short.
        notes: a sentence each on silences, on several values with one stamp, and on signals that are sent on change.
    """

    lower: float
    upper: float
    signed: float
    satisfied: bool | None
    start: float
    end: float
    complete: bool
    instants: Mapping[str, Instants]
    unevaluated: Mapping[str, tuple[int, int]]
    period: float | None
    several: bool
    open: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Judge:
    """Signals and parameters of one trace, on which requirements are judged.

    Args:
        streams: name → signal, all that the requirement reads.
        params: name → (1, 1), in the declared unit.
        since: the begin of the trace [s]; None for the first message.
        until: the end of the trace [s].
        witness: ``until`` of :class:`s2r_spec.robustness.evaluate.Walk`.
    """

    streams: Mapping[str, SignalMessages]
    params: Mapping[str, FloatArray]
    since: float | None
    until: float
    witness: Witness = "open"

    @cached_property
    def start(self) -> float:
        """The first time at which each signal has a value [s]."""
        first = [stream.messages.first for stream in self.streams.values()]
        return max(first if self.since is None else [self.since, *first])

    @cached_property
    def end(self) -> float:
        """The time until which each signal is valid; one that ends more than a silence early is silent instead [s]."""
        every = [stream.messages for stream in self.streams.values()]
        whole = [min(one.end, self.until) for one in every if self._last - one.last <= one.bridged]
        end = max(min(whole, default=self.until), self.start)
        reach = end + snap_of(self.start, end)
        stamps = (one.times[: np.searchsorted(one.times, reach, side="right")] for one in every)
        return max([end, *(float(part[-1]) for part in stamps if part.size)])

    @property
    def _last(self) -> float:
        """The last stamp of the log, as far as it is known [s]."""
        ends = [one.messages.log_end for one in self.streams.values()]
        known = [end for end in ends if not math.isnan(end)]
        return min(max([*known, *(one.messages.last for one in self.streams.values())]), self.until)

    @property
    def snap(self) -> float:
        """Times closer than this are the same [s]."""
        return snap_of(self.start, self.end)

    @cached_property
    def silences(self) -> Mapping[str, Sequence[Span]]:
        """Signal → the spans in the window without a valid value, after the start [s]."""
        return {name: stream.silences(self.start, self.end) for name, stream in self.streams.items()}

    @cached_property
    def unevaluated(self) -> Mapping[str, tuple[int, int]]:
        """Signal → (messages before the one that is held at the start, messages after the end)."""
        return {name: self._outside(stream) for name, stream in self.streams.items()}

    @property
    def period(self) -> float | None:
        """The shortest period of a periodic signal [s]; None if there is none."""
        known = (one.messages.period for one in self.streams.values() if not math.isnan(one.messages.period))
        return min(known, default=None)

    def bounds(self, start: float, end: float, open_steps: bool = False) -> HeldBounds:
        """Return the bounds of predicates from ``start`` to ``end`` [s]; see :class:`HeldBounds`."""
        most = {stream.topic: stream.most for stream in self.streams.values()}
        if math.prod(most.values()) > MOST_VARIANTS:
            raise TraceError(
                f"too many signals have several values with one stamp: {math.prod(most.values())} combinations; s2r "
                f"tries at most {MOST_VARIANTS}; split the requirement"
            )
        # The messages of one topic come together; those of two topics in any combination.
        variants = [
            self._courses(start, end, dict(zip(most, numbers, strict=True)))
            for numbers in product(*map(range, most.values()))
        ]
        silences = {name: stream.silences(start, end) for name, stream in self.streams.items()}
        return HeldBounds(variants, silences, self._unseen(start), open_steps)

    def _courses(self, start: float, end: float, numbers: Mapping[int, int]) -> Courses:
        """Return the signals; ``numbers``: topic → which of several messages with one stamp is read."""
        signals = _Lazy(
            {name: partial(one.course, start, end, numbers[one.topic]) for name, one in self.streams.items()}
        )
        return Courses(signals, self.params, end - start, snap_of(start, end), self.witness)

    def contradicts(self, formula: f.Formula, satisfied: bool) -> bool:
        """Return whether all messages contradict a verdict at samples, whatever is known at samples alone."""
        walk = self.bounds(self.start, self.end, open_steps=True).walk()
        lower, upper = bounds_at_start(formula, walk, self.snap)
        return upper < 0 if satisfied else lower > 0

    def _unseen(self, start: float) -> frozenset[str]:
        """Return the signals whose first message is at a start, in a log that began before."""
        firsts = {name: stream.messages.first for name, stream in self.streams.items()}
        began = min(firsts.values()) if self.since is None else self.since
        return frozenset(name for name, first in firsts.items() if began < start <= first)

    def judge(self, formula: f.Formula, partial: bool = False) -> Judgement:
        """Return the verdict on a formula whose time bounds are numbers; ``partial`` cuts windows at the end."""
        start, end, silent = self.start, self.end, any(self.silences.values())
        lower, upper = bounds_at_start(formula, self.bounds(start, end).walk(), self.snap)
        complete = seconds_needed(formula, 0.0, 0.0) <= end - start + self.snap
        unseen = sorted(self._unseen(start) & edge_signals(formula))
        satisfied = lower > 0 if lower > 0 or upper < 0 or not (silent or unseen) else None
        reason = "" if satisfied is not None else self._silent() or self._first(unseen)
        early = self.since is None and any(one.messages.first < start for one in self.streams.values())
        if satisfied is not None and (early or any(map(any, self.unevaluated.values()))):
            reason = self._contradiction(formula, satisfied)
            satisfied = None if reason else satisfied
        if not (complete or partial):
            satisfied, reason = None, ""
        return Judgement(
            lower=restore_zero(lower),
            upper=restore_zero(upper),
            signed=lower,
            satisfied=satisfied,
            start=start,
            end=end,
            complete=complete,
            instants=instants_of(self.streams, self.silences, start, end),
            unevaluated=self.unevaluated,
            period=self.period,
            several=not silent and any(stream.most > 1 for stream in self.streams.values()),
            open=reason,
            notes=tuple(note for name in self.streams for note in self._notes(name)),
        )

    def explain(self, formula: f.Formula, judgement: Judgement, requirement: str, unit: str) -> Explanation:
        """Return the explanation of a verdict on a formula whose time bounds are numbers."""
        # beside a silence, only the upper bound is sure to be < 0
        worse = not (any(self.silences.values()) and judgement.satisfied is False)
        return HeldExplainer(self.bounds(self.start, self.end), self.start, worse).explain(
            formula, requirement, unit
        )

    def evaluate(self, formula: f.Formula, requirement: str, unit: str, end: End) -> Evaluation:
        """Return ρ along the window, its lower bound where there are two; for ``end`` see :meth:`Spec.evaluate`."""
        start, until = self.start, self.end
        needs = seconds_needed(formula, 0.0, 0.0)
        stamps = union(stream.messages for stream in self.streams.values())
        times = np.union1d(stamps[(stamps > start) & (stamps <= until)], start)
        complete = times + needs <= until + self.snap
        if end == "error" and not complete.all():
            raise TraceError(
                f"{requirement!r} looks {needs:g} s ahead, past the end of the trace at {self._time(until)}"
            )
        judge, last = self, until
        if end == "hold":
            streams = {
                name: replace(one, messages=replace(one.messages, end=math.inf))
                for name, one in self.streams.items()
            }
            judge, last = replace(self, streams=streams), until + needs
        rho = judge.bounds(start, last).walk()(formula).lower.values(times - start, self.snap)
        if end == "nan":
            rho = np.where(complete, rho, np.nan)
        return Evaluation(
            requirement=requirement,
            unit=unit,
            times=times,
            values=restore_zeros(rho),
            truth=rho > 0,
            horizon=horizon(formula),
            complete=complete,
            jitter=None,
            period=self.period,
            narrowest=None,
            notes=(),
        )

    def shortfall(self, formula: f.Formula) -> str:
        """Return the end of a sentence on a requirement that the trace does not reach: "looks 2 s ahead, but …"."""
        length = self.end - self.start
        return f"looks {horizon(formula):g} s ahead, but its signals last {length:.6g} s together"

    def refuse_short(self, formula: f.Formula) -> None:
        """Raise SamplingError if a window is shorter than all periods: then the unit of the times is likely wrong."""
        refuse_short(narrowest(formula), self.period, "the shortest period of a signal")

    # -- what lies outside of the window -----------------------------------------------------------------------------

    def _outside(self, stream: SignalMessages) -> tuple[int, int]:
        times = stream.messages.times
        held = times[max(int(np.searchsorted(times, self.start, side="right")) - 1, 0)]
        first = 0 if self.since is None else int(np.searchsorted(times, self.since))
        stop = int(np.searchsorted(times, self.until, side="right"))
        before = int(np.searchsorted(times, held)) - first
        return max(before, 0), max(stop - int(np.searchsorted(times, self.end, side="right")), 0)

    def _contradiction(self, formula: f.Formula, satisfied: bool) -> str:
        """Return why messages outside of the window contradict a verdict; "" if they do not."""
        verb, other = ("holds", "violate") if satisfied else ("is violated", "satisfy")
        first = min(stream.messages.first for stream in self.streams.values())
        begin = first if self.since is None else max(first, self.since)
        starts = {}
        if any(count for _, count in self.unevaluated.values()):
            until = f"{verb} until {self._time(self.end)}, where {self._first_to_end()} ends"
            starts[self.start] = f"{until}, but messages after"
        if begin < self.start:
            since = f"{verb} from {self._time(self.start)} on, where {self._last_to_begin()} begins"
            starts[begin] = f"{since}, but messages before"
        for start, why in starts.items():
            end = max(self.until, start + seconds_needed(formula, 0.0, 0.0))
            lower, upper = bounds_at_start(formula, self.bounds(start, end).walk(), snap_of(start, end))
            if (satisfied and upper < 0) or (not satisfied and lower > 0):
                return f"{why} {other} it"
        return ""

    def _last_to_begin(self) -> str:
        return max(self.streams, key=lambda name: self.streams[name].messages.first)

    def _first_to_end(self) -> str:
        """Return the signal that ends first, of those that last as long as the log."""
        ends = {name: min(one.messages.end, self.until) for name, one in self.streams.items()}
        return min(ends, key=lambda name: abs(ends[name] - self.end))

    # -- words -------------------------------------------------------------------------------------------------------

    def _time(self, time: float) -> str:
        """Return a time on the clock of the trace as text."""
        longest = max(self.streams.values(), key=lambda stream: len(stream.messages)).messages.times
        place = int(np.searchsorted(longest, time))
        near = longest[max(place - 2, 0) : place + 3]
        return instant(np.concatenate((longest[:1], near)), time)

    def _first(self, names: Sequence[str]) -> str:
        """Return the reason of a verdict that depends on a change at the first messages of signals."""
        first = self._time(self.start)
        return f"depends on the value of {' and '.join(names)} before its first message at t = {first}"

    def _silent(self) -> str:
        """Return the reason of a verdict that depends on a silence; "" if there is none."""
        spans = [(name, span) for name, spans in self.silences.items() for span in spans]
        if not spans:
            return ""
        name, span = max(spans, key=lambda one: one[1][1] - one[1][0])
        way = "; --duration can end the trace before" if math.isinf(span[1]) else ""
        return f"depends on {name} {self._span(*span)}, where it has no message{way}"

    def _span(self, begin: float, end: float) -> str:
        last = self.until if math.isinf(end) else self.start + end
        first = self.start if math.isinf(begin) else self.start + begin
        return f"from t = {self._time(first)} to {self._time(last)}"

    def _notes(self, name: str) -> Iterator[str]:
        """Yield a sentence on each peculiarity of a signal."""
        stream, spans = self.streams[name], self.silences[name]
        own = stream.messages
        if spans:
            longest = max(spans, key=lambda span: span[1] - span[0])
            more = f", the longest of {len(spans)} gaps" if len(spans) > 1 else ""
            yield (
                f"{name} has no message {self._span(*longest)}{more}, though {own.rhythm}: its value "
                f"is not known there"
            )
        if math.isinf(own.bridged) and len(own) > 1 and not own.linear:
            yield f"{name} is sent on change, and each value is held until the next message"
        if repeated := len(own) - len(np.unique(own.times)):
            counted = count_messages(repeated, name, "have")
            yield f"{counted} another value with the same stamp: the worse decides"
        around = int((np.abs(np.diff(stream.values)) > stream.turn / 2).any(axis=0).sum())
        if around and own.linear and in_one_turn(stream.values, stream.turn):
            yield f"{name} jumps by over half a turn {around} times, and is interpolated on the circle"
        if stream.without:
            yield f"{count_messages(stream.without, name, 'have')} no value, and the value before is held"
        before, after = self.unevaluated[name]
        if before:
            where = f"before {self._time(self.start)}, where {self._last_to_begin()} begins"
            yield f"{count_messages(before, name, 'lie')} {where}"
        if after:
            where = f"after {self._time(self.end)}, where {self._first_to_end()} ends"
            yield f"{count_messages(after, name, 'lie')} {where}"


class _Lazy(Mapping[str, Course]):
    """Name → the course of a signal, made when it is read: those of many topics fill the memory."""

    def __init__(self, made: Mapping[str, Callable[[], Course]]) -> None:
        self._made = made

    def __getitem__(self, name: str) -> Course:
        return self._made[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


def snap_of(start: float, end: float) -> float:
    """Return the difference [s] below which two times are equal up to rounding."""
    return 16 * math.ulp(max(abs(start), abs(end), end - start))
