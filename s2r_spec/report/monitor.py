"""The results of ``s2r monitor``, and their records: of recorded traces, and of one trace while it is recorded.

The records are loaded where one is made: a person at a terminal needs none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from s2r_spec.base.json_values import ExitCode, extend
from s2r_spec.base.verdict import Verdict, worst
from s2r_spec.recordings.spec_traces import SpecTrace, TraceRequest, in_file, read_spec_traces
from s2r_spec.spec import Spec
from s2r_spec.spec.monitored import Conventions, Monitored, monitor_trace

if TYPE_CHECKING:
    from s2r_spec.report.records.monitor import (
        ChangeObject,
        MonitoredKind,
        MonitorObject,
        OnlineObject,
        RequirementInterval,
    )
    from s2r_spec.robustness.online.monitor import RobustInterval
    from s2r_spec.spec.followed import Ended, VerdictChange


class Evaluated(NamedTuple):
    """A trace, and the result of each requirement on it."""

    trace: SpecTrace
    results: list[Monitored]


class Unread(NamedTuple):
    """A file that cannot be evaluated, and why."""

    path: Path
    error: str


def monitor_file(request: TraceRequest, path: Path, conventions: Conventions) -> list[Evaluated]:
    """Return the results of one file, one for each episode; an error names the file."""
    results = []
    for one in read_spec_traces(request, path):
        how = replace(conventions, stated=one.stated)
        with in_file(path):
            monitored = monitor_trace(request.spec, one.trace, request.requirements, one.params, how)
        results.append(Evaluated(one, monitored))
    return results


def exit_code(results: Sequence[Evaluated | Unread]) -> ExitCode | Literal[2]:
    """Return the exit code of all files: 2 if one could not be evaluated, else that of the worst verdict."""
    if any(isinstance(one, Unread) for one in results):
        return 2
    evaluated = [one for one in results if isinstance(one, Evaluated)]
    return worst(Verdict.of(each.satisfied) for one in evaluated for each in one.results).exit_code


def monitor_record(
    request: TraceRequest, results: Sequence[Evaluated | Unread], profile: str
) -> MonitorObject:
    """Return the record of all files."""
    from s2r_spec.report.records.monitor import MonitoredTrace, MonitorObject, UnreadTrace

    records: list[MonitoredTrace | UnreadTrace] = []
    for result in results:
        if isinstance(result, Unread):
            records.append(UnreadTrace(trace=str(result.path), error=result.error))
            continue
        one = result.trace
        records.append(
            MonitoredTrace(
                trace=one.name,
                params=one.params,
                from_trace=tuple(sorted(one.taken)),
                notes=one.notes,
                accounts=one.accounts,
                requirements=tuple(map(_requirement, result.results)),
            )
        )
    return MonitorObject(
        exit_code=exit_code(results),
        spec=request.spec.name,
        hash=request.spec.hash,
        profile=profile,
        params=request.params,
        results=tuple(records),
    )


def _requirement(monitored: Monitored) -> MonitoredKind:
    from s2r_spec.report.records.monitor import (
        FailedRequirement,
        MonitoredRequirement,
        Sampling,
        UnknownRequirement,
    )

    sampling = None if monitored.sampled is None else Sampling(**vars(monitored.sampled))
    if monitored.reason is None:
        assert sampling is not None
        return extend(UnknownRequirement, sampling, requirement=monitored.requirement, text=monitored.text)
    verdict = Verdict.of(monitored.satisfied).value
    if sampling is None:
        return extend(FailedRequirement, monitored.reason, verdict=verdict, text=monitored.text)
    return extend(
        MonitoredRequirement, monitored.reason, verdict=verdict, text=monitored.text, **vars(sampling)
    )


def change_record(spec: Spec, change: VerdictChange) -> ChangeObject:
    """Return the record of a change."""
    from s2r_spec.report.records.monitor import ChangeObject

    of = _interval(spec, change.requirement, change.interval)
    return extend(ChangeObject, of, time=change.times[-1])


def online_record(spec: Spec, params: dict[str, float], ended: Sequence[Ended]) -> OnlineObject:
    """Return the record of the end of a stream, with the exit code."""
    from s2r_spec.report.records.monitor import OnlineObject

    return OnlineObject(
        exit_code=worst(Verdict.of(one.interval.satisfied) for one in ended).exit_code,
        spec=spec.name,
        hash=spec.hash,
        params=dict(params),
        requirements=tuple(_interval(spec, one.requirement, one.interval) for one in ended),
    )


def _interval(spec: Spec, name: str, interval: RobustInterval) -> RequirementInterval:
    from s2r_spec.report.records.monitor import RequirementInterval

    verdict = interval.verdict
    return extend(RequirementInterval, interval, requirement=name, unit=spec.unit(name), verdict=verdict)
