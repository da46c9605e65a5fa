"""Make a table of a log of topics: one row for each message of the clock."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from s2r_spec.errors import TraceError, one_of
from s2r_spec.logs.table import Chooser, Column, Head, Table
from s2r_spec.logs.times import TIME
from s2r_spec.logs.topics.join import Joining, join, seconds
from s2r_spec.logs.topics.topic import Stamps, Topic, TopicHead, TopicLog

APART = 1.0
"""A tolerance [s]: difference of the ages of two topics' stamps when they are recorded. Stamps that differ by more come
from two clocks. Twice as much accepts clocks that are 2 s apart; no buffer on a robot holds a message for so long."""


def load(
    open_log: Callable[[Path], TopicLog], path: Path, choose: Chooser, joining: Joining, early: bool = False
) -> Table:
    """Read the chosen fields of a log, at the stamps of its clock.

    Args:
        open_log: opens the log.
        path: its file or folder.
        choose: chooses the fields.
        joining: how the topics come to common stamps.
        early: whether to keep stamps before the first message of a topic, where its values are missing.

    Raises:
        TraceError: the file is damaged, its topics have no time in common, or their stamps come from several clocks.
    """
    log = open_log(path)
    if not log.heads:
        raise TraceError("the file has no topics")
    heads: list[Head] = [Head(TIME)]
    fields: list[tuple[TopicHead, str]] = []
    for topic in log.heads:
        for field in topic.fields:
            heads.append(_head(topic, field))
            fields.append((topic, field))
    for topic in log.heads:
        without = {**topic.other, **topic.faults}
        heads += [Head(topic.path(field), fault=fault) for field, fault in without.items()]
    chosen = sorted(number for number in choose(tuple(heads)) if number)
    wanted: dict[str, list[str]] = defaultdict(list)
    for number in chosen:
        topic, field = fields[number - 1]
        wanted[topic.name].append(field)
    topics = {topic.name: topic for topic in log.heads}
    named = _owner(joining.clock, topics)
    if named is not None:
        joining = replace(joining, clock=named[0].name)
    if joining.clock is not None and joining.clock in topics:
        wanted.setdefault(joining.clock, [])
    if not wanted:  # what is missing is said later; a trace has stamps
        wanted[max(log.heads, key=lambda topic: topic.count).name] = []
    which, notes = _stamps([topics[name] for name in wanted], joining.stamps)
    read = {}
    for name, one in log.read(wanted, which).items():
        read[name], left_out = _stamped(one)
        notes += left_out
    _one_clock(read)
    # A topic whose elements come in different messages has several streams, each with a key of its own.
    streams = {(one.name, field): key for key, one in read.items() for field in one.columns}
    if named is not None and (named[0].name, named[1]) in streams:
        joining = replace(joining, clock=streams[named[0].name, named[1]])
    joined = join(read, joining, early)
    columns: dict[int, Column] = {0: Column(joined.stamps)}
    for number in chosen:
        topic, field = fields[number - 1]
        columns[number] = joined.columns[streams[topic.name, field], field]

    def place(sample: int, number: int) -> str:
        return f"{heads[number].text} at sample {sample}"

    return Table(tuple(heads), columns, {}, place, [*log.notes, *notes, *joined.notes], joined.arrivals)


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
    """Return which stamps count, and a note where the log has both.

    Raises:
        TraceError: the stamps of the headers are wanted, and a topic has none.
    """
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


def _stamped(topic: Topic) -> tuple[Topic, list[str]]:
    """Return a topic without the messages whose header has no stamp, and a note on these.

    The stamp 0 means that the sender set none, unless its clock began there.

    Raises:
        TraceError: no header has a stamp, or the stamps jump back, as those of a simulation that began anew.
    """
    counts = topic.stamps.astype("m8[ns]") if topic.stamps.dtype.kind == "M" else topic.stamps
    ages = seconds(counts) if len(topic) else np.zeros(0)
    remedy = "save each part in a file of its own" if topic.age is None else "use --stamps received"
    unset = ages == 0.0
    if topic.age is None or (not unset.all() and ages[~unset].min() <= APART):
        unset[:] = False
    if unset.any() and unset.all():
        raise TraceError(f"the headers of {topic.name} have no stamps, only zeros; {remedy}")
    set_ = ages[~unset]
    back = np.maximum.accumulate(set_) - set_
    if back.size and back.max() > APART:
        number = int(np.argmax(back > APART))
        raise TraceError(
            f"the stamps of {topic.name or 'the file'} jump back by {back[number]:.6g} s at message "
            f"{int(np.flatnonzero(~unset)[number]) + 1}, so its clock began anew; {remedy}"
        )
    if not unset.any():
        return topic, []
    note = f"{int(unset.sum())} messages of {topic.name} have no stamp in their header, and are left out"
    return topic.only(~unset), [note]


def _one_clock(topics: Mapping[str, Topic]) -> None:
    """Refuse stamps of several clocks, such as simulated time beside the date.

    Raises:
        TraceError: the ages of two topics' stamps differ by more than :data:`APART`.
    """
    ages = {name: topic.age for name, topic in topics.items() if topic.age is not None}
    if ages and max(ages.values()) - min(ages.values()) > APART:
        late, early = max(ages, key=ages.__getitem__), min(ages, key=ages.__getitem__)
        raise TraceError(
            f"the header stamps come from different clocks: those of {late} lie {ages[late]:.6g} s before their "
            f"receipt, and those of {early} {ages[early]:.6g} s; use --stamps received"
        )
