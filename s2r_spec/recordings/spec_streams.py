"""Streams of samples for a specification: the rows of a table while it is written, or a recorded trace."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from s2r_spec.base.errors import UsageError
from s2r_spec.logs.formats.follow import follow as follow_rows
from s2r_spec.logs.interpret import request as columns_to_read
from s2r_spec.recordings.log_episodes import no_units
from s2r_spec.recordings.spec_traces import TraceRequest, params_of, read_spec_traces
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.silence import silences_of
from s2r_spec.spec.followed import SampleStream


def stream_of_rows(request: TraceRequest, readline: Callable[[int], str]) -> SampleStream:
    """Return the samples of a table that is read row by row while it is written.

    Args:
        request: the channels to read, and their specification.
        readline: as in :func:`s2r_spec.logs.formats.follow.follow`.

    Raises:
        UsageError: the request cuts or joins, which needs the whole table.
        TraceError: the head of the table cannot be read.
    """
    settings = request.settings
    if settings.cuts or settings.sources or settings.joining is not None:
        raise UsageError(
            "rows from stdin are one whole trace: leave out --when, --start, --duration, --join, --clock, --stamps, "
            "and parameters from a column"
        )
    rows = follow_rows(readline, columns_to_read(settings.columns, request.wanted, settings.time_unit))
    rows.notes.extend(no_units(request.spec.signals, rows.units, settings.columns))
    params, _ = params_of(request, rows.meta, "the trace")
    return SampleStream(rows.units, rows.meta, rows.samples, None, params, rows.notes)


def stream_of_file(request: TraceRequest, path: Path) -> SampleStream:
    """Return the samples of a recorded trace.

    Raises:
        UsageError: the file has several episodes or topics, or a gap.
        TraceError: the file cannot be read.
    """
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
