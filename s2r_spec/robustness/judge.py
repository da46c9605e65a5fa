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
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError
from s2r_spec.base.printable import count_messages
from s2r_spec.lang import formula as f
from s2r_spec.robustness.account import Instants, instants_of
from s2r_spec.robustness.at_start import bounds_at_start
from s2r_spec.robustness.bounds import RhoBounds
from s2r_spec.robustness.curve import Curve
from s2r_spec.robustness.evaluate import Walk, Witness
from s2r_spec.robustness.evaluation import End, Evaluation
from s2r_spec.robustness.explain import Explanation
from s2r_spec.robustness.explain_held import HeldExplainer
from s2r_spec.robustness.held import Course, Courses, HeldAlgebra
from s2r_spec.robustness.horizon import horizon, seconds_needed
from s2r_spec.robustness.narrow import narrowest, refuse_short
from s2r_spec.robustness.silence import HeldBounds, Span, edge_signals
from s2r_spec.robustness.stream import SignalMessages, in_one_turn
from s2r_spec.robustness.ties import restore_zero, restore_zeros
from s2r_spec.trace.instants import instant
from s2r_spec.trace.messages import union

FloatArray = NDArray[np.float64]


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
        witness: see :class:`s2r_spec.robustness.evaluate.Walk`.
    """

    streams: Mapping[str, SignalMessages]
    params: Mapping[str, FloatArray]
    since: float | None
    until: float
    witness: Witness = "open"

    @property
    def start(self) -> float:
        """The first time at which each signal has a value [s]."""
        first = [stream.first for stream in self.streams.values()]
        return max(first if self.since is None else [self.since, *first])

    @property
    def end(self) -> float:
        """The time until which each signal is valid; one that ends more than a silence early is silent instead [s]."""
        ends = {name: stream.end(self.until) for name, stream in self.streams.items()}
        whole = [
            end for name, end in ends.items()
            if self._last - self.streams[name].last <= self.streams[name].messages.bridged
        ]  # fmt: skip
        end = max(min(whole, default=self.until), self.start)
        return max(
            end, *(stream.stamp_up_to(end + snap_of(self.start, end)) for stream in self.streams.values())
        )

    @property
    def _last(self) -> float:
        """The last stamp of the log, as far as it is known [s]."""
        known = [
            one.messages.log_end for one in self.streams.values() if not math.isnan(one.messages.log_end)
        ]
        return min(max([*known, *(one.last for one in self.streams.values())]), self.until)

    def courses(self, start: float, end: float, numbers: Mapping[int, int]) -> Courses:
        """Return the signals from ``start`` to ``end``.

        Args:
            start: first instant [s].
            end: last instant [s].
            numbers: topic (``Stream.topic``) → which of several messages with one stamp is read.
        """
        signals = _Lazy(
            {name: partial(one.course, start, end, numbers[one.topic]) for name, one in self.streams.items()}
        )
        return Courses(signals, self.params, end - start, snap_of(start, end), self.witness)

    def walk(self, start: float, end: float, open_steps: bool = False) -> Walk[RhoBounds[Curve]]:
        """Return the walk that bounds ρ from ``start`` to ``end``; see :class:`HeldBounds`."""
        most = {stream.topic: stream.most for stream in self.streams.values()}
        if math.prod(most.values()) > MOST_VARIANTS:
            raise TraceError(
                f"too many signals have several values with one stamp: {math.prod(most.values())} combinations; s2r "
                f"tries at most {MOST_VARIANTS}; split the requirement"
            )
        # The messages of one topic come together; those of two topics in any combination.
        variants = [
            HeldAlgebra(self.courses(start, end, dict(zip(most, numbers, strict=True))))
            for numbers in product(*map(range, most.values()))
        ]
        silences = {name: stream.silences(start, end) for name, stream in self.streams.items()}
        return HeldBounds(variants, silences, self.unseen(start), open_steps).walk()

    def contradicts(self, formula: f.Formula, satisfied: bool) -> bool:
        """Return whether all messages contradict a verdict at samples, whatever is known at samples alone."""
        start, end = self.start, self.end
        lower, upper = bounds_at_start(formula, self.walk(start, end, open_steps=True), snap_of(start, end))
        return upper < 0 if satisfied else lower > 0

    def unseen(self, start: float) -> frozenset[str]:
        """Return the signals whose first message is at a start, in a log that began before."""
        firsts = {name: stream.first for name, stream in self.streams.items()}
        began = min(firsts.values()) if self.since is None else self.since
        return frozenset(name for name, first in firsts.items() if began < start <= first)

    def judge(self, formula: f.Formula, partial: bool = False) -> Judgement:
        """Return the verdict on a formula whose time bounds are numbers.

        Args:
            formula: the formula.
            partial: whether windows are cut at the end of the trace, so that it may be too short.
        """
        start, end = self.start, self.end
        snap = snap_of(start, end)
        lower, upper = bounds_at_start(formula, self.walk(start, end), snap)
        complete = seconds_needed(formula, 0.0) <= end - start + snap
        silent = {name: stream.silences(start, end) for name, stream in self.streams.items()}
        several = any(stream.most > 1 for stream in self.streams.values())
        unseen = sorted(self.unseen(start) & edge_signals(formula))
        sure = not (any(silent.values()) or unseen)
        satisfied: bool | None = lower > 0 if lower > 0 or upper < 0 or sure else None
        reason = "" if satisfied is not None else self._silent(silent, start) or self._first(unseen, start)
        unevaluated = {name: self._outside(stream, start, end) for name, stream in self.streams.items()}
        early = self.since is None and any(one.first < start for one in self.streams.values())
        if satisfied is not None and (early or any(map(any, unevaluated.values()))):
            reason = self._contradiction(formula, satisfied, unevaluated)
            satisfied = None if reason else satisfied
        if not (complete or partial):
            satisfied, reason = None, ""
        return Judgement(
            restore_zero(lower),
            restore_zero(upper),
            lower,
            satisfied,
            start,
            end,
            complete,
            instants_of(self.streams, silent, start, end),
            unevaluated,
            self.period,
            several and not any(silent.values()),
            reason,
            tuple(self._notes(silent, start, end, unevaluated)),
        )

    def explain(self, formula: f.Formula, judgement: Judgement, requirement: str, unit: str) -> Explanation:
        """Return the explanation of a verdict on a formula whose time bounds are numbers."""
        silent = any(stream.silences(judgement.start, judgement.end) for stream in self.streams.values())
        worse = not (
            silent and judgement.satisfied is False
        )  # beside a silence, only the upper bound is sure to be < 0
        walk = self.walk(judgement.start, judgement.end)
        return HeldExplainer(walk, judgement.start, worse).explain(formula, requirement, unit)

    def evaluate(self, formula: f.Formula, requirement: str, unit: str, end: End) -> Evaluation:
        """Return ρ along the window, its lower bound where there are two; for ``end`` see :meth:`Spec.evaluate`."""
        start, until = self.start, self.end
        needs = seconds_needed(formula, 0.0)
        stamps = union(stream.messages for stream in self.streams.values())
        times = np.union1d(stamps[(stamps > start) & (stamps <= until)], start)
        snap = snap_of(start, until)
        complete = times + needs <= until + snap
        if end == "error" and not complete.all():
            raise TraceError(
                f"{requirement!r} looks {needs:g} s ahead, past the end of the trace at {self._time(until)}"
            )
        judge = self._without_ends() if end == "hold" else self
        curve = judge.walk(start, until + needs if end == "hold" else until)(formula).lower
        rho = curve.values(times - start, snap)
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

    def _without_ends(self) -> Judge:
        """Return this judge with signals whose last values are valid for ever."""
        streams = {
            name: replace(one, messages=replace(one.messages, end=math.inf))
            for name, one in self.streams.items()
        }
        return replace(self, streams=streams)

    def shortfall(self, formula: f.Formula) -> str:
        """Return the end of a sentence on a requirement that the trace does not reach: "looks 2 s ahead, but …"."""
        length = self.end - self.start
        return f"looks {horizon(formula):g} s ahead, but its signals last {length:.6g} s together"

    @property
    def period(self) -> float | None:
        """The shortest period of a periodic signal [s]; None if there is none."""
        known = (one.messages.period for one in self.streams.values() if not math.isnan(one.messages.period))
        return min(known, default=None)

    def refuse_short(self, formula: f.Formula) -> None:
        """Refuse windows shorter than all periods; then the unit of the times is likely to be wrong.

        Raises:
            SamplingError: a window is shorter.
        """
        refuse_short(narrowest(formula), self.period, "the shortest period of a signal")

    # -- what lies outside of the window -----------------------------------------------------------------------------

    def _outside(self, stream: SignalMessages, start: float, end: float) -> tuple[int, int]:
        """Return the number of messages before the one that is held at the start, and after the end."""
        times = stream.messages.times
        held = times[max(int(np.searchsorted(times, start, side="right")) - 1, 0)]
        first = 0 if self.since is None else int(np.searchsorted(times, self.since))
        stop = int(np.searchsorted(times, self.until, side="right"))
        before = int(np.searchsorted(times, held)) - first
        return max(before, 0), max(stop - int(np.searchsorted(times, end, side="right")), 0)

    def _contradiction(
        self, formula: f.Formula, satisfied: bool, unevaluated: Mapping[str, tuple[int, int]]
    ) -> str:
        """Return why messages outside of the window contradict a verdict; "" if they do not."""
        verb, other = ("holds", "violate") if satisfied else ("is violated", "satisfy")
        late, early = self._last_to_begin(), self._first_to_end()
        first = min(stream.first for stream in self.streams.values())
        begin = first if self.since is None else max(first, self.since)
        after = any(count for _, count in unevaluated.values())
        before = begin < self.start
        for outside, start, why in (
            (
                after,
                self.start,
                f"{verb} until {self._time(self.end)}, where {early} ends, but messages after",
            ),
            (
                before,
                begin,
                f"{verb} from {self._time(self.start)} on, where {late} begins, but messages before",
            ),
        ):
            if not outside:
                continue
            end = max(self.until, start + seconds_needed(formula, 0.0))
            lower, upper = bounds_at_start(formula, self.walk(start, end), snap_of(start, end))
            if (upper < 0 and satisfied) or (lower > 0 and not satisfied):
                return f"{why} {other} it"
        return ""

    def _last_to_begin(self) -> str:
        """Return the signal that begins last."""
        return max(self.streams, key=lambda name: self.streams[name].first)

    def _first_to_end(self) -> str:
        """Return the signal that ends first, of those that last as long as the log."""
        return min(self.streams, key=lambda name: abs(self.streams[name].end(self.until) - self.end))

    # -- words -------------------------------------------------------------------------------------------------------

    def _time(self, time: float) -> str:
        """Return a time on the clock of the trace as text."""
        longest = max(self.streams.values(), key=lambda stream: len(stream.messages)).messages.times
        place = int(np.searchsorted(longest, time))
        near = longest[max(place - 2, 0) : place + 3]
        return instant(np.concatenate((longest[:1], near)), time)

    def _first(self, names: Sequence[str], start: float) -> str:
        """Return the reason of a verdict that depends on a change at the first messages of signals."""
        return f"depends on the value of {' and '.join(names)} before its first message at t = {self._time(start)}"

    def _silent(self, silent: Mapping[str, Sequence[Span]], start: float) -> str:
        """Return the reason of a verdict that depends on a silence; "" if there is none."""
        spans = [(name, span) for name, spans in silent.items() for span in spans]
        if not spans:
            return ""
        name, (begin, end) = max(spans, key=lambda one: one[1][1] - one[1][0])
        way = "; --duration can end the trace before" if math.isinf(end) else ""
        return f"depends on {name} {self._span(start, begin, end)}, where it has no message{way}"

    def _span(self, start: float, begin: float, end: float) -> str:
        last = self.until if math.isinf(end) else start + end
        first = start if math.isinf(begin) else start + begin
        return f"from t = {self._time(first)} to {self._time(last)}"

    def _notes(
        self,
        silent: Mapping[str, Sequence[Span]],
        start: float,
        end: float,
        unevaluated: Mapping[str, tuple[int, int]],
    ) -> list[str]:
        notes = []
        for name, stream in self.streams.items():
            spans, own = silent[name], stream.messages
            if spans:
                longest = max(spans, key=lambda span: span[1] - span[0])
                more = f", the longest of {len(spans)} gaps" if len(spans) > 1 else ""
                notes.append(
                    f"{name} has no message {self._span(start, *longest)}{more}, though {own.rhythm}: its value "
                    f"is not known there"
                )
            if math.isinf(own.bridged) and len(own) > 1 and not own.linear:
                notes.append(f"{name} is sent on change, and each value is held until the next message")
            repeated = len(own) - len(np.unique(own.times))
            if repeated:
                notes.append(
                    f"{count_messages(repeated, name, 'have')} another value with the same stamp: the worse decides"
                )
            around = int((np.abs(np.diff(stream.values)) > stream.turn / 2).any(axis=0).sum())
            if around and own.linear and in_one_turn(stream.values, stream.turn):
                notes.append(
                    f"{name} jumps by over half a turn {around} times, and is interpolated on the circle"
                )
            if stream.without:
                notes.append(
                    f"{count_messages(stream.without, name, 'have')} no value, and the value before is held"
                )
            before, after = unevaluated[name]
            if before:
                late = self._last_to_begin()
                notes.append(
                    f"{count_messages(before, name, 'lie')} before {self._time(start)}, where {late} begins"
                )
            if after:
                notes.append(
                    f"{count_messages(after, name, 'lie')} after {self._time(end)}, where {self._first_to_end()} ends"
                )
        return notes


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
