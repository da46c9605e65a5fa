"""Rows of a table for channels that have messages of their own, and which of its cells are own samples.

A trace of messages becomes one row for each stamp of any channel, with as many rows for a stamp as a channel has
messages with it. A cell without a message is empty. The record beside the table, in its metadata, says which cells are
messages: an empty cell may be one, too, whose value is missing. A file without this record has own samples only.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray
from s2r_spec.base.errors import TraceError
from s2r_spec.trace import Trace
from s2r_spec.trace.messages import Messages

VERSION = 1
"""Definition: version of the record."""
_NUMBERS = ("period", "longest", "log_end", "end")


def rows(trace: Trace) -> tuple[FloatArray, Mapping[str, FloatArray], dict[str, Any]]:
    """Return (times, channels, record) of a trace as a table; the record is empty if all samples are own.

    Of a trace at the stamps of a clock, the rows are its messages, and the record says which rows the clock has.
    """
    clock = None
    if trace.origin is not None and any(
        not np.array_equal(one.times, trace.times) for one in trace.origin.messages.values()
    ):
        clock = trace.times
        trace = replace(trace.origin, units=trace.units, meta=trace.meta)
    if not trace.messages:
        masks = {name: _pack(mask) for name, mask in trace.masks.items() if not mask.all()}
        return trace.times, trace.channels, {"version": VERSION, "masks": masks} if masks else {}
    counts: dict[float, int] = {}
    for one in trace.messages.values():
        stamps, number = np.unique(one.times, return_counts=True)
        for stamp in stamps[number > 1].tolist():
            counts[stamp] = max(counts.get(stamp, 1), int(number[np.searchsorted(stamps, stamp)]))
    stamps_of_all = [one.times for one in trace.messages.values()]
    each = np.unique(np.concatenate(stamps_of_all if clock is None else [*stamps_of_all, clock]))
    times = np.repeat(each, [counts.get(stamp, 1) for stamp in each.tolist()] if counts else 1)
    channels: dict[str, FloatArray] = {}
    described: dict[str, dict[str, Any]] = {}
    for name, one in trace.messages.items():
        # The n-th message of a stamp stands in the n-th row of this stamp.
        first = np.searchsorted(one.times, one.times, side="left")
        place = np.searchsorted(times, one.times, side="left") + np.arange(len(one)) - first
        values = np.full((times.size, *one.values.shape[1:]), np.nan)
        values[place] = one.values
        own = np.zeros(times.size, dtype=bool)
        own[place] = True
        channels[name] = values
        numbers = {key: getattr(one, key) for key in _NUMBERS}
        described[name] = {"own": _pack(own), "linear": one.linear}
        # JSON has no infinite numbers.
        if spans := [[at if math.isfinite(at) else None for at in span] for span in one.invalid]:
            described[name]["invalid"] = spans
        described[name] |= {key: number for key, number in numbers.items() if math.isfinite(number)}
    record = {"version": VERSION, "messages": described, "since": trace.since, "until": trace.until}
    return times, channels, record if clock is None else {**record, "clock": _pack(np.isin(times, clock))}


def description(trace: Trace, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return what stands beside the columns of a trace's table: units, meta, and the record if there is one."""
    return {"units": dict(trace.units), "meta": dict(trace.meta)} | ({"own": record} if record else {})


def clock_of(times: FloatArray, record: Mapping[str, Any]) -> FloatArray | None:
    """Return (m,) the stamps of the clock of a table with (n,) times and a record [s]; None without a clock.

    Raises:
        TraceError: the record does not fit the table.
    """
    if "clock" not in record:
        return None
    with _fitting():
        return np.unique(times[_unpack(record["clock"], times.size)])


@contextmanager
def _fitting() -> Iterator[None]:
    try:
        yield
    except (KeyError, TypeError, ValueError) as error:
        raise TraceError(f"its record of own samples does not fit the table: {error}") from None


def restore(
    times: FloatArray, channels: Mapping[str, FloatArray], record: Mapping[str, Any], names: Mapping[str, str]
) -> Trace | None:
    """Return the trace of a table with a record, without units and meta; None if the record is empty.

    Args:
        times: (n,) times of the rows [s].
        channels: name → (n,) or (n, k).
        record: the record.
        names: name of a channel → its name in the record.

    Raises:
        TraceError: the record is of a newer version, or does not fit the table.
    """
    if not record:
        return None
    if record.get("version") != VERSION:
        raise TraceError(
            f"its record of own samples has version {record.get('version')!r}; s2r reads {VERSION}"
        )
    with _fitting():
        if "masks" in record:
            masks = {
                name: _unpack(record["masks"][names[name]], times.size)
                for name in channels
                if names[name] in record["masks"]
            }
            return Trace(times, channels, masks=masks)
        messages = {}
        for name, values in channels.items():
            one = record["messages"][names[name]]
            own = _unpack(one["own"], times.size)
            numbers = {key: float(one[key]) for key in _NUMBERS if key in one}
            spans = tuple(
                (-math.inf if start is None else float(start), math.inf if end is None else float(end))
                for start, end in one.get("invalid", ())
            )
            messages[name] = Messages(
                times[own], values[own], linear=bool(one["linear"]), invalid=spans, **numbers
            )
        return Trace.of_messages(messages, since=record.get("since"), until=record.get("until"))


def _pack(mask: BoolArray) -> str:
    return base64.b64encode(np.packbits(mask).tobytes()).decode()


def _unpack(text: str, count: int) -> BoolArray:
    bits = np.unpackbits(np.frombuffer(base64.b64decode(text, validate=True), dtype=np.uint8))
    if not count <= bits.size < count + 8:
        raise ValueError(
            f"{bits.size} bits for {count} rows; the rows of a part have no record: clear a frame's attrs"
        )
    return bits[:count].astype(bool)
