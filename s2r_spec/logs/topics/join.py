"""Bring topics to one clock, and keep the messages of each.

Data: topics i with stamps t_i1 < t_i2 < … and values y_ik, all of one clock. Result: the same messages, in order, with
an account of each; :mod:`s2r_spec.logs.interpret` makes a trace of them, in which a channel has a value at every
instant. By the rule, between two messages:

    hold     the value of the last message, as a controller sees a topic
    linear   on the line between both, up to the last message; whole numbers, truth values and commands are held

A command steps, so that fields of test parameters and of a condition are held under either rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError, one_of, suggest
from s2r_spec.logs.account import Account
from s2r_spec.logs.table import Column
from s2r_spec.logs.topics.order import sort_messages
from s2r_spec.logs.topics.topic import Stamps, Topic
from s2r_spec.trace.samples import Rule

RULES: tuple[Rule, ...] = get_args(Rule)


@dataclass(frozen=True)
class Joining:
    """How topics come to common instants.

    Args:
        clock: name of the topic at whose stamps requirements are evaluated; None for every instant.
        rule: values of a topic between its messages: "hold" or "linear".
        stamps: which stamps of a message count; None for those of the headers if all topics have one, else the
            times of receipt.
        held: fields that are held whatever the rule, by their names in the log.
    """

    clock: str | None = None
    rule: Rule = "hold"
    stamps: Stamps | None = None
    held: frozenset[str] = frozenset()

    @classmethod
    def chosen(cls, clock: str | None, rule: Rule | None, stamps: Stamps | None) -> Joining | None:
        """Return what a user chooses; None without a choice."""
        chooses = any(one is not None for one in (clock, rule, stamps))
        return cls(clock, rule or "hold", stamps) if chooses else None

    def interpolates(self, topic: str, name: str, column: Column) -> bool:
        """Return whether a field of a topic is linear between messages."""
        path = name if topic in ("", name) else f"{topic}.{name}"
        numeric = not column.fault and column.missing is None and column.values.dtype.kind == "f"
        stated = bool({path, path.rpartition("[")[0]} & self.held)
        return self.rule == "linear" and numeric and not stated and not is_whole(column.values)


def is_whole(values: NDArray[Any]) -> bool:
    """Return whether all values are whole numbers, as states and counts are."""
    return bool((values == np.rint(values)).all())


@dataclass(frozen=True)
class Joined:
    """The messages of topics, in order.

    Args:
        columns: (topic, field) → its column, with its stamps.
        accounts: topic → what became of its messages.
        clock: (n,) stamps of the clock, each once; None if there is none.
        notes: notes for the user.
    """

    columns: Mapping[tuple[str, str], Column]
    accounts: Mapping[str, Account]
    clock: NDArray[Any] | None
    notes: tuple[str, ...]


def join(topics: dict[str, Topic], joining: Joining, sortable: bool) -> Joined:
    """Return the messages of topics in order, with an account of each; the topics are removed from their table.

    ``sortable`` says whether messages of senders may be late.

    Raises:
        TraceError: the clock is not one of the topics, a topic has no messages, or its stamps are no times.
    """
    columns: dict[tuple[str, str], Column] = {}
    accounts: dict[str, Account] = {}
    notes: list[str] = []
    stamps: dict[str, NDArray[Any]] = {}
    for name in list(topics):
        topic = topics.pop(name)  # the messages of many topics fill the memory
        if not len(topic):
            raise TraceError(f"{name or 'the file'} has no messages")
        order = sort_messages(topic, sortable)
        stamps[name], count = order.topic.stamps, len(topic) + sum(topic.dropped.values())
        accounts[name] = Account(count, len(order.topic), order.merged, topic.dropped, order.resorted)
        notes += order.notes
        for field_name, column in order.topic.columns.items():
            linear = joining.interpolates(topic.name, field_name, column)
            columns[name, field_name] = replace(
                column, stamps=stamps[name], log_end=topic.log_end, linear=linear
            )
    if joining.clock is not None and joining.clock not in stamps:
        raise TraceError(
            f"the clock {joining.clock!r} is not one of the topics that are read{suggest(joining.clock, stamps)} "
            f"they are {one_of(stamps)}"
        )
    clock = None if joining.clock is None else np.unique(stamps[joining.clock])
    return Joined(columns, accounts, clock, tuple(notes))
