"""The results of ``s2r monitor`` as records: of recorded traces, and of one trace while it is recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from s2r_spec.base.json_values import extend
from s2r_spec.base.verdict import Verdict, worst
from s2r_spec.recordings.spec_traces import TraceRequest, in_file, read_spec_traces
from s2r_spec.report.records.monitor import (
    ChangeObject,
    FailedRequirement,
    MonitoredKind,
    MonitoredRequirement,
    MonitoredTrace,
    MonitorObject,
    OnlineObject,
    RequirementInterval,
    Sampling,
    UnknownRequirement,
    UnreadTrace,
)
from s2r_spec.spec import Spec
from s2r_spec.spec.monitored import Conventions, Monitored, monitor_trace

if TYPE_CHECKING:
    from s2r_spec.robustness.online.monitor import RobustInterval
    from s2r_spec.spec.followed import Ended, VerdictChange


def monitor_file(request: TraceRequest, path: Path, conventions: Conventions) -> list[MonitoredTrace]:
    """Return the results of one file, one for each episode; an error names the file."""
    results = []
    for one in read_spec_traces(request, path):
        how = replace(conventions, stated=one.stated)
        with in_file(path):
            monitored = monitor_trace(request.spec, one.trace, request.requirements, one.params, how)
        results.append(
            MonitoredTrace(
                trace=one.name,
                params=one.params,
                from_trace=tuple(sorted(one.taken)),
                notes=one.notes,
                accounts=one.accounts,
                requirements=tuple(map(_requirement, monitored)),
            )
        )
    return results


def monitor_record(
    request: TraceRequest, results: Sequence[MonitoredTrace | UnreadTrace], profile: str
) -> MonitorObject:
    """Return the record of all files, with the exit code."""
    verdicts = [Verdict.of(one.satisfied) for result in results for one in result.requirements]
    broken = any(isinstance(result, UnreadTrace) for result in results)
    return MonitorObject(
        exit_code=2 if broken else worst(verdicts).exit_code,
        spec=request.spec.name,
        hash=request.spec.hash,
        profile=profile,
        params=request.params,
        results=tuple(results),
    )


def _requirement(monitored: Monitored) -> MonitoredKind:
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
    of = _interval(spec, change.requirement, change.interval)
    return extend(ChangeObject, of, time=change.times[-1])


def online_record(spec: Spec, params: dict[str, float], ended: Sequence[Ended]) -> OnlineObject:
    """Return the record of the end of a stream, with the exit code."""
    return OnlineObject(
        exit_code=worst(Verdict.of(one.interval.satisfied) for one in ended).exit_code,
        spec=spec.name,
        hash=spec.hash,
        params=dict(params),
        requirements=tuple(_interval(spec, one.requirement, one.interval) for one in ended),
    )


def _interval(spec: Spec, name: str, interval: RobustInterval) -> RequirementInterval:
    verdict = interval.verdict
    return extend(RequirementInterval, interval, requirement=name, unit=spec.unit(name), verdict=verdict)
