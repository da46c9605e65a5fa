"""Turn the parsed columns of a file into a trace, in the same way for every format."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError
from s2r_spec.lang.units import LONGEST
from s2r_spec.logs import cells
from s2r_spec.logs.account import Account
from s2r_spec.logs.mapping import ANY, ColumnPlan, ColumnRequest, MappedChannel
from s2r_spec.logs.options import unit_of_option
from s2r_spec.logs.own import clock_of, restore
from s2r_spec.logs.table import Column, Table, quote
from s2r_spec.logs.times import dates, times
from s2r_spec.logs.topics.order import sort_messages
from s2r_spec.logs.topics.topic import Topic
from s2r_spec.trace import Trace
from s2r_spec.trace import stamps as exact
from s2r_spec.trace.messages import SILENT, Messages, join

T = TypeVar("T")


@dataclass(frozen=True)
class Loaded:
    """A trace, with notes on the file for the user.

    Args:
        trace: the trace.
        notes: notes on rows left out and on decisions by names alone, one sentence each.
        begins: the date from which the times count, as text; "" if the times are unchanged.
        left_out: column that was not requested → why it is not in the trace.
        accounts: channel → what became of its messages.
        stated: whether the file or the user states the unit of the times; else they are taken to be seconds.
    """

    trace: Trace
    notes: tuple[str, ...]
    begins: str
    left_out: Mapping[str, str]
    accounts: Mapping[str, Account] = field(default_factory=dict)
    stated: bool = True


def build_trace(
    table: Table, plan: ColumnPlan, request: ColumnRequest, longest: Mapping[str, float] | None = None
) -> Loaded:
    """Return the trace of a parsed file.

    ``longest`` is channel → time for which a value of its messages is valid, as the user states it [s].

    Raises:
        TraceError: the times or a requested channel are not valid.
    """
    if any(column.stamps is not None for column in table.columns.values()):
        return _of_topics(table, plan, request, longest or {})
    columns = [table.columns[number] for number in plan.times]
    heads = [table.heads[number] for number in plan.times]
    if columns[0].values.shape[:1] == (0,) and not columns[0].fault:
        raise TraceError("; ".join(["the file has no samples", *table.notes]))
    stamps = times.read(columns, heads, request.time_unit, table.places(plan.times[0]))
    read = channels(table, plan, stamps.seconds.size)
    lacking = omitted_columns(table, plan, request, read.faults)
    names = {one.name: table.heads[one.parts[0].number].name for one in plan.channels}
    kept = restore(stamps.seconds, read.samples, table.own, names)
    if kept is not None:
        trace = replace(kept, units=read.units, meta=table.meta)
        own = {name: len(one) for name, one in kept.messages.items()}
        own = own or {name: int(kept.own(name).sum()) for name in kept.channels}
        accounts = {name: Account(count, count) for name, count in own.items()}
        if (clock := clock_of(stamps.seconds, table.own)) is not None:
            trace = at_clock(trace, clock)
        return Loaded(trace, (*table.notes, *plan.notes), stamps.begins, lacking, accounts, stamps.stated)
    trace, account, notes = _of_rows(stamps.seconds, read, table, plan.times[0])
    if longest and trace.channels and not trace.messages:
        messages = {
            name: Messages.of(trace.times, samples, longest=longest.get(name, math.nan))
            for name, samples in trace.channels.items()
        }
        trace = Trace.of_messages(messages, trace.units, trace.meta)
    notes = (*table.notes, *plan.notes, *stamps.notes, *notes)
    accounts = dict.fromkeys(read.samples, account)
    return Loaded(trace, notes, stamps.begins, lacking, accounts, stamps.stated)


def _of_rows(
    seconds: FloatArray, read: Channels, table: Table, number: int
) -> tuple[Trace, Account, tuple[str, ...]]:
    """Return the trace of a table's rows, what became of these, and notes; rows are never sorted."""
    steps = np.diff(seconds)
    if (steps > 0).all():
        return Trace(seconds, read.samples, read.units, table.meta), Account(seconds.size, seconds.size), ()
    topic = Topic("", seconds, {name: Column(one) for name, one in read.samples.items()})
    sorted_rows = sort_messages(topic, sortable=False, place=table.places(number))
    times = sorted_rows.topic.stamps
    samples = {name: column.values for name, column in sorted_rows.topic.columns.items()}
    if (np.diff(times) > 0).all():
        trace = Trace(times, samples, read.units, table.meta)
    else:
        messages = {name: Messages.of(times, one) for name, one in samples.items()}
        trace = Trace.of_messages(messages, read.units, table.meta)
    return trace, Account(seconds.size, times.size, sorted_rows.merged), sorted_rows.notes


def omitted_columns(
    table: Table, plan: ColumnPlan, request: ColumnRequest, faults: Mapping[str, str]
) -> dict[str, str]:
    """Return column that was not requested → why it is not in the trace.

    Raises:
        TraceError: a requested channel is not valid.
    """
    left_out = {**plan.faults, **faults}
    failed = bool(table.meta.get("failure"))  # its ρ is declared, so it may lack channels
    if request.wanted is not None and left_out and not failed:
        raise TraceError(next(iter(left_out.values())))
    return left_out if request.wanted is None else {}


def _of_topics(
    table: Table, plan: ColumnPlan, request: ColumnRequest, longest: Mapping[str, float]
) -> Loaded:
    clock = _Clock.of(table)
    notes = [*table.notes, *plan.notes]

    def read(channel: MappedChannel) -> tuple[Messages, str | None]:
        return _messages(table, channel, clock, longest.get(channel.name, math.nan), notes)

    messages, units, faults = _read_channels(plan, read)
    accounts = {
        one.name: _account(table, one, len(messages[one.name]))
        for one in plan.channels
        if one.name in messages
    }
    lacking = omitted_columns(table, plan, request, faults)
    if not messages:
        stamps = clock.seconds(next(one.stamps for one in table.columns.values() if one.stamps is not None))
        trace = Trace(np.unique(stamps), {}, {}, table.meta)
    else:
        trace = Trace.of_messages(messages, units, table.meta).common()
        if table.clock is not None:
            trace = at_clock(trace, clock.seconds(table.clock))
    return Loaded(trace, tuple(notes), clock.begins, lacking, accounts, clock.typed)


def at_clock(trace: Trace, stamps: FloatArray) -> Trace:
    """Return a trace at the stamps of one topic, which keeps its messages.

    A channel is NaN before its first message, and after the last one if it is linear between messages.

    Raises:
        TraceError: the topics have no time in common.
    """
    if not trace.messages:
        return trace
    first = max(float(one.times[0]) for one in trace.messages.values())
    if not stamps.size or stamps[-1] < first:
        raise TraceError("the topics have no time in common; their clocks may differ")
    last = {name: float(one.times[-1]) for name, one in trace.messages.items() if one.linear}

    def until_last(name: str, values: FloatArray) -> FloatArray:
        if name not in last or last[name] >= stamps[-1]:
            return values
        known = values.copy()
        known[stamps > last[name]] = np.nan
        return known

    return replace(trace.sampled_at(stamps).with_channels(until_last), origin=trace)


@dataclass(frozen=True)
class _Clock:
    """The clock of all topics: the first stamp that is read, and whether the stamps state their unit."""

    first: Any
    typed: bool
    done: dict[int, tuple[NDArray[Any], FloatArray]] = field(default_factory=dict)

    @classmethod
    def of(cls, table: Table) -> _Clock:
        own = [one.stamps for one in table.columns.values() if one.stamps is not None]
        first = min(stamps[0] for stamps in own)
        return cls(first, exact.is_typed(own[0]))

    @property
    def begins(self) -> str:
        """The date from which the times count, as text; "" if they are unchanged."""
        return dates.text(self.first) if self.typed and self.first.dtype.kind == "M" else ""

    def end(self, stamp: Any) -> float:
        """Return the end of a log in seconds; NaN if it is not known."""
        if stamp is None:
            return math.nan
        last = np.array([stamp]).astype(self.first.dtype)
        return float((exact.seconds(last, self.first) if self.typed else last.astype(np.float64))[0])

    def seconds(self, stamps: NDArray[Any]) -> FloatArray:
        """Return stamps in seconds; the same array for the same stamps."""
        if id(stamps) not in self.done:
            counted = exact.seconds(stamps, self.first) if self.typed else stamps.astype(np.float64)
            self.done[id(stamps)] = stamps, counted
        return self.done[id(stamps)][1]


def _messages(
    table: Table, channel: MappedChannel, clock: _Clock, longest: float, notes: list[str]
) -> tuple[Messages, str | None]:
    """Return the messages of a channel, and its unit; notes are added."""
    columns = [table.columns[part.number] for part in channel.parts]
    linear = all(column.linear for column in columns)

    def read(one: MappedChannel, column: Column) -> tuple[Messages, str | None]:
        assert column.stamps is not None
        samples, unit = _channel(table, one, len(column.stamps))
        times, end = clock.seconds(column.stamps), clock.end(column.log_end)
        return Messages.of(times, samples, longest=longest, log_end=end, linear=linear), unit

    if all(column.stamps is columns[0].stamps for column in columns):
        return read(channel, columns[0])
    scalars = [MappedChannel(channel.name, (part,), False) for part in channel.parts]
    read_parts = [read(*one) for one in zip(scalars, columns, strict=True)]
    parts, units = [one for one, _ in read_parts], [unit for _, unit in read_parts]
    if any(unit != units[0] for unit in units):
        raise TraceError(f"the components of {quote(channel.name)} have different units")
    vector = join(parts)
    early = max(int(np.searchsorted(one.times, vector.times[0])) for one in parts)
    if early > SILENT:
        late = max(zip(parts, channel.parts, strict=True), key=lambda one: float(one[0].times[0]))[1]
        raise TraceError(
            f"{early} messages of a component of {quote(channel.name)} lie before the first one of "
            f"{quote(table.heads[late.number].text)}; --map a signal to each component, or cut the log there"
        )
    if early:
        notes.append(
            f"{early} messages of a component of {quote(channel.name)} come before the others begin, and are not "
            f"evaluated"
        )
    return vector, units[0]


def _account(table: Table, channel: MappedChannel, samples: int) -> Account:
    """Return what became of a channel's messages; those of a vector's other components come on top."""
    one = [table.accounts[part.number] for part in channel.parts if part.number in table.accounts]
    if len({id(account) for account in one}) == 1:
        return one[0]
    total = sum(account.messages for account in one)
    return Account(total, samples, total - samples)


@dataclass(frozen=True)
class Channels:
    """Channels of a trace: name → samples (n,) or (n, k), name → unit, and name → fault of channels left out."""

    samples: dict[str, FloatArray]
    units: dict[str, str]
    faults: dict[str, str]


def channels(table: Table, plan: ColumnPlan, count: int) -> Channels:
    """Return the channels of a plan, each with ``count`` samples."""
    return Channels(*_read_channels(plan, lambda channel: _channel(table, channel, count)))


def _read_channels(
    plan: ColumnPlan, read: Callable[[MappedChannel], tuple[T, str | None]]
) -> tuple[dict[str, T], dict[str, str], dict[str, str]]:
    """Return name → what is read, name → unit, and name → fault of channels left out."""
    values, units, faults = {}, {}, {}
    for channel in plan.channels:
        try:
            values[channel.name], unit = read(channel)
        except TraceError as error:
            faults[channel.name] = str(error)
            continue
        if unit is not None:
            units[channel.name] = unit
    return values, units, faults


def _channel(table: Table, channel: MappedChannel, count: int) -> tuple[FloatArray, str | None]:
    columns: list[FloatArray] = []
    units: list[str | None] = []
    for part in channel.parts:
        head = table.heads[part.number]
        name = quote(head.text)
        samples, unit = cells.read_samples(table.columns[part.number], name, table.places(part.number))
        if samples.shape[0] != count:
            raise TraceError(f"{name} has {samples.shape[0]} samples, but there are {count} time stamps")
        if part.component is not None:
            width = samples.shape[1] if samples.ndim == 2 else 1
            if samples.ndim != 2 or part.component >= width:
                raise TraceError(f"{name} has no component {part.component}; it has {width}")
            samples = samples[:, part.component]
        written = head.unit if part.unit is None else part.unit
        if written is not None and (len(written) > LONGEST or not written.isprintable()):
            raise TraceError(
                f"the unit of {name} is {quote(written)}, which is not a unit; "
                f"state it, such as --map '{channel.name}={head.text} [m/s]'"
            )
        if unit is not None and written not in (None, unit):
            raise TraceError(
                f"{name} holds durations, but its unit is written as {written!r}; leave the unit out"
            )
        columns.append(samples)
        units.append(written if unit is None else unit)
    if any(unit != units[0] for unit in units):
        raise TraceError(f"the components of {quote(channel.name)} have different units")
    samples = columns[0]
    if len(columns) > 1 or channel.vector:
        if any(one.ndim != 1 for one in columns):
            raise TraceError(f"a component of {quote(channel.name)} is a vector itself")
        samples = np.stack(columns, axis=1)
    if channel.width is None and samples.ndim == 2 and samples.shape[1] == 1:
        return samples[:, 0], units[0]
    return samples[:, np.newaxis] if channel.width == 1 and samples.ndim == 1 else samples, units[0]


def request(
    columns: Mapping[str, str] | None,
    wanted: Mapping[str, int | None] | Sequence[str] | None,
    time_unit: str | None,
    gather: bool = False,
    identifiers: bool = False,
) -> ColumnRequest:
    """Return a request; names without a width may be numbers or vectors.

    Raises:
        UsageError: the unit is not a unit of time.
    """
    if wanted is not None and not isinstance(wanted, Mapping):
        wanted = dict.fromkeys(wanted, ANY)
    return ColumnRequest(dict(columns or {}), wanted, unit_of_option(time_unit), gather, identifiers)
