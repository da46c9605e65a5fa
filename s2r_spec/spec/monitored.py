"""The verdict on one requirement of one recorded trace, with its reason and with what it rests on.

A trace that failed has its declared ρ. Common samples are evaluated at the samples, and signals with messages of their
own at every instant (:mod:`s2r_spec.robustness.judge`). The verdict is unknown where the trace is too short, where it
depends on a silence, and where samples at one topic's stamps decide otherwise than all messages.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from s2r_spec.base.errors import UsageError
from s2r_spec.base.printable import count_messages
from s2r_spec.lang import formula as f
from s2r_spec.lang.amounts import Amount
from s2r_spec.robustness.account import Instants
from s2r_spec.robustness.evaluation import Evaluation
from s2r_spec.robustness.explain import Explanation
from s2r_spec.robustness.grid import sent_on_change
from s2r_spec.robustness.judge import Judgement
from s2r_spec.robustness.profiles import Profile, profile
from s2r_spec.robustness.reading import Missing
from s2r_spec.robustness.silence import silences_of
from s2r_spec.trace import Trace
from s2r_spec.trace.instants import instant
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

    @property
    def profile(self) -> Profile:
        """The conventions of the tool."""
        return profile(self.like)


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
    if trace.failure is not None:
        reason = spec.explain(trace, requirement, params)
        return Monitored(requirement, reason.satisfied, str(reason), reason)
    own = spec.own_trace(trace, requirement)
    if own.messages:
        return _of_own_messages(spec, own, requirement, params, conventions)
    result = _of_samples(spec, own, requirement, params, conventions)
    messages = own.as_messages() if own.origin is None and result.on_change else own.origin
    if messages is None or not result.decided:
        return result
    if conventions.like != "s2r" or spec.needs_samples(requirement, messages):
        assert result.satisfied is not None
        if spec.contradicts(messages, requirement, result.satisfied, params, conventions.nan):
            head = (
                f"{requirement} unknown: at its samples {_one_line(result)}, but all messages contradict it"
            )
            text = "\n".join((head, *result.text.split("\n")[1:]))
            return replace(result, satisfied=None, text=text, reason=None)
        return _without_the_rest(result, own, messages)
    where = "at its samples" if result.on_change else "at the stamps of the clock"
    return _reconcile(result, _of_messages(spec, messages, requirement, params, conventions), where)


def _of_own_messages(
    spec: Spec, trace: Trace, requirement: str, params: Mapping[str, Amount], conventions: Conventions
) -> Monitored:
    """Return the result at every instant; by the conventions of another tool, unknown where a silence decides it."""
    every = _of_messages(spec, trace, requirement, params, conventions)
    if conventions.like == "s2r":
        return every
    sampled = _of_samples(spec, trace, requirement, params, conventions)
    return sampled if every.decided else _reconcile(sampled, every, f"by {conventions.like}")


def _without_the_rest(result: Monitored, sampled: Trace, messages: Trace) -> Monitored:
    """Return a result at samples, with a note on the messages between these; unknown where a signal was silent."""
    for name, (start, end) in messages.silences().items():
        head = (
            f"{result.requirement} unknown: {name} has no message from t = {instant(sampled.times, start)} to "
            f"{instant(sampled.times, end)}"
        )
        text = "\n".join((head, *result.text.split("\n")[1:]))
        return replace(result, satisfied=None, text=text, reason=None)
    rest = {
        name: int(np.count_nonzero(~np.isin(one.times, sampled.times)))
        for name, one in messages.messages.items()
    }
    lines = [
        f"\n  note: {count_messages(count, name, 'lie')} unevaluated between the samples"
        for name, count in rest.items()
        if count
    ]
    return replace(result, text="".join((result.text, *lines))) if lines else result


def _of_messages(
    spec: Spec, trace: Trace, requirement: str, params: Mapping[str, Amount], conventions: Conventions
) -> Monitored:
    judged, reason = spec.judge(
        trace,
        requirement,
        params,
        nan=conventions.nan,
        partial=conventions.partial,
        sparse=conventions.sparse or conventions.stated,
    )
    sampled = Sampled(judged.period, judged.end - judged.start, None, judged.instants, judged.unevaluated)
    lines = [_instants(judged), *(f"  note: {note}" for note in judged.notes)]
    if reason is not None:
        bounds = (
            [] if judged.lower == judged.upper else [f"  ρ lies in {_range(judged, spec.unit(requirement))}"]
        )
        head = str(reason)
        return Monitored(requirement, judged.satisfied, "\n".join((head, *bounds, *lines)), reason, sampled)
    why = judged.open
    if not why:
        short = spec.shortfall(trace, requirement, params, nan=conventions.nan)
        why = f"it {short} (--partial evaluates the recorded part)"
    else:
        why = f"it {why}"
    return Monitored(requirement, None, "\n".join((f"{requirement} unknown: {why}", *lines)), None, sampled)


def _range(judged: Judgement, unit: str) -> str:
    return f"[{judged.lower:+.6g}, {judged.upper:+.6g}] {unit}".rstrip()


def _instants(judged: Judgement) -> str:
    """Return a line on the instants at which messages are evaluated."""
    own = " and ".join(f"{one.own} of {name}" for name, one in judged.instants.items())
    return f"  at every instant of {judged.end - judged.start:.6g} s, held between the messages: {own}"


def _of_samples(
    spec: Spec, trace: Trace, requirement: str, params: Mapping[str, Amount], conventions: Conventions
) -> Monitored:
    how, partial = conventions.profile, conventions.partial
    held = how["end"] == "hold" and len(trace) > 1
    if partial and not held:
        how = {**how, "end": "clip"}
    irregular = _irregular(trace, how)
    if irregular and conventions.stated:
        # Values that are sent on change may be further apart than a window is long.
        conventions = replace(conventions, sparse=True)
    evaluation = spec.evaluate(
        trace, requirement, params, nan=conventions.nan, sparse=conventions.sparse, **how
    )
    instants = {name: _own_instants(trace, name) for name in spec.channels(requirement)}
    outside = dict.fromkeys(instants, (0, 0))
    sampled = Sampled(evaluation.period, evaluation.duration, evaluation.narrowest, instants, outside)
    notes = [
        *evaluation.notes,
        *_held_notes(spec, trace, requirement, conventions),
        *_rhythm(trace, how, irregular),
    ]
    lines = [_sampling_line(evaluation), *(f"  note: {note}" for note in notes)]
    unknown = ""
    if partial and not evaluation.complete[0] and math.isinf(evaluation.value):
        unknown = "no recorded sample decides it"
    elif not (evaluation.complete[0] or partial or held):
        short = spec.shortfall(trace, requirement, params, nan=conventions.nan)
        unknown = f"it {short} (--partial evaluates the recorded part)"
    elif not partial:
        unknown = _in_gap(spec, trace, requirement, params, conventions)
    if unknown:
        text = "\n".join((f"{requirement} unknown: {unknown}", *lines))
        return Monitored(requirement, None, text, None, sampled, irregular)
    why = ""
    if how["interpolation"] not in (None, "samples"):
        why = f"{conventions.like} evaluates it at every instant, so no single sample decides it"
    elif not evaluation.complete[0] and held:
        why = f"it looks past the last sample, whose value is held as in {conventions.like}"
    if why:
        reason = Explanation(requirement, evaluation.value, evaluation.unit, evaluation.satisfied, reason=why)
    else:
        reason = spec.explain(
            trace,
            requirement,
            params,
            until=how["until"],
            partial=True,
            nan=conventions.nan,
            sparse=conventions.sparse,
        )
    text = "\n".join((str(reason), *lines))
    return Monitored(requirement, reason.satisfied, text, reason, sampled, irregular)


def _in_gap(
    spec: Spec, trace: Trace, requirement: str, params: Mapping[str, Amount], conventions: Conventions
) -> str:
    """Return why the verdict depends on a gap without samples; "" if it does not."""
    bounds = spec.bounds(trace, requirement, params, nan=conventions.nan, sparse=conventions.sparse)
    if bounds is None or (bounds[0] > 0) == (bounds[1] > 0):
        return ""
    start, end = max(silences_of(trace.times), key=lambda span: span[1] - span[0])
    return (
        f"it depends on the gap of {end - start:.3g} s after t = {instant(trace.times, start)}, which has no sample "
        f"(--partial evaluates the samples)"
    )


def _own_instants(trace: Trace, name: str) -> Instants:
    """Return the account of a signal with common samples."""
    values = trace[name].reshape(len(trace), -1)
    missing = int(np.isnan(values).any(axis=1).sum())
    own = int((trace.own(name) & ~np.isnan(values).any(axis=1)).sum())
    return Instants(own, len(trace) - own - missing, 0, missing)


def _irregular(trace: Trace, how: Profile) -> bool:
    """Return whether samples come irregularly, as values that are sent on change, and are evaluated alone."""
    if how["interpolation"] not in (None, "samples") or trace.messages:
        return False
    return sent_on_change(trace.times)


def _rhythm(trace: Trace, how: Profile, irregular: bool) -> list[str]:
    """Return notes on gaps, and on samples that come irregularly."""
    if trace.messages or len(trace) < 2:
        return []
    spans = silences_of(trace.times)
    if spans:
        start, end = max(spans, key=lambda span: span[1] - span[0])
        more = f", the longest of {len(spans)} gaps" if len(spans) > 1 else ""
        return [
            f"there is no sample in the {end - start:.3g} s after t = {instant(trace.times, start)}{more}; they come "
            f"every {np.median(np.diff(trace.times)):.3g} s"
        ]
    if irregular:
        return [
            "the samples come irregularly, and nothing is evaluated between them; --profile rtamt-dense holds each "
            "value until the next one"
        ]
    return []


def _held_notes(spec: Spec, trace: Trace, requirement: str, conventions: Conventions) -> list[str]:
    """Return a note on each signal whose missing samples are held."""
    if conventions.nan != "hold" or trace.messages:
        return []
    notes = []
    for name in spec.channels(requirement):
        missing = np.isnan(trace[name].reshape(len(trace), -1)).any(axis=1)
        if missing.any():
            known = trace.times[~missing]
            longest = np.diff(np.append(known, trace.times[-1])).max() if known.size else math.inf
            notes.append(
                f"{int(missing.sum())} of {len(trace)} samples of {name} are missing, and the value before is held for "
                f"up to {longest:.3g} s"
            )
    return notes


def _sampling_line(evaluation: Evaluation) -> str:
    """Return a line on the sampling of a trace, which shows times in a wrong unit."""
    if evaluation.period is None:
        return "  one sample"
    windows = (
        "" if evaluation.narrowest is None else f", {evaluation.narrowest} samples in the narrowest window"
    )
    return f"  sampled every {evaluation.period:.6g} s for {evaluation.duration:.6g} s{windows}"


def _reconcile(sampled: Monitored, every: Monitored, where: str) -> Monitored:
    """Return a result at some samples; unknown where all messages, or every instant, decide otherwise."""
    if not sampled.decided or (every.decided and sampled.satisfied == every.satisfied):
        return sampled
    head = (
        f"{sampled.requirement} unknown: {where} {_one_line(sampled)}, but not for certain at every instant"
    )
    lines = sampled.text.split("\n")[1:]
    if every.decided:
        head = f"{sampled.requirement} unknown: {where} {_one_line(sampled)}, but at every instant {_one_line(every)}"
    else:
        lines += every.text.split("\n")
    return replace(sampled, satisfied=None, text="\n".join((head, *lines)), reason=None)


def _one_line(result: Monitored) -> str:
    assert result.reason is not None
    word = "it holds" if result.satisfied else "it is violated"
    return f"{word}, ρ = {result.reason.rho:+.6g} {result.reason.unit}".rstrip()


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
