"""Traces of tests from a long log: its topics joined, its episodes cut, its test parameters read from its channels."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from s2r_spec import logs
from s2r_spec.base.errors import TraceError, UsageError
from s2r_spec.lang.declarations import Signal
from s2r_spec.lang.lexing import names
from s2r_spec.lang.units import UnknownUnitError, parse_unit
from s2r_spec.logs.account import Account
from s2r_spec.logs.interpret import Loaded
from s2r_spec.logs.mapping import ANY
from s2r_spec.logs.times.time_units import split_brackets
from s2r_spec.logs.topics.formats import opener
from s2r_spec.logs.topics.join import Joining
from s2r_spec.recordings.episodes import EpisodeWindow, find_episodes, slack_of, take_episode
from s2r_spec.robustness.silence import silences_of
from s2r_spec.robustness.stream import SignalMessages
from s2r_spec.spec import Spec, parse_spec
from s2r_spec.trace import Trace
from s2r_spec.trace.samples import period_of

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
_CONDITION = "when"
_SI = {
    (unit.dimension, bool(unit.angle)): unit.text
    for unit in map(parse_unit, ("rad/s", "1/s", "m", "m/s", "m/s^2", "s", "K", "rad"))
}
"""Definition: (dimension, whether it is of an angle) → unit of SI that a sentence shows as an example."""


@dataclass(frozen=True)
class ParamColumn:
    """The value of a test parameter in a log: that of a column, at a time after the episode's start.

    Args:
        column: name of the column.
        at: time [s]; the last sample up to it counts.
    """

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
        try:
            seconds = float(at.strip().removesuffix("s"))
        except ValueError:
            seconds = math.nan
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
        try:
            seconds = float(value.removesuffix("s"))
        except ValueError:
            seconds = math.nan
        if not name or not 0.0 < seconds < math.inf:
            raise UsageError(f"longest={text!r} is not a signal and seconds, such as --longest hit=2")
        if longest.setdefault(name, seconds) != seconds:
            raise UsageError(f"longest gives {name} twice, {longest[name]:g} s and {seconds:g} s; give one")
    return longest


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
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    time_unit: str | None = None
    joining: Joining | None = None
    when: str | None = None
    start: float | None = None
    duration: float | None = None
    sources: Mapping[str, ParamColumn] = field(default_factory=dict)
    longest: Mapping[str, float] = field(default_factory=dict)

    @property
    def cuts(self) -> bool:
        """Whether a trace is a part of the log."""
        return not (self.when is None and self.start is None and self.duration is None)

    @property
    def commands(self) -> frozenset[str]:
        """Channels and columns that the condition and the test parameters name."""
        channels = names(self.when or "")
        columns = [text for name, text in self.columns.items() if name.partition("[")[0] in channels]
        sources = [source.column for source in self.sources.values()]
        mapped = [self.columns[name] for name in sources if name in self.columns]
        return frozenset((*channels, *columns, *sources, *mapped))

    def held(self) -> Joining | None:
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
    loads = logs.load_episodes(
        path,
        {**{source.column: source.column for source in settings.sources.values()}, **settings.columns},
        _channels_to_read(wanted, settings),
        time_unit=settings.time_unit,
        gather=wanted is None,
        joining=settings.held(),
        longest=settings.longest,
    )
    windows: list[tuple[Loaded, EpisodeWindow | None]] = [(loaded, None) for loaded in loads]
    sentences: list[str] = []
    if settings.cuts:
        windows, sentences = _file_windows(path, loads, signals, settings, horizon)
    kept = _kept_channels(path, loads[0].trace, wanted, settings)
    several = settings.cuts or len(windows) > 1
    episodes = tuple(
        _episode(f"{path}#{number}" if several else str(path), loaded.trace, window, kept, settings)
        for number, (loaded, window) in enumerate(windows, 1)
    )
    notes = dict.fromkeys(note for loaded in loads for note in loaded.notes)
    measured = {name: signals[name] for name in kept if name in signals}
    refuse_unit_in_name(measured, episodes[0].trace.units, settings.columns)
    assumed = no_units(measured, episodes[0].trace.units, settings.columns)
    assumed += [] if opener(path) is None else _assumptions(measured, episodes[0], settings)
    silences = [
        sentence
        for one in episodes
        for sentence in _silences(one.trace, settings, f"in {one.name}, " if several else "")
    ]
    return LogEpisodes(
        episodes,
        (*notes, *assumed, *sentences),
        loads[0].begins,
        tuple(sentences),
        loads[0].left_out,
        tuple(silences),
        loads[0].accounts,
        all(loaded.stated for loaded in loads),
    )


def _file_windows(
    path: Path,
    loads: Sequence[Loaded],
    signals: Mapping[str, Signal],
    settings: EpisodeSettings,
    horizon: float,
) -> tuple[list[tuple[Loaded, EpisodeWindow | None]], list[str]]:
    """Return the windows of the episodes in a file, at least one, and how the log was split."""
    try:
        windows, sentences = _load_windows(loads, signals, settings, horizon)
    except TraceError as error:
        raise TraceError(f"{path}: {error}") from None
    if not windows:
        raise TraceError(f"{path}: no complete episode: {'; '.join(dict.fromkeys(sentences))}")
    return windows, sentences


def no_units(
    signals: Mapping[str, Signal], units: Mapping[str, str], columns: Mapping[str, str]
) -> list[str]:
    """Return a sentence for each column with a text in brackets that is no unit, where the signal has one.

    Args:
        signals: the signals that are read.
        units: signal → unit in the log.
        columns: signal or component → name of its column.
    """
    mapped = [(key.partition("[")[0], column) for key, column in columns.items()]
    return [
        f"{column!r} is read in {signals[name].unit}, because {split[1]!r} is not a unit; if that is wrong, state "
        f"its unit, such as --map '{name}={column} [{signals[name].unit}]'"
        for name, column in mapped
        if name in signals and signals[name].unit and name not in units
        if (split := split_brackets(column)) is not None and not split[1].isdigit()
    ]


def refuse_unit_in_name(
    signals: Mapping[str, Signal], units: Mapping[str, str], columns: Mapping[str, str]
) -> None:
    """Refuse a column without a unit whose name ends in another unit of the signal's quantity: ``pitch_deg`` for rad.

    Raises:
        TraceError: there is one.
    """
    for name, signal in signals.items():
        column = columns.get(name, name)
        word = re.split(r"[^0-9A-Za-z°µ%]+", column)[-1]
        if units.get(name) or not signal.unit or word in (column, name, ""):
            continue
        try:
            written = parse_unit(word)
        except UnknownUnitError:
            continue
        measured = signal.measure.dimension or signal.measure.angle
        if measured and written.fits(signal.measure) and not written.to(signal.measure).same:
            raise TraceError(
                f"the name {column!r} ends in the unit {word}, but its numbers would be read in {signal.unit}; state "
                f"the unit, such as --map '{name}={column} [{word}]'"
            )


def _assumptions(signals: Mapping[str, Signal], episode: Episode, settings: EpisodeSettings) -> list[str]:
    """Return a sentence for each signal without a unit in the log whose declared unit is not that of SI.

    Robots' logs are in SI units as a rule (REP 103 of ROS), so that a declaration in degrees is likely to misread them.
    """
    columns = {name: settings.columns.get(name, name) for name in signals}
    return [
        sentence
        for name, column in columns.items()
        if not episode.trace.units.get(name)
        if (sentence := assumption(column, signals[name].unit, f"--map '{name}={column} [UNIT]'"))
    ]


def assumption(column: str, declared: str, remedy: str) -> str:
    """Return a sentence on a column without a unit that is read in a declared unit; "" if this is of SI.

    Args:
        column: name of the column.
        declared: the unit in the specification.
        remedy: the option that states the unit, with UNIT in its place.
    """
    unit = parse_unit(declared)
    mass = dict(unit.dimension).get("[mass]", 0.0)
    if math.isclose(unit.factor, 1000.0**mass) and not unit.offset:
        return ""
    known = unit.dimension or "deg" in declared
    turning = bool(unit.angle) or not unit.dimension
    likely = _SI.get((unit.dimension, turning), "UNIT") if known else "UNIT"
    return (
        f"{column} has no unit in the log, and is read in {declared}; if that is wrong, state its unit, such as "
        f"{remedy.replace('UNIT', likely)}"
    )


def _silences(trace: Trace, settings: EpisodeSettings, where: str) -> Iterator[str]:
    """Yield a sentence for each signal that is silent within an episode; commands are sent at will."""
    whole = trace if trace.origin is None else trace.origin
    start = whole.begin
    if not whole.messages:
        every = f"they come every {period_of(whole.times):.3g} s"
        yield from _silence(f"{where}the file", silences_of(whole.times), every)
    for name, one in whole.messages.items():
        column = settings.columns.get(name, name)
        if column not in settings.commands and math.isfinite(one.bridged):
            until = whole.ends
            spans = SignalMessages(one, one.values).silences(start, until)
            inner = [(start + begin, min(start + end, until)) for begin, end in spans if math.isfinite(begin)]
            yield from _silence(f"{where}{column}", inner, one.rhythm)


def _silence(name: str, spans: Sequence[tuple[float, float]], rhythm: str) -> Iterator[str]:
    """Yield a sentence on the longest of the times without a message [s]."""
    if spans:
        begin, end = max(spans, key=lambda span: span[1] - span[0])
        yield (
            f"{name} has no message from t = {begin:.6g} s to {end:.6g} s, though {rhythm}: nothing is known there"
        )


def _episode(
    name: str, trace: Trace, window: EpisodeWindow | None, kept: Sequence[str], settings: EpisodeSettings
) -> Episode:
    """Return an episode of a trace, or all of it."""
    if window is None:
        return Episode(name, trace.only(kept), _values(name, trace, settings))
    one = take_episode(trace, window)
    begins = window.begin - trace.begin
    return Episode(name, one.only(kept), _values(name, one, settings), begins)


def _kept_channels(
    path: Path, trace: Trace, wanted: Mapping[str, int | None] | None, settings: EpisodeSettings
) -> tuple[str, ...]:
    """Return the channels of the traces: without those that were read for the test parameters alone."""
    if wanted is not None:
        return tuple(wanted)
    if opener(path) is None:
        return tuple(trace.channels)
    sources = {source.column for source in settings.sources.values()}
    return tuple(name for name in trace.channels if name in settings.columns or name not in sources)


def _channels_to_read(
    wanted: Mapping[str, int | None] | None, settings: EpisodeSettings
) -> dict[str, int | None] | None:
    """Return the channels to read, with those of the condition and of the test parameters; None for all."""
    if wanted is None:
        return None
    others = [*names(settings.when or ""), *(source.column for source in settings.sources.values())]
    return {**dict.fromkeys(others, ANY), **wanted}


def _load_windows(
    loads: Sequence[Loaded], signals: Mapping[str, Signal], settings: EpisodeSettings, horizon: float
) -> tuple[list[tuple[Loaded, EpisodeWindow | None]], list[str]]:
    """Return the episodes of traces, and sentences on how they were cut.

    Raises:
        UsageError: the length of an episode is not known.
    """
    duration = horizon if settings.duration is None else settings.duration
    if math.isinf(duration):
        raise UsageError("the length of an episode is not known; state it, such as --duration 2")
    windows: list[tuple[Loaded, EpisodeWindow | None]] = []
    sentences: list[str] = []
    for loaded in loads:
        episodes, notes = _trace_windows(loaded.trace, signals, settings, duration)
        windows += [(loaded, episode) for episode in episodes]
        sentences += notes
    return windows, sentences


def _trace_windows(
    trace: Trace, signals: Mapping[str, Signal], settings: EpisodeSettings, duration: float
) -> tuple[list[EpisodeWindow], list[str]]:
    """Return the episodes of a log, and sentences on how they were cut."""
    if trace.origin is not None:  # an episode begins with the message that makes the condition true
        windows, sentences = _trace_windows(trace.origin, signals, settings, duration)
        return [_with_samples(trace, one) for one in windows], sentences
    start = settings.start or 0.0
    if settings.when is None:
        one = _single_window(trace, start, duration)
        return ([], _shortfall(trace, start, duration)) if one is None else ([one], [])
    condition = _condition(trace, signals, settings.when)
    named = trace.only(condition.channels(_CONDITION))
    times, truth = _truth(condition, named, trace.begin)
    failure = trace.failure is not None
    until = trace.ends if trace.messages else None
    episodes = find_episodes(times, truth, duration, trace.begin + start, failure, until)
    last = len(episodes.ranges) - 1
    return [
        EpisodeWindow(
            float(times[first]),
            math.inf if episodes.failed and number == last else float(times[first]) + duration,
            slice(first, end),
            episodes.failed and number == last,
        )
        for number, (first, end) in enumerate(episodes.ranges)
    ], episodes.notes(settings.when)


def _with_samples(trace: Trace, window: EpisodeWindow) -> EpisodeWindow:
    """Return an episode with the samples of a trace in it."""
    first, stop = np.searchsorted(trace.times, (window.begin, window.end + slack_of(trace.times)))
    return replace(window, samples=slice(int(first), max(int(stop), int(first) + 1)))


def _truth(condition: Spec, trace: Trace, begin: float) -> tuple[FloatArray, BoolArray]:
    """Return (n,) times and whether a condition is true; before the first value of a channel it is not."""
    if trace.messages:
        evaluation = condition.evaluate(trace, _CONDITION)
        early = [begin] if begin < evaluation.times[0] else []
        times = np.concatenate((early, evaluation.times))
        return times, np.concatenate((np.zeros(len(early), bool), evaluation.truth & evaluation.complete))
    truth = np.zeros(len(trace), dtype=bool)
    first = _first_complete(trace)
    if first < len(trace):
        rest = take_episode(
            trace, EpisodeWindow(float(trace.times[first]), math.inf, slice(first, None), failed=True)
        )
        evaluation = condition.evaluate(rest, _CONDITION)
        truth[first:] = evaluation.truth & evaluation.complete
    return trace.times, truth


def _first_complete(trace: Trace) -> int:
    """Return the number of the first sample that has all channels."""
    known = np.ones(len(trace), dtype=bool)
    for values in trace.channels.values():
        known &= ~np.isnan(values.reshape(len(trace), -1)).any(axis=1)
    return int(np.argmax(known)) if known.any() else len(trace)


def _single_window(trace: Trace, start: float, duration: float) -> EpisodeWindow | None:
    """Return the one episode from a time on; None if the log does not hold it."""
    failed = trace.failure is not None
    first = trace.begin
    if trace.messages:
        complete = trace.ends >= first + start + duration - 16 * math.ulp(trace.ends)
        ends = first + start + duration if complete else math.inf
        held = complete or (failed and first + start <= trace.ends)
        return EpisodeWindow(first + start, ends, slice(0, 0), not complete) if held else None
    times = trace.times - first
    slack = slack_of(trace.times)
    begin = int(np.searchsorted(times, start - slack))
    end = int(np.searchsorted(times, start + duration + slack, side="right"))
    complete = begin < end and times[-1] >= start + duration - slack
    failed = failed and begin < end and not complete
    if not (complete or failed):
        return None
    return EpisodeWindow(float(trace.times[begin]), first + start + duration, slice(begin, end), failed)


def _shortfall(trace: Trace, start: float, duration: float) -> list[str]:
    """Return why a log has no episode from a time on."""
    end = f"{start + duration:.6g} s"
    lasts = trace.times[-1] - trace.times[0]
    if lasts > start + duration:
        return [f"the log has no sample from {start:.6g} s to {end}, and an episode needs all of it"]
    return [f"the log ends {lasts:.6g} s after its first sample, and an episode needs {start:.6g} s to {end}"]


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


def _values(name: str, trace: Trace, settings: EpisodeSettings) -> dict[str, tuple[float, str]]:
    """Return the test parameters that the log holds; a trace's times begin with its episode.

    Raises:
        TraceError: a value is not a finite number, or lies after the end.
    """
    values: dict[str, tuple[float, str]] = {}
    trace = (
        trace if trace.origin is None else trace.origin
    )  # the messages, rather than those at a clock's stamps
    for parameter, source in settings.sources.items():
        samples = trace[source.column]
        if samples.ndim != 1:
            raise TraceError(
                f"{name}: the parameter {parameter} is a vector, from {source.column}; name a component"
            )
        times = trace.times - trace.times[0]
        period = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
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
