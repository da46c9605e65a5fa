"""A table whose rows belong to several topics, with empty cells where a row has no value, as PlotJuggler writes it.

Each channel is a topic: its messages are the rows in which it has a value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from s2r_spec.errors import TraceError, UsageError, one_of, suggest
from s2r_spec.logs.account import Account
from s2r_spec.logs.interpret import Loaded, at_clock
from s2r_spec.logs.topics.join import Joining
from s2r_spec.messages import Messages
from s2r_spec.trace import Trace


def joined(loaded: Loaded, joining: Joining, longest: Mapping[str, float]) -> Loaded:
    """Return the trace of a table whose channels have rows of their own.

    Args:
        loaded: the trace as the table has it.
        joining: the clock and the rule.
        longest: channel → time for which a value is valid, as the user states it [s].

    Raises:
        TraceError: a channel has no value, or the clock is not a channel.
        UsageError: other stamps are wanted than the table has.
    """
    if joining.stamps is not None:
        raise UsageError("--stamps is for messages with headers; a table has one column of times")
    trace = loaded.trace
    messages: dict[str, Messages] = {}
    accounts: dict[str, Account] = {}
    for name, values in trace.channels.items():
        present = ~np.isnan(values.reshape(len(trace), -1)).any(axis=1)
        if not present.any():
            raise TraceError(f"{name} has no value in any row")
        own, rows = values[present], loaded.accounts[name]
        linear = joining.rule == "linear" and name not in joining.held and not whole(own)
        valid = longest.get(name, math.nan)
        messages[name] = Messages.of(trace.times[present], own, longest=valid, linear=linear)
        empty = {"empty cell": rows.samples - len(own)} if len(own) < rows.samples else {}
        accounts[name] = replace(rows, samples=len(own), dropped={**rows.dropped, **empty})
    if joining.clock is not None and joining.clock not in messages:
        raise TraceError(
            f"the clock {joining.clock!r} is not one of the channels that are read"
            f"{suggest(joining.clock, messages)} they are {one_of(messages)}"
        )
    found = Trace.of_messages(messages, trace.units, trace.meta).common()
    if joining.clock is not None:
        found = at_clock(found, messages[joining.clock].times)
    return replace(loaded, trace=found, accounts=accounts)


def whole(values: np.ndarray) -> bool:
    """Return whether all values are whole numbers, as states and counts are."""
    return bool((values == np.rint(values)).all())
