"""The verdict on requirements of a trace while it is recorded: the range of possible ρ, sample by sample."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from s2r_spec.lang.conversion import Conversion
from s2r_spec.robustness.online.monitor import RobustInterval
from s2r_spec.robustness.reading import Missing, conversion
from s2r_spec.spec.evaluated import Spec
from s2r_spec.trace import Trace

Sample = tuple[float, Mapping[str, Any]]


@dataclass(frozen=True)
class SampleStream:
    """A stream of samples, in the units of the input.

    Args:
        units: channel → unit.
        meta: the metadata of the trace; see :class:`s2r_spec.trace.Trace`.
        samples: (time [s], channel → sample).
        period: sample period [s] if the samples are known to lie on a regular grid, else None.
        params: parameter → value.
        notes: a sentence on each thing left out so far; the list grows while samples are read.
    """

    units: Mapping[str, str]
    meta: Mapping[str, Any]
    samples: Iterator[Sample]
    period: float | None
    params: dict[str, float]
    notes: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class OnlineConventions:
    """How requirements are evaluated on a stream: see :meth:`s2r_spec.spec.Spec.monitor`.

    Args:
        period: sample period [s]; None to take it from the stream, if it has one.
        partial: whether a trace that ends too early is evaluated on its samples.
    """

    period: float | None = None
    ranges: bool = True
    partial: bool = False
    nan: Missing = "error"
    sparse: bool = False


@dataclass(frozen=True)
class VerdictChange:
    """A requirement's interval or verdict has changed.

    ``times``: the first time, the last but one and the last [s]; fewer at the begin.
    """

    requirement: str
    interval: RobustInterval
    times: tuple[float, ...]


@dataclass(frozen=True)
class Ended:
    """The result of a requirement at the end of the stream.

    ``shortfall``: what the stream lacks, where the verdict is unknown; else "".
    """

    requirement: str
    interval: RobustInterval
    shortfall: str


def follow(
    spec: Spec, requirements: Sequence[str], stream: SampleStream, conventions: OnlineConventions
) -> Iterator[VerdictChange | Ended]:
    """Yield each change of an interval or a verdict as its sample is read, and the results at the end.

    Raises:
        TraceError: a sample does not fit, as for :meth:`s2r_spec.spec.Spec.monitor`.
    """
    monitors = {
        name: spec.monitor(
            stream.params,
            name,
            period=stream.period if conventions.period is None else conventions.period,
            ranges=conventions.ranges,
            nan=conventions.nan,
            sparse=conventions.sparse,
        )
        for name in requirements
    }
    scales = _scales(spec, requirements, stream.units)
    shown: dict[str, RobustInterval] = {}
    latest: dict[str, RobustInterval] = {}
    recent: tuple[float, ...] = ()
    for last, sample in stream.samples:
        recent = (*recent[:1], *recent[-1:], last)
        for name, monitor in monitors.items():
            (interval,) = monitor.update(last, _convert(sample, scales)).values()
            latest[name] = interval
            if interval != shown.get(name) and (name in shown or interval.bounded):
                shown[name] = interval
                yield VerdictChange(name, interval, recent)
    ended: dict[str, RobustInterval] = {}
    for name, monitor in monitors.items():
        failure = _failure_interval(spec, name, stream.meta)
        ended |= {name: failure} if failure else monitor.finish(partial=conventions.partial)
        if conventions.partial and math.isinf(ended[name].lower) and ended[name].decided and name in latest:
            ended[name] = latest[name]  # windows that the trace cuts to nothing decide nothing
    for name, interval in ended.items():
        short = "" if interval.satisfied is not None else monitors[name].shortfall(name)
        yield Ended(name, interval, short)


def _scales(spec: Spec, requirements: Iterable[str], units: Mapping[str, str]) -> dict[str, Conversion]:
    """Return channel → conversion of a sample of the input to the declared unit."""
    names = {name for requirement in requirements for name in spec.channels(requirement)}
    scales = {name: conversion(spec.signals[name], units.get(name)) for name in names}
    return {name: scale for name, scale in scales.items() if not scale.same}


def _convert(sample: Mapping[str, Any], scales: Mapping[str, Conversion]) -> Mapping[str, Any]:
    if not scales:
        return sample
    values = dict(sample)
    for name, scale in scales.items():
        if name in values:
            value = values[name]
            vector = hasattr(value, "__len__")
            values[name] = [scale(x) for x in value] if vector else scale(value)
    return values


def _failure_interval(spec: Spec, requirement: str, meta: Mapping[str, Any]) -> RobustInterval | None:
    """Return the declared ρ of a failure if the trace ended in one, else None."""
    trace = Trace(np.zeros(1), {}, meta=meta)
    if trace.failure is None:
        return None
    rho = spec.robustness(trace, only=requirement)[requirement]
    return RobustInterval(rho, rho, satisfied=rho > 0)
