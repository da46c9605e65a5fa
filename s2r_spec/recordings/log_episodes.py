"""Traces of tests from a long log: its topics joined, its episodes cut, its test parameters read from its channels."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from s2r_spec import logs
from s2r_spec.base.errors import TraceError, TraceNote, UsageError
from s2r_spec.lang.declarations import Signal
from s2r_spec.lang.lexing import names
from s2r_spec.logs.account import Account
from s2r_spec.logs.interpret import Loaded
from s2r_spec.logs.mapping import ANY
from s2r_spec.logs.times.time_units import split_brackets
from s2r_spec.logs.topics.formats import opener
from s2r_spec.logs.topics.join import Joining
from s2r_spec.recordings.episodes import EpisodeWindow, equal_windows, find_windows, take_episode
from s2r_spec.recordings.log_units import assumptions, no_units, refuse_unit_in_name
from s2r_spec.robustness.stream import SignalMessages
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace
from s2r_spec.trace.messages import silences_of
from s2r_spec.trace.samples import period_of

PART_OF_LOG = "start"
"""Definition: test parameter of a part of a log that is cut into equal ones: the time of its begin in the log [s]."""


@dataclass(frozen=True)
class ParamColumn:
    """The value of a test parameter: that of a column ``at`` [s] after the episode's start, or of the sample before."""

    column: str
    at: float


def read_sources(texts: Iterable[str]) -> tuple[list[str], dict[str, ParamColumn]]:
    """Return the texts that state a value, and parameter → source of those such as ``vd=/cmd_vel.linear.x@0``.

    Raises:
        UsageError: the text after the @ is not a time in seconds, or a parameter has two sources.
    """
    stated: list[str] = []
    sources: dict[str, ParamColumn] = {}
    for text in texts:
        name, _, value = text.partition("=")
        column, mark, at = value.rpartition("@")
        if not mark:
            stated.append(text)
            continue
        seconds = _seconds(at)
        if not 0.0 <= seconds < math.inf:
            raise UsageError(
                f"{text}: {at!r} is not a time after the start in seconds; write {name}={column}@0"
            )
        source = ParamColumn(column.strip(), seconds)
        if sources.setdefault(name.strip(), source) != source:
            raise UsageError(f"{text}: the parameter {name.strip()} has another source, too; give one")
    return stated, sources


def read_longest(texts: Iterable[str]) -> dict[str, float]:
    """Return signal → time for which its value is valid [s], from texts like ``hit=2``.

    Raises:
        UsageError: a text is not of this form, or a signal has two times.
    """
    longest: dict[str, float] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        seconds = _seconds(value)
        if not name or not 0.0 < seconds < math.inf:
            raise UsageError(f"longest={text!r} is not a signal and seconds, such as --longest hit=2")
        if longest.setdefault(name, seconds) != seconds:
            raise UsageError(f"longest gives {name} twice, {longest[name]:g} s and {seconds:g} s; give one")
    return longest


def _seconds(text: str) -> float:
    try:
        return float(text.strip().removesuffix("s"))
    except ValueError:
        return math.nan


@dataclass(frozen=True)
class EpisodeSettings:
    """How a log becomes traces.

    Args:
        columns: signal, other name in ``when``, or ``t`` → name of its column.
        time_unit: unit of times that are plain numbers; None if not stated.
        joining: how topics come to common stamps; None for the defaults.
        when: condition that begins an episode as it becomes true; None for one episode.
        start: time of the log from which episodes may begin [s]; None for its begin.
        duration: length of an episode [s]; None for the horizon of the requirements.
        sources: test parameter → its source in the log.
        longest: signal → time for which a value is valid [s].
        every: length of equal parts of the log, each an episode; its begin in the log is its parameter ``start`` [s].
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    time_unit: str | None = None
    joining: Joining | None = None
    when: str | None = None
    start: float | None = None
    duration: float | None = None
    sources: Mapping[str, ParamColumn] = field(default_factory=dict)
    longest: Mapping[str, float] = field(default_factory=dict)
    every: float | None = None

    @property
    def cuts(self) -> bool:
        """Whether a trace is a part of the log."""
        return any(one is not None for one in (self.when, self.start, self.duration, self.every))

    @property
    def commands(self) -> frozenset[str]:
        """Channels and columns that the condition and the test parameters name."""
        channels = names(self.when or "")
        columns = [text for name, text in self.columns.items() if name.partition("[")[0] in channels]
        sources = [source.column for source in self.sources.values()]
        mapped = [self.columns[name] for name in sources if name in self.columns]
        return frozenset((*channels, *columns, *sources, *mapped))

    def hold_commands(self) -> Joining | None:
        """Return how topics are joined; commands are held, because nobody sends a value between two of them."""
        if self.joining is None:
            return None
        stems = {split[0] for name in self.commands if (split := split_brackets(name)) is not None}
        return replace(self.joining, held=self.commands | stems)


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
class LogEpisodes:
    """What a file gives.

    Args:
        episodes: its traces.
        notes: notes for the user.
        dated: the date from which times count; "" if they are unchanged.
        cut: how the episodes were cut, a sentence each.
        left_out: column that was not requested → why it is not in the traces.
        silences: a sentence on each signal that is silent in an episode.
        accounts: channel → what became of its messages in the file.
        stated: whether the file or the user states the unit of the times.
    """

    episodes: tuple[Episode, ...]
    notes: tuple[str, ...]
    dated: str = ""
    cut: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    silences: tuple[str, ...] = ()
    accounts: Mapping[str, Account] = field(default_factory=dict)
    stated: bool = True


def read_log_episodes(
    path: Path,
    signals: Mapping[str, Signal],
    wanted: Mapping[str, int | None] | None,
    horizon: float,
    settings: EpisodeSettings,
) -> LogEpisodes:
    """Return the traces of a file.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        signals: the declared signals, for the units in the condition.
        wanted: signal → None for a number, else its width; None for all that the file has.
        horizon: duration that the requirements need [s]; inf if they need the whole rest.
        settings: how they are read.

    Raises:
        TraceError: the file cannot be read, or has no episode.
        SpecError: the condition is not valid.
        UsageError: the length of an episode is not known.
    """
    sources = {source.column: source.column for source in settings.sources.values()}
    channels = None  # those of the condition and of the test parameters, too
    if wanted is not None:
        channels = {**dict.fromkeys((*names(settings.when or ""), *sources), ANY), **wanted}
    reading = logs.Reading(
        {**sources, **settings.columns},
        channels,
        settings.time_unit,
        wanted is None,
        settings.hold_commands(),
        settings.longest,
    )
    loads = logs.load_episodes(path, reading)
    windows: list[tuple[Loaded, EpisodeWindow | None]] = [(loaded, None) for loaded in loads]
    sentences: list[str] = []
    if settings.cuts:
        windows, sentences = _find_windows(path, loads, signals, settings, horizon)
    several = settings.cuts or len(windows) > 1
    of_topics = opener(path) is not None
    kept = tuple(loads[0].trace.channels if wanted is None else wanted)
    if wanted is None and of_topics:  # without those that were read for the test parameters alone
        kept = tuple(name for name in kept if name in settings.columns or name not in sources)
    episodes = []
    for number, (loaded, window) in enumerate(windows, 1):
        name = f"{path}#{number}" if several else str(path)
        trace = loaded.trace if window is None else take_episode(loaded.trace, window)
        begins = None if window is None else window.begin - loaded.trace.begin
        values = _values(name, trace, settings)
        if settings.every is not None and begins is not None:
            values |= {PART_OF_LOG: (begins, "s")}
        episodes.append(Episode(name, trace.only(kept), values, begins))
    notes = dict.fromkeys(note for loaded in loads for note in loaded.notes)
    measured = {name: signals[name] for name in kept if name in signals}
    units = episodes[0].trace.units
    refuse_unit_in_name(measured, units, settings.columns)
    assumed = no_units(measured, units, settings.columns)
    assumed += assumptions(measured, units, settings.columns) if of_topics else []
    silences = [
        sentence
        for one in episodes
        for sentence in _silences(one.trace, settings, f"in {one.name}, " if several else "")
    ]
    return LogEpisodes(
        tuple(episodes),
        (*notes, *assumed, *sentences),
        loads[0].begins,
        tuple(sentences),
        loads[0].left_out,
        tuple(silences),
        loads[0].accounts,
        all(loaded.stated for loaded in loads),
    )


def _find_windows(
    path: Path,
    loads: Sequence[Loaded],
    signals: Mapping[str, Signal],
    settings: EpisodeSettings,
    horizon: float,
) -> tuple[list[tuple[Loaded, EpisodeWindow | None]], list[str]]:
    """Return the windows of the episodes in a file, at least one, and how the log was split."""
    duration = settings.every or (horizon if settings.duration is None else settings.duration)
    if math.isinf(duration):
        raise UsageError("the length of an episode is not known; state it, such as --duration 2")
    windows: list[tuple[Loaded, EpisodeWindow | None]] = []
    sentences: list[str] = []
    for loaded in loads:
        try:
            if settings.every:
                found, notes = equal_windows(loaded.trace, settings.start or 0.0, settings.every)
            else:
                found, notes = find_windows(
                    loaded.trace, signals, settings.when, settings.start or 0.0, duration
                )
        except TraceError as error:
            raise TraceError(f"{path}: {error}") from None
        windows += [(loaded, window) for window in found]
        sentences += notes
    if not windows:
        raise TraceError(f"{path}: no complete episode: {'; '.join(dict.fromkeys(sentences))}")
    return windows, sentences


def _silences(trace: Trace, settings: EpisodeSettings, where: str) -> Iterator[str]:
    """Yield a sentence for each signal that is silent within an episode; commands are sent at will."""
    whole = trace if trace.origin is None else trace.origin
    start = whole.begin
    if not whole.messages:
        every = f"they come every {period_of(whole.times):.3g} s"
        yield from _longest_silence(f"{where}the file", silences_of(whole.times), every)
    for name, one in whole.messages.items():
        column = settings.columns.get(name, name)
        if column not in settings.commands and math.isfinite(one.bridged):
            until = whole.ends
            spans = SignalMessages(one, one.values).silences(start, until)
            inner = [(start + begin, min(start + end, until)) for begin, end in spans if math.isfinite(begin)]
            yield from _longest_silence(f"{where}{column}", inner, one.rhythm)


def _longest_silence(name: str, spans: Sequence[tuple[float, float]], rhythm: str) -> Iterator[str]:
    if spans:
        begin, end = max(spans, key=lambda span: span[1] - span[0])
        yield (
            f"{name} has no message from t = {begin:.6g} s to {end:.6g} s, though {rhythm}: nothing is known there"
        )


def _values(name: str, trace: Trace, settings: EpisodeSettings) -> dict[str, tuple[float, str]]:
    """Return the test parameters that the log holds; a trace's times begin with its episode."""
    values: dict[str, tuple[float, str]] = {}
    # the messages, rather than those at a clock's stamps
    trace = trace if trace.origin is None else trace.origin
    for parameter, source in settings.sources.items():
        samples = trace[source.column]
        if samples.ndim != 1:
            raise TraceError(
                f"{name}: the parameter {parameter} is a vector, from {source.column}; name a component"
            )
        times = trace.times - trace.times[0]
        period = period_of(times)
        if source.at > times[-1] + period:
            raise TraceError(
                f"{name}: the parameter {parameter} is wanted at {source.at:g} s, but the trace lasts "
                f"{times[-1]:.6g} s; state an earlier time or a longer --duration"
            )
        at = max(int(np.searchsorted(times, source.at * (1.0 + 1e-9), side="right")) - 1, 0)
        value = float(samples[at])
        if not math.isfinite(value):
            raise TraceError(f"{name}: the parameter {parameter} is {value}, from {source.column}")
        values[parameter] = (value, trace.units.get(source.column, ""))
    return values


def read_episodes(
    path: str | os.PathLike[str],
    spec: Spec,
    columns: Mapping[str, str] | None = None,
    *,
    when: str | None = None,
    duration: float | None = None,
    params: Mapping[str, str] | None = None,
    joining: Joining | None = None,
) -> list[tuple[dict[str, float], Trace]]:
    """Return (test, trace) of every episode of a log, as :func:`s2r_spec.diagnose` takes them.

    The reader warns (:class:`TraceNote`) of how topics were joined, how episodes were cut, and what was left out.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        spec: the specification; its signals are read.
        columns: signal, another name in ``when``, or ``t`` → name of its column or field.
        when: condition that begins an episode where it becomes true ("vx_cmd > 0.05"); None for one trace.
        duration: length of an episode [s]; None for as long as the requirements look ahead.
        params: test parameter → its field and time after the episode's start, such as "/cmd_vel.linear.x@0".
        joining: how topics come to common stamps; None for the defaults.

    Raises:
        TraceError: the file cannot be read, lacks a signal, or has no complete episode.
        SpecError: the condition is not valid.
        UsageError: the length of an episode is not known, or a value of ``params`` is not a field and a time.
    """
    stated, sources = read_sources(f"{name}={text}" for name, text in (params or {}).items())
    values = spec.read_params(stated)
    widths = {signal.name: signal.dim if signal.vector else None for signal in spec.signals.values()}
    reading = EpisodeSettings(columns or {}, None, joining, when, None, duration, sources)
    log = read_log_episodes(Path(path), spec.signals, widths, spec.horizon(), reading)
    for note in (*log.notes, *log.silences):
        warnings.warn(f"{path}: {note}", TraceNote, stacklevel=2)
    return [({**values, **spec.read_params(one.texts())}, one.trace) for one in log.episodes]
