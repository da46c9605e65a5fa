"""Traces of tests from a long log: its topics joined, its episodes cut, its test parameters read from its channels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from s2r_spec import logs
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.lang.declarations import Signal
from s2r_spec.logs.episodes import Cut, cut, part
from s2r_spec.logs.mapping import ANY
from s2r_spec.logs.times import TIME
from s2r_spec.logs.topics.formats import opener
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
        values: test parameter → its value in the log, and the unit of its column ("" if none is written).
        begins: time of its start from the log's first sample [s]; None if nothing was cut.
    """

    name: str
    trace: Trace
    values: Mapping[str, tuple[float, str]]
    begins: float | None = None

    def texts(self) -> list[str]:
        """Return the parameters as ``--param`` takes them, such as ``vd=0.3 m/s``."""
        return [f"{name}={value!r} {unit}".rstrip() for name, (value, unit) in self.values.items()]


@dataclass(frozen=True)
class Excerpt:
    """The episodes of a file, notes for the user, the date from which times count, and how the episodes were cut."""

    episodes: tuple[Episode, ...]
    notes: tuple[str, ...]
    dated: str = ""
    cut: tuple[str, ...] = ()


def excerpt(
    path: Path,
    signals: Mapping[str, Signal],
    wanted: Mapping[str, int | None] | None,
    horizon: float,
    excerpts: Excerpts,
) -> Excerpt:
    """Return the traces of a file.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        signals: the declared signals, for the units in the condition.
        wanted: signal → None for a number, else its width; None for all that the file has.
        horizon: duration that the requirements need [s]; inf if they need the whole rest.
        excerpts: how they are read.

    Raises:
        TraceError: the file cannot be read, or has no episode.
        SpecError: the condition is not valid.
        UsageError: the length of an episode is not known.
    """
    sources = {source.column for source in excerpts.sources.values()}
    loaded = logs.load(
        path,
        excerpts.columns,
        _read(path, signals, wanted, excerpts),
        time_unit=excerpts.time_unit,
        joining=excerpts.joining,
    )
    trace = loaded.trace
    kept = (
        tuple(wanted) if wanted is not None else tuple(name for name in trace.channels if name not in sources)
    )
    if not excerpts.cuts:
        episode = Episode(str(path), trace.only(kept), _values(str(path), trace, excerpts))
        return Excerpt((episode,), loaded.notes, loaded.begins)
    duration = horizon if excerpts.duration is None else excerpts.duration
    if math.isinf(duration):
        raise UsageError(
            "the requirement looks at the whole rest of a trace; state the length of an episode by --duration"
        )
    found, notes = _cut(trace, signals, excerpts, duration)
    if not found.spans:
        raise TraceError(f"{path}: no complete episode: {'; '.join(notes) or 'the log is too short'}")
    episodes = []
    for number, (first, end) in enumerate(found.spans, 1):
        name = f"{path}#{number}"
        one = part(trace, first, end)
        begins = float(trace.times[first] - trace.times[0])
        episodes.append(Episode(name, one.only(kept), _values(name, one, excerpts), begins))
    return Excerpt(tuple(episodes), (*loaded.notes, *notes), loaded.begins, tuple(notes))


def _read(
    path: Path, signals: Mapping[str, Signal], wanted: Mapping[str, int | None] | None, excerpts: Excerpts
) -> dict[str, int | None] | None:
    """Return the channels to read: of a log of topics only those that somebody names; None for all of a table."""
    if wanted is None and opener(path) is None:
        return None
    mapped: dict[str, int | None] = {
        name: ANY for name in excerpts.columns if name != TIME and name not in signals
    }
    return {**(wanted or {}), **mapped, **{source.column: ANY for source in excerpts.sources.values()}}


def _cut(
    trace: Trace, signals: Mapping[str, Signal], excerpts: Excerpts, duration: float
) -> tuple[Cut, list[str]]:
    """Return the episodes of a log, and sentences on how they were cut."""
    start = excerpts.start or 0.0
    if excerpts.when is None:
        return _one(trace, start, duration), []
    condition = _condition(trace, signals, excerpts.when)
    found = condition.evaluate(trace.only(condition.channels(_CONDITION)), _CONDITION)
    episodes = cut(trace.times, found.truth & found.complete, duration, float(trace.times[0]) + start)
    return episodes, episodes.notes(excerpts.when)


def _one(trace: Trace, start: float, duration: float) -> Cut:
    """Return the one episode from a time on."""
    times = trace.times - trace.times[0]
    begin = int(np.searchsorted(times, start * (1.0 - 1e-9)))
    period = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    end = int(np.searchsorted(times, start + duration + 0.5 * period))
    complete = begin < len(times) and times[-1] >= start + duration - 0.5 * period
    return Cut(((begin, end),) if complete else (), False, 0, int(not complete))


def _condition(trace: Trace, signals: Mapping[str, Signal], text: str) -> Spec:
    """Return a specification of the condition, which may name every channel that was read."""
    lines = [
        f"signal {name}{_shape(trace, signals.get(name), name)}"
        for name in trace.channels
        if name.isidentifier()
    ]
    return parse_spec("\n".join([*lines, f"require {_CONDITION}: {text}"]), "--when")


def _shape(trace: Trace, signal: Signal | None, name: str) -> str:
    """Return the declaration of a channel after its name: as the specification has it, else as the log has it."""
    if signal is not None and signal.boolean:
        return " bool"
    width = "" if trace[name].ndim == 1 else f"[{trace[name].shape[1]}]"
    unit = trace.units.get(name, "") if signal is None else signal.unit
    return width + (f" {{{unit}}}" if unit else "")


def _values(name: str, trace: Trace, excerpts: Excerpts) -> dict[str, tuple[float, str]]:
    """Return the test parameters that the log holds; a trace's times begin with its episode.

    Raises:
        TraceError: a value is not a finite number.
    """
    values: dict[str, tuple[float, str]] = {}
    for parameter, source in excerpts.sources.items():
        samples = trace[source.column]
        if samples.ndim != 1:
            raise TraceError(
                f"{name}: the parameter {parameter} is a vector, from {source.column}; name a component"
            )
        at = int(np.searchsorted(trace.times - trace.times[0], source.at * (1.0 + 1e-9), side="right")) - 1
        value = float(samples[max(at, 0)])
        if not math.isfinite(value):
            raise TraceError(f"{name}: the parameter {parameter} is {value}, from {source.column}")
        values[parameter] = (value, trace.units.get(source.column, ""))
    return values
