"""The traces of a file for a specification: its channels, the parameters of each test, and what was left out.

A warning (:class:`~s2r_spec.base.errors.TraceNote`) says what was left out of a file, and which value of two was used.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from s2r_spec.base.errors import TraceNote, UsageError, one_of
from s2r_spec.base.printable import one_line
from s2r_spec.logs.account import Account
from s2r_spec.logs.interpret import request as columns_to_read
from s2r_spec.recordings.log_episodes import EpisodeSettings, read_log_episodes
from s2r_spec.recordings.log_units import assumption, no_units
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.reading import Missing
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace
from s2r_spec.trace.messages import silences_of

if TYPE_CHECKING:
    from s2r_spec.spec.followed import SampleStream


@dataclass(frozen=True)
class TraceRequest:
    """The requirements to evaluate on recorded traces, and how the traces are read.

    Args:
        spec: the specification.
        requirements: names of the requirements to evaluate.
        params: parameter → value, in the declared unit; a recorded value that differs gives way.
        settings: how the files become traces.
        nan: "error" or "hold", for missing samples.

    Raises:
        UsageError: a requirement, or a signal in ``settings.longest``, is not in the specification.
    """

    spec: Spec
    requirements: tuple[str, ...]
    params: dict[str, float]
    settings: EpisodeSettings
    nan: Missing

    def __post_init__(self) -> None:
        """Report a wrong name before any file is read."""
        for name in self.requirements:
            self.spec.unit(name)

    @property
    def wanted(self) -> dict[str, int | None]:
        """Signal → number of components of a vector, None for a scalar."""
        names = {name: None for one in self.requirements for name in self.spec.channels(one)}
        signals = [self.spec.signals[name] for name in names]
        return {signal.name: signal.dim if signal.vector else None for signal in signals}


@dataclass(frozen=True)
class SpecTrace:
    """A trace with the parameters of its test.

    Args:
        name: the file, with the number of the episode if it was cut.
        trace: the trace.
        params: parameter of the spec → value: as requested, else from the trace.
        taken: names of the parameters whose values come from the trace.
        notes: sentences on what was left out of the file, and on the date from which its times count.
        accounts: signal → what became of its messages in the file.
        stated: whether the file or the user states the unit of the times.
    """

    name: str
    trace: Trace
    params: dict[str, float]
    taken: frozenset[str]
    notes: tuple[str, ...]
    accounts: Mapping[str, Account]
    stated: bool


def read_spec_traces(request: TraceRequest, path: Path) -> list[SpecTrace]:
    """Return the traces of a file, one for each episode.

    Raises:
        TraceError: the file cannot be read; the message names it.
        UsageError: the request does not fit the specification.
    """
    if unknown := sorted(set(request.settings.longest) - set(request.spec.signals)):
        known = one_of(request.spec.signals)
        raise UsageError(f"--longest names {unknown[0]!r}, which is no signal; the signals are {known}")
    horizon = max(request.spec.horizon(name) for name in request.requirements)
    log = read_log_episodes(path, request.spec.signals, request.wanted, horizon, request.settings)
    notes = list(log.notes)
    for name, (_, unit) in log.episodes[0].values.items():
        if name in request.spec.params and not unit:
            source = request.settings.sources[name]
            remedy = f"--param '{name}={source.column} [UNIT]@{source.at:g}'"
            notes += filter(None, [assumption(source.column, request.spec.params[name].unit, remedy)])
    if log.dated:
        notes.append(f"times count from the first sample, at {log.dated}")
    for sentence in notes:
        warnings.warn(f"{path}: {sentence}", TraceNote, stacklevel=2)
    accounts = {name: one for name, one in log.accounts.items() if name in request.wanted}
    traces = []
    for episode in log.episodes:
        with in_file(path):
            values = request.spec.read_params(episode.texts())
            params, taken = params_of(request, episode.trace.meta, episode.name, values)
        traces.append(
            SpecTrace(episode.name, episode.trace, params, taken, tuple(notes), accounts, log.stated)
        )
    return traces


def params_of(
    request: TraceRequest, meta: Mapping[str, Any], source: str, values: Mapping[str, float] | None = None
) -> tuple[dict[str, float], frozenset[str]]:
    """Return parameter → value, and the names of the parameters whose values come from the trace.

    A value of the request goes before the trace's, in its meta or in a column; if they differ, a warning says so.

    Raises:
        TraceError: the trace's value of a parameter is not a number.
    """
    values_read = request.spec.recorded_params(meta) | dict(values or {})
    for name, value in request.params.items():
        if name in values_read and not math.isclose(value, values_read[name], rel_tol=1e-9, abs_tol=1e-12):
            warnings.warn(
                f"{source} was recorded with {name} = {values_read[name]:g}; it is evaluated with {value:g}, as given",
                TraceNote,
                stacklevel=3,
            )
    return values_read | request.params, frozenset(values_read) - frozenset(request.params)


def stream_of_rows(request: TraceRequest, readline: Callable[[int], str]) -> SampleStream:
    """Return the samples of a table that is read row by row while it is written.

    Raises:
        UsageError: the request cuts or joins, which needs the whole table.
        TraceError: the head of the table cannot be read.
    """
    from s2r_spec.logs.formats.follow import follow
    from s2r_spec.spec.followed import SampleStream

    settings = request.settings
    if settings.cuts or settings.sources or settings.joining is not None:
        raise UsageError(
            "rows from stdin are one whole trace: leave out --when, --start, --duration, --join, --clock, --stamps, "
            "and parameters from a column"
        )
    rows = follow(readline, columns_to_read(settings.columns, request.wanted, settings.time_unit))
    rows.notes.extend(no_units(request.spec.signals, rows.units, settings.columns))
    params, _ = params_of(request, rows.meta, "the trace")
    return SampleStream(rows.units, rows.meta, rows.samples, None, params, rows.notes)


def stream_of_file(request: TraceRequest, path: Path) -> SampleStream:
    """Return the samples of a recorded trace.

    Raises:
        UsageError: the file has several episodes or topics, or a gap.
        TraceError: the file cannot be read.
    """
    from s2r_spec.spec.followed import SampleStream

    recorded, *more = read_spec_traces(request, path)
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
    return SampleStream(trace.units, trace.meta, samples, period, recorded.params)


@contextmanager
def in_file(path: Path) -> Iterator[None]:
    """Add the file's name to every UsageError that does not have it."""
    try:
        yield
    except UsageError as error:
        if one_line(path) in str(error):
            raise
        raise type(error)(f"{path}: {error}") from None
