"""Make a table of a log of topics, whose columns have stamps of their own."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from s2r_spec.base.errors import TraceError, one_of, suggest
from s2r_spec.logs.account import Account
from s2r_spec.logs.options import TIME
from s2r_spec.logs.table import Chooser, Column, Head, Table
from s2r_spec.logs.topics.join import Joining
from s2r_spec.logs.topics.order import Ordered, sort_messages
from s2r_spec.logs.topics.topic import APART, Stamps, Topic, TopicHead, TopicLog, seconds


def load(open_log: Callable[[Path], TopicLog], path: Path, choose: Chooser, *, joining: Joining) -> Table:
    """Read the chosen fields of a log, from its file or folder.

    Raises:
        TraceError: the file is damaged, or its stamps are no times or come from several clocks.
    """
    log = open_log(path)
    if not log.heads:
        raise TraceError("the file has no topics")
    fields = [(topic, field) for topic in log.heads for field in topic.fields]
    heads = _heads(log.heads, fields)
    chosen = {number: fields[number - 1] for number in sorted(choose(tuple(heads))) if number}
    fields_by_topic: dict[str, list[str]] = defaultdict(list)
    for topic, field in chosen.values():
        fields_by_topic[topic.name].append(field)
    topics = {topic.name: topic for topic in log.heads}
    named = _owner(joining.clock, topics)
    if named is not None:
        joining = replace(joining, clock=named[0].name)
    if joining.clock is not None and joining.clock in topics:
        fields_by_topic.setdefault(joining.clock, [])
    if not fields_by_topic:  # what is missing is said later; a trace has stamps
        fields_by_topic[max(log.heads, key=lambda topic: topic.count).name] = []
    which, notes = _stamps([topics[name] for name in fields_by_topic], joining.stamps)
    read = log.read(fields_by_topic, which)
    for one in read.values():
        _refuse_unset(one)
    _one_clock(read)
    # A topic whose elements come in different messages has several streams, each with a key of its own.
    streams = {(one.name, field): key for key, one in read.items() for field in one.columns}
    if named is not None and (named[0].name, named[1]) in streams:
        joining = replace(joining, clock=streams[named[0].name, named[1]])
    some = next(iter(read.values())).stamps
    ordered = _in_order(read, log.sortable)
    if joining.clock is not None and joining.clock not in ordered:
        raise TraceError(
            f"the clock {joining.clock!r} is not one of the topics that are read{suggest(joining.clock, ordered)} "
            f"they are {one_of(ordered)}"
        )
    clock = None if joining.clock is None else np.unique(ordered[joining.clock].topic.stamps)
    accounts_of = {
        key: Account(one.messages, len(one.topic), one.merged, one.topic.dropped, one.resorted)
        for key, one in ordered.items()
    }
    columns: dict[int, Column] = {}
    accounts: dict[int, Account] = {}
    for number, (topic, field) in chosen.items():
        key = streams[topic.name, field]
        stream = ordered[key].topic
        column = stream.columns[field]
        linear = joining.interpolates(topic.name, field, column)
        columns[number] = replace(column, stamps=stream.stamps, log_end=stream.log_end, linear=linear)
        accounts[number] = accounts_of[key]
    if not columns:  # a trace has stamps, although no channel
        columns[0] = Column(some, stamps=some)
    return Table(
        tuple(heads),
        columns,
        {},
        lambda sample, number: f"{heads[number].text} at message {sample + 1}",
        [*log.notes, *notes, *(note for one in ordered.values() for note in one.notes)],
        accounts,
        clock,
    )


def _in_order(topics: dict[str, Topic], sortable: bool) -> dict[str, Ordered]:
    """Return topics with their messages in order; they leave the table, because many fill the memory."""
    ordered = {}
    for name in list(topics):
        topic = topics.pop(name)
        if not len(topic):
            raise TraceError(f"{name or 'the file'} has no messages")
        ordered[name] = sort_messages(topic, sortable)
    return ordered


def _heads(topics: Sequence[TopicHead], fields: Sequence[tuple[TopicHead, str]]) -> list[Head]:
    heads = [Head(TIME), *(_head(topic, field) for topic, field in fields)]
    for topic in topics:
        without = {**topic.other, **topic.faults}
        heads += [Head(topic.path(field), fault=fault) for field, fault in without.items()]
    return heads


def _owner(clock: str | None, topics: Mapping[str, TopicHead]) -> tuple[TopicHead, str] | None:
    """Return the topic and the field of a clock that is named by a field; None for any other name."""
    if clock is None or clock in topics:
        return None
    owners = (
        (topic, field) for topic in topics.values() for field in topic.fields if topic.path(field) == clock
    )
    return next(owners, None)


def _head(topic: TopicHead, field: str) -> Head:
    """Return the head of a field; ``q[3]`` is a component of a vector."""
    fault = "" if topic.count else "belongs to a topic without messages"
    stem, bracket, rest = field.rpartition("[")
    digits = rest.removesuffix("]")
    if bracket and digits.isdecimal():
        return Head(topic.path(stem), int(digits), topic.units.get(field), fault)
    return Head(topic.path(field), None, topic.units.get(field), fault)


def _stamps(topics: list[TopicHead], chosen: Stamps | None) -> tuple[Stamps, list[str]]:
    """Return which stamps count, and a note where the log has both."""
    without = [topic.name for topic in topics if not topic.header]
    if chosen == "header" and without:
        raise TraceError(
            f"the messages of {one_of(without)} have no header with a stamp; use --stamps received"
        )
    if len(without) == len(topics):
        return "received", []
    if chosen is None and without:
        return "received", [
            f"the stamps are the times of receipt, because the messages of {one_of(without)} have no header"
        ]
    which: Stamps = chosen or "header"
    return which, [
        f"the stamps are {'those of the headers' if which == 'header' else 'the times of receipt'}"
    ]


def _refuse_unset(topic: Topic) -> None:
    """Refuse headers without a stamp: the time of such a message is known by its receipt alone.

    The stamp 0 means that the sender set none, unless its clock began there.
    """
    if topic.age is None:
        return
    counts = topic.stamps.astype("m8[ns]") if topic.stamps.dtype.kind == "M" else topic.stamps
    since = seconds(counts) if len(topic) else np.zeros(0)
    unset = since == 0.0
    if unset.any() and not unset.all() and since[~unset].min() <= APART:
        unset[:] = False
    if unset.any():
        raise TraceError(
            f"{int(unset.sum()):,} of {len(topic):,} headers of {topic.name} have no stamp, only 0, first message "
            f"{int(np.argmax(unset)) + 1}; use --stamps received"
        )


def _one_clock(topics: Mapping[str, Topic]) -> None:
    """Refuse stamps of several clocks, such as simulated time beside the date."""
    ages = {name: topic.age for name, topic in topics.items() if topic.age is not None}
    if ages and max(ages.values()) - min(ages.values()) > APART:
        late, early = max(ages, key=ages.__getitem__), min(ages, key=ages.__getitem__)
        raise TraceError(
            f"the header stamps come from different clocks: those of {late} lie {ages[late]:.6g} s before their "
            f"receipt, and those of {early} {ages[early]:.6g} s; use --stamps received"
        )
