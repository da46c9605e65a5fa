"""``s2r monitor --online``: the range of possible ρ, sample by sample."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from s2r_spec.cli.common import note
from s2r_spec.cli.reading import Request, named, parameters, read
from s2r_spec.cli.terminal import print_verdict
from s2r_spec.json_values import line
from s2r_spec.printable import one_line
from s2r_spec.verdict import Verdict, worst

if TYPE_CHECKING:
    from s2r_spec.json_objects.monitor import ChangeObject, OnlineObject, RequirementInterval
    from s2r_spec.lang.conversion import Conversion
    from s2r_spec.robustness.online.monitor import RobustInterval
    from s2r_spec.spec import Spec

Sample = tuple[float, Mapping[str, Any]]


@dataclass(frozen=True)
class Settings:
    """Settings of the online monitor.

    Args:
        period: sample period [s]; None to take it from a file, if it has one.
        ranges: whether signals stay in their declared ranges.
        partial: whether a trace that ends too early is evaluated on its samples.
        as_json: whether to print JSON.
    """

    period: float | None
    ranges: bool
    partial: bool
    as_json: bool


@dataclass(frozen=True)
class _Input:
    """A stream of samples, in the units of the input.

    Args:
        units: channel → unit.
        meta: the metadata of the trace; see :class:`s2r_spec.trace.Trace`.
        samples: (time [s], channel → sample).
        period: sample period [s] if the samples are known to lie on a regular grid, else None.
        params: parameter → value: from the command line, else from the trace.
        notes: a sentence on each thing left out so far; the list grows while samples are read.
    """

    units: Mapping[str, str]
    meta: Mapping[str, Any]
    samples: Iterator[Sample]
    period: float | None
    params: dict[str, float]
    notes: Sequence[str] = ()


def follow(request: Request, source: Path, settings: Settings) -> int:
    """Follow a file, or standard input if it is ``-``, to its end; return the exit code.

    Prints a line whenever an interval or a verdict changes, and the result at the end.
    """
    if str(source) == "-":
        return _follow(request, _rows(request), settings)
    samples = _file(request, source)
    with named(source):
        return _follow(request, samples, settings)


def _follow(request: Request, source: _Input, settings: Settings) -> int:
    spec = request.spec
    period = source.period if settings.period is None else settings.period
    monitors = {
        name: spec.monitor(
            source.params,
            name,
            period=period,
            ranges=settings.ranges,
            nan=request.nan,
            sparse=request.excerpts.time_unit is not None,
        )
        for name in request.requirements
    }
    scales = _scales(spec, request.requirements, source.units)
    shown: dict[str, RobustInterval] = {}
    latest: dict[str, RobustInterval] = {}
    recent: list[float] = []  # the first time and the last two, which set the precision of printed times
    for last, sample in source.samples:
        recent = [*recent[:1], *recent[-1:], last]
        for name, monitor in monitors.items():
            (interval,) = monitor.update(last, _converted(sample, scales)).values()
            latest[name] = interval
            if interval != shown.get(name) and (name in shown or interval.bounded):
                shown[name] = interval
                _changed(spec, name, recent, interval, settings.as_json)
    ended: dict[str, RobustInterval] = {}
    for name, monitor in monitors.items():
        failure = _fallen(spec, name, source.meta)
        ended |= {name: failure} if failure else monitor.finish(partial=settings.partial)
        if settings.partial and math.isinf(ended[name].lower) and ended[name].decided and name in latest:
            ended[name] = latest[name]  # windows that the trace cuts to nothing decide nothing
    for sentence in source.notes:
        note(sentence)
    shortfalls = {
        name: monitors[name].shortfall(name) for name, one in ended.items() if one.satisfied is None
    }
    return _print_end(spec, source.params, settings, ended, shortfalls)


def _rows(request: Request) -> _Input:
    """Read a table from standard input row by row."""
    from s2r_spec.errors import UsageError
    from s2r_spec.logs.follow import follow as rows_of
    from s2r_spec.logs.interpret import request as columns_to_read
    from s2r_spec.rollouts.excerpts import no_units

    excerpts = request.excerpts
    if excerpts.cuts or excerpts.sources or excerpts.joining is not None:
        raise UsageError(
            "rows from stdin are one whole trace: leave out --when, --start, --duration, --join, --clock, --stamps, "
            "and parameters from a column"
        )
    if hasattr(sys.stdin, "reconfigure"):
        sys.stdin.reconfigure(errors="replace")  # other columns may hold bytes that are not text
    rows = rows_of(
        sys.stdin.readline,
        columns_to_read(excerpts.columns, request.wanted, excerpts.time_unit),
    )
    rows.notes.extend(no_units(request.spec.signals, rows.units, excerpts.columns))
    params, _ = parameters(request, rows.meta, "the trace")
    return _Input(rows.units, rows.meta, rows.samples, None, params, rows.notes)


def _file(request: Request, path: Path) -> _Input:
    """Read a recorded trace, and yield it sample by sample."""
    from s2r_spec.errors import UsageError
    from s2r_spec.robustness.grid import Grid
    from s2r_spec.robustness.silence import silences_of

    recorded, *more = read(request, path)
    if more:
        raise UsageError("--online follows one episode; cut one by --start and --duration")
    trace = recorded.trace
    if trace.messages or trace.origin is not None:
        raise UsageError(
            "--online follows one list of samples, and this log has several topics: leave it out"
        )
    if silences_of(trace.times):
        raise UsageError("--online follows samples, and these have a gap of over five periods: leave it out")
    grid = Grid.of(trace.times)
    samples = (
        (float(time), {name: channel[k] for name, channel in trace.channels.items()})
        for k, time in enumerate(trace.times)
    )
    regular = grid is not None and grid.period is not None
    period = grid.seconds(1) if grid and regular else None
    return _Input(trace.units, trace.meta, samples, period, recorded.params)


def _scales(spec: Spec, requirements: Iterable[str], units: Mapping[str, str]) -> dict[str, Conversion]:
    """Return channel → conversion of a sample of the input to the declared unit."""
    from s2r_spec.robustness.reading import conversion

    names = {name for requirement in requirements for name in spec.channels(requirement)}
    found = {name: conversion(spec.signals[name], units.get(name)) for name in names}
    return {name: scale for name, scale in found.items() if not scale.same}


def _converted(sample: Mapping[str, Any], scales: Mapping[str, Conversion]) -> Mapping[str, Any]:
    if not scales:
        return sample
    found = dict(sample)
    for name, scale in scales.items():
        if name in found:
            value = found[name]
            vector = hasattr(value, "__len__")
            found[name] = [scale(x) for x in value] if vector else scale(value)
    return found


def _fallen(spec: Spec, requirement: str, meta: Mapping[str, Any]) -> RobustInterval | None:
    """Return the declared ρ of a failure if the trace ended in one, else None."""
    import numpy as np

    from s2r_spec.robustness.online.monitor import RobustInterval
    from s2r_spec.trace import Trace

    trace = Trace(np.zeros(1), {}, meta=meta)
    if trace.failure is None:
        return None
    rho = spec.robustness(trace, only=requirement)[requirement]
    return RobustInterval(rho, rho, satisfied=rho > 0)


def _record(spec: Spec, name: str, interval: RobustInterval) -> RequirementInterval:
    """Return the record of a requirement's interval."""
    from s2r_spec.json_objects.monitor import RequirementInterval
    from s2r_spec.json_values import extended

    unit, verdict = spec.unit(name), interval.verdict
    return extended(RequirementInterval, interval, requirement=name, unit=unit, verdict=verdict)


def _changed(spec: Spec, name: str, recent: Sequence[float], interval: RobustInterval, as_json: bool) -> None:
    time = recent[-1]
    if as_json:
        from s2r_spec.json_objects.monitor import ChangeObject
        from s2r_spec.json_values import extended

        _print_json(extended(ChangeObject, _record(spec, name, interval), time=time))
    else:
        from s2r_spec.instants import instant

        when = instant(recent, time)
        _write(f"t = {when}  {name} {interval.verdict}: {_words(interval, spec.unit(name))}", interval)


def _print_end(
    spec: Spec,
    params: Mapping[str, float],
    settings: Settings,
    ended: Mapping[str, RobustInterval],
    shortfalls: Mapping[str, str],
) -> int:
    code = worst(Verdict.of(interval.satisfied) for interval in ended.values()).exit_code
    if settings.as_json:
        from s2r_spec.json_objects.monitor import OnlineObject

        results = tuple(_record(spec, name, one) for name, one in ended.items())
        _print_json(
            OnlineObject(
                exit_code=code, spec=spec.name, hash=spec.hash, params=dict(params), requirements=results
            )
        )
    else:
        for name, interval in ended.items():
            more = f" ({shortfalls[name]})" if name in shortfalls else ""
            _write(f"{name} {interval.verdict}: {_words(interval, spec.unit(name))}{more}", interval)
    return code


def _words(interval: RobustInterval, unit: str) -> str:
    if interval.decided:
        return f"ρ = {interval.lower:+.6g} {unit}".rstrip()
    return f"ρ in [{interval.lower:+.6g}, {interval.upper:+.6g}] {unit}".rstrip()


def _print_json(record: ChangeObject | OnlineObject) -> None:
    print(line(record, infinite=True), flush=True)


def _write(line: str, interval: RobustInterval) -> None:
    print_verdict(one_line(line), Verdict.of(interval.satisfied))
