"""A table whose rows belong to several topics, with empty cells where a row has no value, as PlotJuggler writes it.

Each channel is a topic: its messages are the rows in which it has a value.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import UsageError
from s2r_spec.logs.interpret import Loaded
from s2r_spec.logs.table import Column
from s2r_spec.logs.topics.join import Joining, join
from s2r_spec.logs.topics.topic import Topic
from s2r_spec.trace import Trace


def joined(loaded: Loaded, joining: Joining, early: bool = False) -> Loaded:
    """Return a trace with a value of every channel at the rows of the clock, which is one of the channels.

    Args:
        loaded: the trace, with NaN for empty cells.
        joining: the clock and the rule.
        early: whether to keep rows before the first value of a channel.

    Raises:
        TraceError: a channel has no value, or the clock is not a channel.
        UsageError: other stamps are wanted than the table has.
    """
    if joining.stamps is not None:
        raise UsageError("--stamps is for messages with headers; a table has one column of times")
    trace = loaded.trace
    topics: dict[str, Topic] = {}
    for name, values in trace.channels.items():
        present = ~np.isnan(values.reshape(len(trace), -1)).any(axis=1)
        topics[name] = Topic(name, trace.times[present], {name: Column(values[present])})
    found = join(topics, joining, early)
    channels = {name: _values(found.columns[name, name]) for name in topics}
    return replace(
        loaded,
        trace=Trace(found.stamps, channels, trace.units, trace.meta),
        notes=(*loaded.notes, *found.notes),
        arrivals=found.arrivals,
    )


def _values(column: Column) -> NDArray[np.float64]:
    """Return (n,) or (n, k) values, NaN where they are missing."""
    values = column.values.astype(np.float64)
    if column.missing is not None:
        values[column.missing] = np.nan
    return values
