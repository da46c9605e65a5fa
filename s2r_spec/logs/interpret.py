"""Turn the parsed columns of a file into a trace, in the same way for every format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import TraceError
from s2r_spec.lang.units import LONGEST
from s2r_spec.logs import times, values
from s2r_spec.logs.mapping import ANY, Channel, Plan, Request
from s2r_spec.logs.table import Arrivals, Table, quoted
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Loaded:
    """A trace, with notes on the file for the user.

    Args:
        trace: the trace.
        notes: notes on rows left out and on decisions by names alone, one sentence each.
        begins: the date from which the times count, as text; "" if the times are unchanged.
        left_out: column that was not requested → why it is not in the trace.
        arrivals: topic → when its messages came; empty for a table that is none of topics.
    """

    trace: Trace
    notes: tuple[str, ...]
    begins: str
    left_out: Mapping[str, str]
    arrivals: Mapping[str, Arrivals] = field(default_factory=dict)


def build_trace(table: Table, plan: Plan, request: Request) -> Loaded:
    """Return the trace of a parsed file.

    Raises:
        TraceError: the times or a requested channel are not valid.
    """
    columns = [table.columns[number] for number in plan.times]
    heads = [table.heads[number] for number in plan.times]
    if columns[0].values.shape[:1] == (0,) and not columns[0].fault:
        raise TraceError("; ".join(["the file has no samples", *table.notes]))
    stamps = times.read(columns, heads, request.time_unit, lambda k: table.place(k, plan.times[0]))
    failed = bool(table.meta.get("failure"))  # its ρ is declared, so it may lack channels
    read = channels(table, plan, stamps.seconds.size)
    left_out = dict(plan.faults) | read.faults
    if request.wanted is not None and left_out and not failed:
        raise TraceError(next(iter(left_out.values())))
    trace = Trace(stamps.seconds, read.samples, read.units, table.meta)
    notes = (*table.notes, *plan.notes, *stamps.notes)
    return Loaded(trace, notes, stamps.begins, left_out if request.wanted is None else {}, table.arrivals)


@dataclass(frozen=True)
class Channels:
    """Channels of a trace: name → samples (n,) or (n, k), name → unit, and name → fault of channels left out."""

    samples: dict[str, FloatArray]
    units: dict[str, str]
    faults: dict[str, str]


def channels(table: Table, plan: Plan, count: int) -> Channels:
    """Return the channels of a plan.

    Args:
        table: table with the columns that the plan needs.
        plan: the columns of each channel.
        count: number of samples that each channel must have.
    """
    read = Channels({}, {}, {})
    for channel in plan.channels:
        try:
            samples, unit = _channel(table, channel, count)
        except TraceError as error:
            read.faults[channel.name] = str(error)
            continue
        read.samples[channel.name] = _shaped(samples, channel.width)
        if unit is not None:
            read.units[channel.name] = unit
    return read


def _channel(table: Table, channel: Channel, count: int) -> tuple[FloatArray, str | None]:
    columns: list[FloatArray] = []
    units: list[str | None] = []
    for part in channel.parts:
        head = table.heads[part.number]
        name = quoted(head.text)
        samples, unit = values.read(table.columns[part.number], name, _placed(table, part.number))
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
                f"the unit of {name} is {quoted(written)}, which is not a unit; "
                f"state it, such as --map '{channel.name}={head.text} [m/s]'"
            )
        columns.append(samples)
        units.append(_agreed(unit, written, name))
    if any(unit != units[0] for unit in units):
        raise TraceError(f"the components of {quoted(channel.name)} have different units")
    if len(columns) == 1 and not channel.vector:
        return columns[0], units[0]
    if any(samples.ndim != 1 for samples in columns):
        raise TraceError(f"a component of {quoted(channel.name)} is a vector itself")
    return np.stack(columns, axis=1), units[0]


def _shaped(samples: FloatArray, width: int | None) -> FloatArray:
    """Return (n, 1) samples as (n,) for a scalar channel, and (n,) as (n, 1) for a vector; others unchanged."""
    if width is None and samples.ndim == 2 and samples.shape[1] == 1:
        return samples[:, 0]
    return samples[:, np.newaxis] if width == 1 and samples.ndim == 1 else samples


def _placed(table: Table, number: int) -> _Place:
    return _Place(table, number)


@dataclass(frozen=True)
class _Place:
    table: Table
    number: int

    def __call__(self, sample: int) -> str:
        """Return the place of a sample in the file."""
        return self.table.place(sample, self.number)


def _agreed(typed: str | None, written: str | None, name: str) -> str | None:
    """Return the unit of a column: the unit of its type, which the written unit must not contradict."""
    if typed is None:
        return written
    if written not in (None, typed):
        raise TraceError(
            f"{name} holds durations, but its unit is written as {written!r}; leave the unit out"
        )
    return typed


def request(
    columns: Mapping[str, str] | None,
    wanted: Mapping[str, int | None] | Sequence[str] | None,
    time_unit: str | None,
    gather: bool = False,
    identifiers: bool = False,
) -> Request:
    """Return a request; names without a width may be numbers or vectors.

    Raises:
        UsageError: the unit is not a unit of time.
    """
    if wanted is not None and not isinstance(wanted, Mapping):
        wanted = dict.fromkeys(wanted, ANY)
    return Request(dict(columns or {}), wanted, times.unit_of_option(time_unit), gather, identifiers)
