"""What a log holds: its topics, their fields, rates and gaps, before anybody decides what to read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec import logs
from s2r_spec.errors import TraceError
from s2r_spec.logs.topics import formats
from s2r_spec.logs.topics.join import seconds, stamp_text


@dataclass(frozen=True)
class FieldSummary:
    """A field of a topic, or a column of a table.

    Args:
        name: as ``--map`` names it.
        unit: unit as written; None if there is none.
        missing: samples without a value; 0 for a topic.
    """

    name: str
    unit: str | None
    missing: int = 0


@dataclass(frozen=True)
class TopicSummary:
    """A topic of a log; a table is one topic without a name.

    Args:
        name: name of the topic; "" for a table.
        kind: type of its messages; "" if it has none.
        messages: their number.
        begins: the first stamp, as text; "" without messages.
        span: time from the first message to the last [s].
        period: median time from a message to the next [s]; None below two messages.
        gap: longest time from a message to the next [s]; None below two messages.
        fields: what can be read.
        left_out: why something cannot, a sentence each.
    """

    name: str
    kind: str
    messages: int
    begins: str
    span: float
    period: float | None
    gap: float | None
    fields: tuple[FieldSummary, ...]
    left_out: tuple[str, ...] = ()


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
    open_log = formats.opener(path)
    if open_log is None:
        return _table(path, columns, time_unit)
    try:
        log = open_log(path)
        topics = log.read({topic.name: () for topic in log.heads}, "received")
    except OSError as error:
        raise TraceError(f"cannot read {path}: {error.strerror or error}") from None
    except TraceError as error:
        raise TraceError(f"{path}: {error}") from None
    return LogSummary(
        tuple(
            _topic(
                head.name,
                head.kind,
                np.sort(topics[head.name].stamps),
                [FieldSummary(head.path(name), head.units.get(name)) for name in head.fields],
                [f"{head.path(name)} {fault}" for name, fault in head.faults.items()],
            )
            for head in log.heads
        ),
        tuple(log.notes),
    )


def _table(path: Path, columns: Mapping[str, str] | None, time_unit: str | None) -> LogSummary:
    loaded = logs.load(path, columns, time_unit=time_unit)
    trace = loaded.trace
    fields = [
        FieldSummary(
            name, trace.units.get(name), int(np.isnan(values.reshape(len(trace), -1)).any(axis=1).sum())
        )
        for name, values in trace.channels.items()
    ]
    topic = _topic("", "", trace.times, fields, [f"{name}: {why}" for name, why in loaded.left_out.items()])
    notes = (*loaded.notes, *([f"times count from {loaded.begins}"] if loaded.begins else []))
    return LogSummary((topic,), notes)


def _topic(
    name: str, kind: str, stamps: NDArray[Any], fields: Sequence[FieldSummary], left_out: Sequence[str]
) -> TopicSummary:
    steps = seconds(np.diff(stamps)) if len(stamps) > 1 else None
    return TopicSummary(
        name,
        kind,
        len(stamps),
        stamp_text(stamps[0]) if len(stamps) else "",
        0.0 if steps is None else float(steps.sum()),
        None if steps is None else float(np.median(steps)),
        None if steps is None else float(steps.max()),
        tuple(fields),
        tuple(left_out),
    )
