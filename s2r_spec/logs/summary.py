"""What a log holds: its topics, their fields, rates and gaps, before anybody decides what to read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec import logs
from s2r_spec.base.errors import NoTimesError, TraceError
from s2r_spec.logs.options import TIME, TimeOptions, map_argument, unit_of_option
from s2r_spec.logs.topics import formats
from s2r_spec.logs.topics.order import resets
from s2r_spec.logs.topics.topic import seconds, stamp_text

_HEADERS_UP_TO = 2**26
"""Budget: bytes of a bag whose headers are read to find a clock that began anew, 64 MB."""


@dataclass(frozen=True)
class FieldSummary:
    """A field of a topic, or a column of a table.

    Args:
        name: as ``--map`` names it.
        unit: unit as written; None if there is none.
        missing: samples without a value; 0 for a topic.
        components: length of its vectors; None for a number, and where only the messages tell.
    """

    name: str
    unit: str | None
    missing: int = 0
    components: int | None = None


@dataclass(frozen=True)
class RunSummary:
    """A part of a topic whose times begin anew.

    Args:
        begins: the first stamp, as text; "" without messages.
        messages: their number.
        span: time from the first message to the last [s].
    """

    begins: str
    messages: int
    span: float


@dataclass(frozen=True)
class TopicSummary:
    """A topic of a log; a table is one topic without a name.

    Args:
        name: name of the topic; "" for a table.
        kind: type of its messages; "" if it has none.
        messages: their number.
        episodes: number of its runs.
        begins: the first stamp, as text; "" without messages.
        span: time from the first message to the last, summed over episodes [s].
        period: median time from a message to the next [s]; None below two messages.
        gap: longest time from a message to the next [s]; None below two messages.
        fields: what can be read.
        left_out: why something cannot, a sentence each.
        runs: its parts whose times begin anew, in order.
    """

    name: str
    kind: str
    messages: int
    episodes: int
    begins: str
    span: float
    period: float | None
    gap: float | None
    fields: tuple[FieldSummary, ...]
    left_out: tuple[str, ...] = ()
    runs: tuple[RunSummary, ...] = ()


@dataclass(frozen=True)
class LogSummary:
    """The topics of a log, and notes on the file."""

    topics: tuple[TopicSummary, ...]
    notes: tuple[str, ...]


def summary(path: Path, columns: Mapping[str, str] | None = None, time_unit: str | None = None) -> LogSummary:
    """Return what a log holds.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        columns: "t" → the column of the times of a table, if it has another name.
        time_unit: unit of a table's times that are plain numbers; None if not stated.

    Raises:
        TraceError: the file cannot be read; the message names it.
    """
    columns = columns or {}
    options = TimeOptions(unit_of_option(time_unit), columns.get(TIME))
    open_log = formats.opener(path, options)
    if open_log is None:
        return _table(path, columns, time_unit)
    try:
        log = open_log(path)
        topics = log.read({topic.name: () for topic in log.heads}, "received")
        stamped = [topic.name for topic in log.heads if topic.header and topic.count]
        sent = {}
        size = sum(one.stat().st_size for one in (path.iterdir() if path.is_dir() else [path]))
        if stamped and size <= _HEADERS_UP_TO:
            # a message that cannot be decoded is an error of the command that reads it
            with suppress(TraceError):
                sent = log.read(dict.fromkeys(stamped, ()), "header")
    except OSError as error:
        raise TraceError(f"cannot read {path}: {error.strerror or error}") from None
    except NoTimesError as error:
        if not error.candidates or TIME in columns:
            raise NoTimesError(f"{path}: {error}", error.likely) from None
        likely = summary(path, {**columns, TIME: error.likely}, time_unit)
        return LogSummary(likely.topics, (str(error), _taken(error), *likely.notes))
    except TraceError as error:
        raise TraceError(f"{path}: {error}") from None
    summaries = []
    for head in log.heads:
        topic = topics[head.name]
        own = sent.get(head.name, topic).stamps  # stamps of the senders show where a clock began anew
        parts = np.split(topic.stamps, resets(own) if len(own) == len(topic.stamps) else [])
        fields = [FieldSummary(head.path(name), head.units.get(name)) for name in head.fields]
        left_out = [f"{head.path(name)} {fault}" for name, fault in head.faults.items()]
        if not fields and not left_out:
            left_out.append("its messages hold no numbers that s2r reads")
        summaries.append(_topic(head.name, head.kind, list(map(np.sort, parts)), fields, left_out))
    notes = [] if summaries else ["the file has no topics"]
    return LogSummary(tuple(summaries), (*log.notes, *notes))


def _table(path: Path, columns: Mapping[str, str], time_unit: str | None) -> LogSummary:
    notes: list[str] = []
    try:
        episodes = logs.load_episodes(path, logs.Reading(columns, time_unit=time_unit, runs=True))
    except NoTimesError as error:
        if TIME in columns:
            raise
        columns = {**columns, TIME: error.likely}
        episodes = logs.load_episodes(path, logs.Reading(columns, time_unit=time_unit, runs=True))
        notes += [str(error).removeprefix(f"{path}: ")] if error.candidates else []
        notes.append(_taken(error))
    traces = [loaded.trace for loaded in episodes]
    fields = []
    for name, samples in traces[0].channels.items():
        rows = [np.isnan(trace[name].reshape(len(trace), -1)).any(axis=1) for trace in traces]
        missing = sum(int(one.sum()) for one in rows)
        width = samples.shape[1] if samples.ndim == 2 else None
        fields.append(FieldSummary(name, traces[0].units.get(name), missing, width))
    left_out = [f"{name}: {why}" for name, why in episodes[0].left_out.items()]
    topic = _topic("", "", [trace.times for trace in traces], fields, left_out)
    notes += dict.fromkeys(note for loaded in episodes for note in loaded.notes)
    notes += [f"times count from {episodes[0].begins}"] if episodes[0].begins else []
    if any(field.missing for field in fields):
        notes.append("cells are empty; --join hold treats each column as a topic with its own stamps")
    return LogSummary((topic,), tuple(notes))


def _taken(error: NoTimesError) -> str:
    return (
        f"the times are taken from {error.likely!r}; other commands need --map {map_argument(error.likely)}"
    )


def _topic(
    name: str,
    kind: str,
    episodes: Sequence[NDArray[Any]],
    fields: Sequence[FieldSummary],
    left_out: Sequence[str],
) -> TopicSummary:
    parts = [seconds(np.diff(stamps)) for stamps in episodes]
    steps = np.concatenate(parts)
    runs = [
        RunSummary(stamp_text(stamps[0]) if len(stamps) else "", len(stamps), float(part.sum()))
        for stamps, part in zip(episodes, parts, strict=True)
    ]
    return TopicSummary(
        name,
        kind,
        sum(map(len, episodes)),
        len(episodes),
        runs[0].begins,
        float(steps.sum()),
        float(np.median(steps)) if steps.size else None,
        float(steps.max()) if steps.size else None,
        tuple(fields),
        tuple(left_out),
        tuple(runs),
    )
