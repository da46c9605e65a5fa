"""The verdict on one requirement of one recorded trace, with its reason and with what it rests on.

A trace that failed has its declared ρ. Common samples are evaluated at the samples, and signals with messages of their
own at every instant (:mod:`s2r_spec.robustness.judge`). The verdict is unknown where the trace is too short, where it
depends on a silence, and where samples at one topic's stamps decide otherwise than all messages.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from s2r_spec.base.arrays import BoolArray
from s2r_spec.base.errors import UsageError
from s2r_spec.base.printable import count_messages
from s2r_spec.lang import formula as f
from s2r_spec.lang.amounts import Amount
from s2r_spec.robustness.account import Instants
from s2r_spec.robustness.evaluation import Evaluation
from s2r_spec.robustness.explain import Explanation
from s2r_spec.robustness.grid import sent_on_change
from s2r_spec.robustness.profiles import Profile, profile
from s2r_spec.robustness.reading import Missing
from s2r_spec.spec.on_traces import How
from s2r_spec.trace import Trace
from s2r_spec.trace.instants import instant
from s2r_spec.trace.messages import silences_of
from s2r_spec.trace.samples import FAST, SLOW

if TYPE_CHECKING:
    from s2r_spec.spec.evaluated import Spec


@dataclass(frozen=True)
class Sampled:
    """How a trace is sampled.

    Args:
        period: median time from one sample to the next, or the shortest period of a signal [s]; None if there is none.
        duration: time that is evaluated [s].
        narrowest_window: samples in the shortest window of positive length; None if there is none.
        instants: signal → the instants at which it is evaluated.
        outside: signal → messages before and after these instants, which are not evaluated.
    """

    period: float | None
    duration: float
    narrowest_window: int | None
    instants: Mapping[str, Instants] = field(default_factory=dict)
    outside: Mapping[str, tuple[int, int]] = field(default_factory=dict)


@dataclass(frozen=True)
class Monitored:
    """The result of one requirement on a trace.

    Args:
        requirement: its name.
        satisfied: whether it holds; None if the trace does not decide it.
        text: the result in a few lines.
        reason: what decides ρ; None if the verdict is unknown.
        sampled: how the trace is sampled; None for one that failed.
        on_change: whether its samples come irregularly, as values that are sent on change.
    """

    requirement: str
    satisfied: bool | None
    text: str
    reason: Explanation | None = None
    sampled: Sampled | None = None
    on_change: bool = False

    @property
    def decided(self) -> bool:
        """Whether the trace decides the requirement."""
        return self.satisfied is not None

    @property
    def lines(self) -> list[str]:
        """The lines of the text below the first one."""
        return self.text.split("\n")[1:]

    @property
    def one_line(self) -> str:
        """The verdict and ρ in words."""
        assert self.reason is not None
        word = "it holds" if self.satisfied else "it is violated"
        return f"{word}, ρ = {self.reason.rho:+.6g} {self.reason.unit}".rstrip()

    def unknown(self, why: str, lines: Iterable[str]) -> Monitored:
        """Return this result without a verdict: why, and lines below."""
        text = "\n".join((f"{self.requirement} unknown: {why}", *lines))
        return replace(self, satisfied=None, text=text, reason=None)


@dataclass(frozen=True)
class Conventions:
    """How a requirement is evaluated.

    Args:
        nan: the treatment of a missing sample.
        partial: whether windows are cut at the end of a trace that is too short.
        sparse: whether windows may be shorter than the time between two samples, since the user states their unit.
        stated: whether the file or the user states the unit of the times.
        like: name of the tool whose conventions hold.
    """

    nan: Missing = "error"
    partial: bool = False
    sparse: bool = False
    stated: bool = False
    like: str = "s2r"


def monitor_trace(
    spec: Spec, trace: Trace, names: Sequence[str], params: Mapping[str, Amount], conventions: Conventions
) -> list[Monitored]:
    """Return the results of requirements on a trace; a unit of the times that matters must be stated.

    Raises:
        TraceError: see :func:`monitor_requirement`.
        UsageError: see :func:`monitor_requirement` and :func:`refuse_unstated`.
    """
    results = []
    for name in names:
        if not conventions.stated:
            refuse_unstated(spec, trace, name)
        results.append(monitor_requirement(spec, trace, name, params, conventions))
    return results


def monitor_requirement(
    spec: Spec, trace: Trace, requirement: str, params: Mapping[str, Amount], conventions: Conventions
) -> Monitored:
    """Return the result of one requirement on a trace.

    Raises:
        TraceError: a channel is missing, has NaN or an unfit unit, or a window is shorter than the sample period.
        UsageError: a parameter is missing, or the conventions do not fit the trace.
    """
    return _Monitoring(spec, requirement, params, conventions).monitor(trace)


@dataclass(frozen=True)
class _Monitoring:
    """One requirement, and how it is evaluated."""

    spec: Spec
    requirement: str
    params: Mapping[str, Amount]
    conventions: Conventions

    def monitor(self, trace: Trace) -> Monitored:
        spec, conventions, requirement = self.spec, self.conventions, self.requirement
        if trace.failure is not None:
            reason = spec.explain(trace, requirement, self.params)
            return Monitored(requirement, reason.satisfied, str(reason), reason)
        own = spec.own_trace(trace, requirement)
        if own.messages:
            return self._of_own_messages(own)
        result = self._of_samples(own)
        messages = own.as_messages() if own.origin is None and result.on_change else own.origin
        if messages is None or result.satisfied is None:
            return result
        if conventions.like != "s2r" or spec.needs_samples(requirement, messages):
            if spec.contradicts(
                messages, requirement, result.satisfied, How(self.params, nan=conventions.nan)
            ):
                return result.unknown(
                    f"at its samples {result.one_line}, but all messages contradict it", result.lines
                )
            return _without_the_rest(result, own, messages)
        where = "at its samples" if result.on_change else "at the stamps of the clock"
        return _reconcile(result, self._of_messages(messages), where)

    def _of_own_messages(self, trace: Trace) -> Monitored:
        """Return the result at every instant; by another tool's conventions, unknown where a silence decides it."""
        every = self._of_messages(trace)
        if self.conventions.like == "s2r":
            return every
        sampled = self._of_samples(trace)
        return sampled if every.decided else _reconcile(sampled, every, f"by {self.conventions.like}")

    def _of_messages(self, trace: Trace) -> Monitored:
        how = self.conventions
        judged, reason = self.spec.judge(
            trace,
            self.requirement,
            self.params,
            nan=how.nan,
            partial=how.partial,
            sparse=how.sparse or how.stated,
        )
        sampled = Sampled(judged.period, judged.end - judged.start, None, judged.instants, judged.unevaluated)
        own = " and ".join(f"{one.own} of {name}" for name, one in judged.instants.items())
        lines = [
            f"  at every instant of {sampled.duration:.6g} s, held between the messages: {own}",
            *(f"  note: {note}" for note in judged.notes),
        ]
        if reason is None:
            why = f"it {judged.open}" if judged.open else self._too_short(trace)
            return Monitored(self.requirement, None, "", None, sampled).unknown(why, lines)
        if judged.lower != judged.upper:
            unit = self.spec.unit(self.requirement)
            lines.insert(0, f"  ρ lies in [{judged.lower:+.6g}, {judged.upper:+.6g}] {unit}".rstrip())
        text = "\n".join((str(reason), *lines))
        return Monitored(self.requirement, judged.satisfied, text, reason, sampled)

    def _too_short(self, trace: Trace) -> str:
        short = self.spec.shortfall(trace, self.requirement, self.params, nan=self.conventions.nan)
        return f"it {short} (--partial evaluates the recorded part)"

    def _of_samples(self, trace: Trace) -> Monitored:
        spec, requirement = self.spec, self.requirement
        how, partial, nan = profile(self.conventions.like), self.conventions.partial, self.conventions.nan
        held = how["end"] == "hold" and len(trace) > 1
        if partial and not held:
            how = {**how, "end": "clip"}
        irregular = _irregular(trace, how)
        # Values that are sent on change may be further apart than a window is long.
        sparse = self.conventions.sparse or (irregular and self.conventions.stated)
        found = spec.evaluate(trace, requirement, self.params, nan=nan, sparse=sparse, **how)
        instants = {name: _own_instants(trace, name) for name in spec.channels(requirement)}
        outside = dict.fromkeys(instants, (0, 0))
        sampled = Sampled(found.period, found.duration, found.narrowest, instants, outside)
        notes = [*found.notes, *self._held_notes(trace), *_rhythm(trace, irregular)]
        lines = [_sampling_line(found), *(f"  note: {note}" for note in notes)]
        unknown = ""
        if partial and not found.complete[0] and math.isinf(found.value):
            unknown = "no recorded sample decides it"
        elif not (found.complete[0] or partial or held):
            unknown = self._too_short(trace)
        elif not partial:
            unknown = self._in_gap(trace, sparse)
        result = Monitored(requirement, None, "", None, sampled, irregular)
        if unknown:
            return result.unknown(unknown, lines)
        why = ""
        if how["interpolation"] not in (None, "samples"):
            why = f"{self.conventions.like} evaluates it at every instant, so no single sample decides it"
        elif not found.complete[0] and held:
            why = f"it looks past the last sample, whose value is held as in {self.conventions.like}"
        if why:
            reason = Explanation(requirement, found.value, found.unit, found.satisfied, reason=why)
        else:
            reason = spec.explain(
                trace, requirement, self.params, until=how["until"], partial=True, nan=nan, sparse=sparse
            )
        return replace(
            result, satisfied=reason.satisfied, text="\n".join((str(reason), *lines)), reason=reason
        )

    def _in_gap(self, trace: Trace, sparse: bool) -> str:
        """Return why the verdict depends on a gap without samples; "" if it does not."""
        bounds = self.spec.bounds(
            trace, self.requirement, self.params, nan=self.conventions.nan, sparse=sparse
        )
        if bounds is None or (bounds[0] > 0) == (bounds[1] > 0):
            return ""
        start, end = max(silences_of(trace.times), key=lambda span: span[1] - span[0])
        return (
            f"it depends on the gap of {end - start:.3g} s after t = {instant(trace.times, start)}, which has no "
            f"sample (--partial evaluates the samples)"
        )

    def _held_notes(self, trace: Trace) -> Iterator[str]:
        """Yield a note on each signal whose missing samples are held."""
        if self.conventions.nan != "hold" or trace.messages:
            return
        for name in self.spec.channels(self.requirement):
            missing = _missing(trace, name)
            if missing.any():
                known = trace.times[~missing]
                longest = np.diff(np.append(known, trace.times[-1])).max() if known.size else math.inf
                yield (
                    f"{int(missing.sum())} of {len(trace)} samples of {name} are missing, and the value before is held "
                    f"for up to {longest:.3g} s"
                )


def _without_the_rest(result: Monitored, sampled: Trace, messages: Trace) -> Monitored:
    """Return a result at samples, with a note on the messages between these; unknown where a signal was silent."""
    for name, span in messages.silences().items():
        start, end = (instant(sampled.times, time) for time in span)
        return result.unknown(f"{name} has no message from t = {start} to {end}", result.lines)
    rest = {
        name: int(np.count_nonzero(~np.isin(one.times, sampled.times)))
        for name, one in messages.messages.items()
    }
    lines = [
        f"  note: {count_messages(count, name, 'lie')} unevaluated between the samples"
        for name, count in rest.items()
        if count
    ]
    return replace(result, text="\n".join((result.text, *lines)))


def _missing(trace: Trace, name: str) -> BoolArray:
    """Return (n,) whether a sample of a channel is missing."""
    return np.asarray(np.isnan(trace[name].reshape(len(trace), -1)).any(axis=1))


def _own_instants(trace: Trace, name: str) -> Instants:
    """Return the account of a signal with common samples."""
    missing = _missing(trace, name)
    own, gone = int((trace.own(name) & ~missing).sum()), int(missing.sum())
    return Instants(own, len(trace) - own - gone, 0, gone)


def _irregular(trace: Trace, how: Profile) -> bool:
    """Return whether samples come irregularly, as values that are sent on change, and are evaluated alone."""
    alone = how["interpolation"] in (None, "samples") and not trace.messages
    return alone and sent_on_change(trace.times)


def _rhythm(trace: Trace, irregular: bool) -> list[str]:
    """Return notes on gaps, and on samples that come irregularly."""
    if trace.messages or len(trace) < 2:
        return []
    spans = silences_of(trace.times)
    if spans:
        start, end = max(spans, key=lambda span: span[1] - span[0])
        more = f", the longest of {len(spans)} gaps" if len(spans) > 1 else ""
        return [
            f"there is no sample in the {end - start:.3g} s after t = {instant(trace.times, start)}{more}; they come "
            f"every {float(np.median(np.diff(trace.times))):.3g} s"
        ]
    if irregular:
        return [
            "the samples come irregularly, and nothing is evaluated between them; --profile rtamt-dense holds each "
            "value until the next one"
        ]
    return []


def _sampling_line(evaluation: Evaluation) -> str:
    """Return a line on the sampling of a trace, which shows times in a wrong unit."""
    if evaluation.period is None:
        return "  one sample"
    narrowest = evaluation.narrowest
    windows = "" if narrowest is None else f", {narrowest} samples in the narrowest window"
    return f"  sampled every {evaluation.period:.6g} s for {evaluation.duration:.6g} s{windows}"


def _reconcile(sampled: Monitored, every: Monitored, where: str) -> Monitored:
    """Return a result at some samples; unknown where all messages, or every instant, decide otherwise."""
    if not sampled.decided or (every.decided and sampled.satisfied == every.satisfied):
        return sampled
    here = f"{where} {sampled.one_line}, but"
    if every.decided:
        return sampled.unknown(f"{here} at every instant {every.one_line}", sampled.lines)
    lines = [*sampled.lines, *every.text.split("\n")]
    return sampled.unknown(f"{here} not for certain at every instant", lines)


def depends_on_unit_of_time(spec: Spec, requirement: str) -> str:
    """Return the text of a function or a window whose value depends on the unit of the times; "" if there is none."""
    for node in f.walk(spec.formulas[requirement]):
        match node:
            case f.Derivative() | f.Duration() | f.Accumulated():
                return " ".join(node.span.text.split())
            case f.Temporal() | f.Until() if 0.0 < node.interval.high < math.inf:
                return " ".join(node.interval.span.text.split())
    return ""


def refuse_unstated(spec: Spec, trace: Trace, requirement: str) -> None:
    """Refuse a function of time on a trace whose times have no unit and look like none in seconds.

    Logs of robots have several samples a second. Whole numbers one apart are milliseconds as often as seconds.

    Raises:
        UsageError: samples come every SLOW or less often, in less than FAST, or the times are whole
            numbers.
    """
    text, times = depends_on_unit_of_time(spec, requirement), trace.times
    if not text or len(times) < 2:
        return
    every = float(np.median(np.diff(times)))
    if FAST < every < 1.0 or (1.0 <= every < SLOW and (times != np.rint(times)).any()):
        return
    raise UsageError(
        f"`{text}` depends on the unit of the times, and the file states none. As seconds, samples come every "
        f"{every:.6g} s; give --time-unit ms or s"
    )
