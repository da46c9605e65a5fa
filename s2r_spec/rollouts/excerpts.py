"""Traces of tests from a long log: its topics joined, its episodes cut, its test parameters read from its channels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from s2r_spec import logs
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.logs.episodes import Cut, cut, part
from s2r_spec.logs.times import TIME
from s2r_spec.logs.topics.join import Joining
from s2r_spec.spec import Spec, parse_spec
from s2r_spec.trace import Trace

_CONDITION = "when"


@dataclass(frozen=True)
class Source:
    """The value of a test parameter in a log: that of a column, at a time after the episode's start.

    Args:
        column: name of the column.
        at: time [s]; the last sample up to it counts.
    """

    column: str
    at: float


def read_sources(texts: Iterable[str]) -> tuple[list[str], dict[str, Source]]:
    """Return the texts that state a value, and parameter → source of those such as ``vd=/cmd_vel.linear.x@0``.

    Raises:
        UsageError: the text after the @ is not a time in seconds.
    """
    stated: list[str] = []
    sources: dict[str, Source] = {}
    for text in texts:
        name, _, value = text.partition("=")
        column, mark, at = value.rpartition("@")
        if not mark:
            stated.append(text)
            continue
        try:
            seconds = float(at.strip().removesuffix("s"))
        except ValueError:
            seconds = math.nan
        if not 0.0 <= seconds < math.inf:
            raise UsageError(
                f"{text}: {at!r} is not a time after the start in seconds; write {name}={column}@0"
            )
        sources[name.strip()] = Source(column.strip(), seconds)
    return stated, sources


@dataclass(frozen=True)
class Excerpts:
    """How a log becomes traces.

    Args:
        columns: signal, other name for ``when``, or ``t`` → name of its column.
        time_unit: unit of times that are plain numbers; None if not stated.
        joining: how topics come to common stamps; None for the defaults.
        when: condition that begins an episode as it becomes true; None for one episode.
        start: time of the log from which episodes may begin [s]; None for its begin.
        duration: length of an episode [s]; None for the horizon of the requirements.
        sources: test parameter → its source in the log.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    time_unit: str | None = None
    joining: Joining | None = None
    when: str | None = None
    start: float | None = None
    duration: float | None = None
    sources: Mapping[str, Source] = field(default_factory=dict)

    @property
    def cuts(self) -> bool:
        """Whether a trace is a part of the log."""
        return not (self.when is None and self.start is None and self.duration is None)


@dataclass(frozen=True)
class Episode:
    """A trace from a log.

    Args:
        name: the file, with the number of the episode if there can be several.
        trace: the trace, with times from 0 on if it was cut.
        params: test parameter → value from the log, in the declared unit.
        begins: time of its start from the log's first sample [s]; None if nothing was cut.
    """

    name: str
    trace: Trace
    params: Mapping[str, float]
    begins: float | None = None


@dataclass(frozen=True)
class Excerpt:
    """The episodes of a file, and notes for the user."""

    episodes: tuple[Episode, ...]
    notes: tuple[str, ...]
    dated: str = ""


def excerpt(
    path: Path, spec: Spec, wanted: Mapping[str, int | None], horizon: float, excerpts: Excerpts
) -> Excerpt:
    """Return the traces of a file.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        spec: declares the signals.
        wanted: signal → None for a number, else its width.
        horizon: duration that the requirements need [s]; inf if they need the whole rest.
        excerpts: how they are read.

    Raises:
        TraceError: the file cannot be read, or has no episode.
        SpecError: the condition is not valid.
        UsageError: the length of an episode is not known.
    """
    others = {name: None for name in excerpts.columns if name != TIME and name not in spec.signals}
    read = {source.column: None for source in excerpts.sources.values()}
    loaded = logs.load(
        path,
        excerpts.columns,
        {**wanted, **others, **read},
        time_unit=excerpts.time_unit,
        joining=excerpts.joining,
    )
    if not excerpts.cuts:
        return Excerpt(
            (_episode(str(path), loaded.trace, wanted, spec, excerpts),), loaded.notes, loaded.begins
        )
    duration = horizon if excerpts.duration is None else excerpts.duration
    if math.isinf(duration):
        raise UsageError(
            "the requirement looks at the whole rest of a trace; state the length of an episode by --duration"
        )
    trace = loaded.trace
    if excerpts.when is None:
        found, notes = _one(trace, excerpts.start or 0.0, duration), []
    else:
        found = _cut(trace, spec, others, excerpts, duration)
        notes = found.notes(excerpts.when)
    if not found.spans:
        raise TraceError(f"{path}: no complete episode: {'; '.join(notes) or 'the log is too short'}")
    episodes = tuple(
        _episode(
            f"{path}#{number}",
            part(trace, *span),
            wanted,
            spec,
            excerpts,
            float(trace.times[span[0]] - trace.times[0]),
        )
        for number, span in enumerate(found.spans, 1)
    )
    return Excerpt(episodes, (*loaded.notes, *notes), loaded.begins)


def _one(trace: Trace, start: float, duration: float) -> Cut:
    """Return the one episode from a time on."""
    times = trace.times - trace.times[0]
    begin = int(np.searchsorted(times, start * (1.0 - 1e-9)))
    period = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    end = int(np.searchsorted(times, start + duration + 0.5 * period))
    complete = begin < len(times) and times[-1] >= start + duration - 0.5 * period
    return Cut(((begin, end),) if complete else (), False, 0, int(not complete))


def _cut(trace: Trace, spec: Spec, others: Iterable[str], excerpts: Excerpts, duration: float) -> Cut:
    """Return the episodes that begin where the condition becomes true."""
    assert excerpts.when is not None
    condition = _condition(trace, spec, others, excerpts.when)
    signals = condition.channels(_CONDITION)
    found = condition.evaluate(trace.only(signals), _CONDITION)
    earliest = float(trace.times[0]) + (excerpts.start or 0.0)
    return cut(trace.times, found.truth & found.complete, duration, earliest)


def _condition(trace: Trace, spec: Spec, others: Iterable[str], text: str) -> Spec:
    lines = [f"signal {name}{_shape(spec, name)}" for name in trace.channels if name in spec.signals]
    lines += [f"signal {name}{_braced(trace.units.get(name, ''))}" for name in others]
    return parse_spec("\n".join([*lines, f"require {_CONDITION}: {text}"]), "--when")


def _shape(spec: Spec, name: str) -> str:
    signal = spec.signals[name]
    if signal.boolean:
        return " bool"
    return f"[{signal.dim}]" * signal.vector + _braced(signal.unit)


def _braced(unit: str) -> str:
    return f" {{{unit}}}" if unit else ""


def _episode(
    name: str,
    trace: Trace,
    wanted: Iterable[str],
    spec: Spec,
    excerpts: Excerpts,
    begins: float | None = None,
) -> Episode:
    params: dict[str, float] = {}
    for parameter, source in excerpts.sources.items():
        at = int(np.searchsorted(trace.times - trace.times[0], source.at * (1.0 + 1e-9), side="right")) - 1
        value = float(trace[source.column][max(at, 0)])
        if not math.isfinite(value):
            raise TraceError(f"{name}: the parameter {parameter} is {value}, from {source.column}")
        unit = trace.units.get(source.column, "")
        params |= spec.read_params([f"{parameter}={value!r} {unit}".rstrip()])
    return Episode(name, trace.only(wanted), params, begins)
