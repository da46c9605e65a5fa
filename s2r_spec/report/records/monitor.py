"""The objects of ``s2r monitor``. A number that is not finite is a word here: "inf", "-inf" or "nan"."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from s2r_spec.base.json_values import ExitCode, Point
from s2r_spec.logs.account import Account
from s2r_spec.robustness.account import Instants
from s2r_spec.robustness.explain import Explanation


@dataclass(frozen=True, kw_only=True)
class _Verdict:
    verdict: Literal["holds", "violated"]
    text: str


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How a trace is sampled.

    Attributes:
        period: median time from one sample to the next [s]; null for one sample.
        duration: the duration of the trace [s].
        narrowest_window: samples in the shortest window of positive length; null if there is none.
        instants: signal → the instants at which it is evaluated: own + held + interpolated + missing of all. Only for
            signals with messages of their own.
        outside: signal → messages before and after these instants, which are not evaluated.
    """

    period: float | None
    duration: float
    narrowest_window: int | None
    instants: Mapping[str, Instants]
    outside: Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class FailedRequirement(Explanation, _Verdict):
    """The result of one requirement on a trace that ended in a failure.

    Attributes:
        verdict: holds or violated.
        text: the result in a few lines.
    """


@dataclass(frozen=True)
class MonitoredRequirement(Sampling, Explanation, _Verdict):
    """The result of one requirement on a trace, and how the trace is sampled.

    Attributes:
        verdict: holds or violated.
        text: the result in a few lines.
    """


@dataclass(frozen=True, kw_only=True)
class _Unknown:
    requirement: str
    verdict: Literal["unknown"] = "unknown"
    satisfied: None = None
    text: str


@dataclass(frozen=True, kw_only=True)
class UnknownRequirement(Sampling, _Unknown):
    """One requirement on a trace that is too short for it, and how the trace is sampled.

    Attributes:
        requirement: the name of the requirement.
        verdict: unknown.
        satisfied: null.
        text: the result in a few lines.
    """


MonitoredKind = FailedRequirement | MonitoredRequirement | UnknownRequirement


@dataclass(frozen=True, kw_only=True)
class MonitoredTrace:
    """The results of one trace.

    Attributes:
        trace: the file of the trace.
        params: test parameter → value.
        from_trace: names of the parameters that the file gave.
        notes: the parts of the file that were left out, each in one sentence.
        accounts: signal → what became of its messages in the file: messages = samples + merged + dropped.
        requirements: one result for each requirement.
    """

    trace: str
    params: Point
    from_trace: tuple[str, ...]
    notes: tuple[str, ...]
    accounts: Mapping[str, Account]
    requirements: tuple[MonitoredKind, ...]


@dataclass(frozen=True, kw_only=True)
class UnreadTrace:
    """A trace that could not be evaluated.

    Attributes:
        trace: the file of the trace.
        error: the reason, in one sentence.
        requirements: empty.
    """

    trace: str
    error: str
    requirements: tuple[()] = ()


@dataclass(frozen=True, kw_only=True)
class MonitorObject:
    """The result of ``s2r monitor``.

    Attributes:
        exit_code: 0 holds, 1 violated, 3 unknown, 2 if a trace could not be evaluated.
        spec: the specification.
        hash: the hash of the specification.
        profile: the tool whose conventions were used.
        params: test parameter → value, as given.
        results: one result for each trace.
    """

    schema: Literal["s2r.monitor/1"] = "s2r.monitor/1"
    exit_code: ExitCode | Literal[2]
    spec: str
    hash: str
    profile: str
    params: Point
    results: tuple[MonitoredTrace | UnreadTrace, ...]


@dataclass(frozen=True, kw_only=True)
class RequirementInterval:
    """The range of values that ρ of a requirement can still take.

    Attributes:
        requirement: the name of the requirement.
        unit: the unit of ρ.
        verdict: unknown until no sample can change it.
        satisfied: whether the requirement is true; null while this is undecided.
        lower: lower end of the interval.
        upper: upper end of the interval.
    """

    requirement: str
    unit: str
    verdict: Literal["holds", "violated", "unknown"]
    satisfied: bool | None
    lower: float
    upper: float


@dataclass(frozen=True, kw_only=True)
class _Change:
    schema: Literal["s2r.online/1"] = "s2r.online/1"
    time: float


@dataclass(frozen=True, kw_only=True)
class ChangeObject(RequirementInterval, _Change):
    """One line of ``s2r monitor --online``: an interval or a verdict has changed.

    Attributes:
        time: the time of the sample [s].
    """


@dataclass(frozen=True, kw_only=True)
class OnlineObject:
    """The last line of ``s2r monitor --online``.

    Attributes:
        exit_code: 0 holds, 1 violated, 3 unknown.
        spec: the specification.
        hash: the hash of the specification.
        params: test parameter → value.
        requirements: the result of each requirement.
    """

    schema: Literal["s2r.online/1"] = "s2r.online/1"
    exit_code: ExitCode
    spec: str
    hash: str
    params: Point
    requirements: tuple[RequirementInterval, ...]
