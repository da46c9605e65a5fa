"""A table whose rows belong to several topics, with empty cells where a row has no value, as PlotJuggler writes it.

Each channel is a topic: its messages are the rows in which it has a value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from s2r_spec.base.errors import TraceError, UsageError, one_of, suggest
from s2r_spec.logs.account import Account
from s2r_spec.logs.interpret import Loaded, at_clock, channels, omitted_columns
from s2r_spec.logs.mapping import ColumnPlan, ColumnRequest
from s2r_spec.logs.table import Column, Table
from s2r_spec.logs.times import times
from s2r_spec.logs.topics.join import Joining, is_whole
from s2r_spec.logs.topics.order import sort_messages
from s2r_spec.logs.topics.topic import Topic
from s2r_spec.trace import Trace
from s2r_spec.trace.messages import Messages
from s2r_spec.trace.messages import join as together


def join_rows(
    table: Table, plan: ColumnPlan, request: ColumnRequest, joining: Joining, longest: Mapping[str, float]
) -> Loaded:
    """Return the trace of a table whose channels have rows of their own.

    ``longest`` is channel → time for which a value is valid, as the user states it [s].

    Raises:
        TraceError: the times do not increase, a channel has no value, or the clock is not a channel.
        UsageError: other stamps are wanted than the table has.
    """
    if joining.stamps is not None:
        raise UsageError("--stamps is for messages with headers; a table has one column of times")
    columns, heads = [table.columns[n] for n in plan.times], [table.heads[n] for n in plan.times]
    place = table.places(plan.times[0])
    stamps = times.read(columns, heads, request.time_unit, place)
    read = channels(table, plan, stamps.seconds.size)
    lacking = omitted_columns(table, plan, request, read.faults)
    messages: dict[str, Messages] = {}
    accounts: dict[str, Account] = {}
    notes = [*table.notes, *plan.notes, *stamps.notes]
    end = float(stamps.seconds.max(initial=-math.inf))
    for name, values in read.samples.items():
        known = ~np.isnan(values.reshape(len(values), -1))
        if not known.any():
            raise TraceError(f"{name} has no value in any row")
        if (known.all(axis=1) == known.any(axis=1)).all():
            parts = [(known[:, 0], values)]
        else:  # each component is a topic, too
            parts = [(known[:, k], values[:, k]) for k in range(known.shape[1])]
        own, merged = [], 0
        for filled, column in parts:
            rows = np.flatnonzero(filled)
            if not rows.size:
                raise TraceError(f"a component of {name} has no value in any row")
            topic = Topic(name, stamps.seconds[rows], {name: Column(column[rows])})
            order = sort_messages(topic, False, lambda row, rows=rows: place(int(rows[row])))  # type: ignore[misc]
            samples = order.topic.columns[name].values
            linear = joining.rule == "linear" and name not in joining.held and not is_whole(samples)
            valid = longest.get(name, math.nan)
            own.append(Messages.of(order.topic.stamps, samples, longest=valid, linear=linear, log_end=end))
            merged = max(merged, order.merged)
            notes += order.notes
        messages[name] = own[0] if len(own) == 1 else together(own)
        count, empty = len(values), len(values) - int(known.any(axis=1).sum())
        dropped = {"empty cell": empty} if empty else {}
        accounts[name] = Account(count, count - empty - merged, merged, dropped)
    if joining.clock is not None and joining.clock not in messages:
        raise TraceError(
            f"the clock {joining.clock!r} is not one of the channels that are read"
            f"{suggest(joining.clock, messages)} they are {one_of(messages)}"
        )
    trace = Trace.of_messages(messages, read.units, table.meta).common()
    if joining.clock is not None:
        trace = at_clock(trace, np.unique(messages[joining.clock].times))
    return Loaded(trace, tuple(dict.fromkeys(notes)), stamps.begins, lacking, accounts, stamps.stated)
