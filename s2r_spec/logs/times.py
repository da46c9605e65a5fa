"""The times of a trace, from the column or the two columns that hold them: the one place where their unit is decided.

Data: counts, numbers, durations, dates or texts. The unit is what the type, the header or ``--time-unit`` says;
else what the name of the column says; else the second, unless the numbers cannot be seconds since 1970.
Dates, and counts since 1970 in a unit other than the second, count from the first sample: whole numbers are
subtracted before they are rounded. Numbers in seconds stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec import stamps
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.instants import DATES
from s2r_spec.logs import cells, dates, time_units
from s2r_spec.logs.table import Column, Head, quoted

TIME = "t"
FloatArray = NDArray[np.float64]
Place = Callable[[int], str]


@dataclass(frozen=True)
class Times:
    """Stamps of a trace.

    Args:
        seconds: (n,) [s].
        first: the first stamp as it is in the file; what the rest of a trace that comes row by row counts from.
        begins: the date, or the time of a machine's clock, from which they count; "" if they stay as they are.
        notes: what was taken from the name of the column, a sentence.
    """

    seconds: FloatArray
    first: Any
    begins: str = ""
    notes: tuple[str, ...] = ()


def unit_of_option(text: str | None) -> str | None:
    """Return the unit after a look whether it is one of time.

    Raises:
        UsageError: it is not.
    """
    if text is not None and time_units.size(text) is None:
        raise UsageError(f"{text!r} is no unit of time; write s, ms, us, ns or min")
    return text


def read(
    columns: Sequence[Column], heads: Sequence[Head], unit: str | None, place: Place, first: Any = None
) -> Times:
    """Return the times that one column holds, or two: whole seconds, and what is below them.

    Args:
        columns: the one or two of them.
        heads: of the same.
        unit: of plain numbers, as the user states it; None if not.
        place: number of a sample → where it is in the file.
        first: of a trace whose first samples were read before, :attr:`Times.first`.

    Raises:
        TraceError: a stamp is missing or no time, units contradict each other, or the numbers cannot be seconds.
    """
    columns = [_flat(column) for column in columns]
    for column, head in zip(columns, heads, strict=True):
        _usable(column, head, place)
    if len(columns) == 2:
        return _pair(columns, heads, unit, first)
    (column,), (head,) = columns, heads
    values = column.values
    if column.texts:
        numbers = cells.parsed(list(values))
        values = dates.nanoseconds(values, place) if numbers.dtype == object else numbers
    if values.dtype.kind == "b":
        raise TraceError(f"the column {quoted(head.text)} holds truth values; it cannot hold the times")
    if stamps.is_typed(values):
        return _typed(values, unit, first)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        bad = int(np.argmin(np.isfinite(values)))
        what = "has no time in it" if np.isnan(values[bad]) else f"is {values[bad]}, not a time"
        raise TraceError(f"{place(bad)} {what}")
    return _counts(values, head, unit, first)


def _flat(column: Column) -> Column:
    """Return a column of vectors of one component, as Matlab has them, as one of numbers."""
    one = column.values.ndim == 2 and column.values.shape[1] == 1
    return replace(column, values=column.values[:, 0]) if one else column


def _usable(column: Column, head: Head, place: Place) -> None:
    if column.fault:
        raise TraceError(f"{quoted(head.text)} {column.fault}; it cannot hold the times")
    if column.values.ndim != 1:
        raise TraceError(f"{quoted(head.text)} holds vectors; it cannot hold the times")
    if column.missing is not None and column.missing.any():
        raise TraceError(f"{place(int(np.argmax(column.missing)))} has no time in it")


def _typed(values: NDArray[Any], unit: str | None, first: Any) -> Times:
    """Return the seconds of dates or durations."""
    dated = values.dtype.kind == "M"
    if unit is not None:
        raise TraceError(
            f"the times are {'dates' if dated else 'durations'}, which say their unit; leave out the unit {unit!r}"
        )
    seconds = stamps.seconds(values, first)
    start = values[0] if first is None and values.size else first
    return Times(seconds, start, dates.text(start) if dated and start is not None else "")


def _pair(columns: Sequence[Column], heads: Sequence[Head], unit: str | None, first: Any) -> Times:
    """Return the seconds of whole seconds and of what is below them."""
    if unit is not None:
        raise TraceError(
            f"the times are in {quoted(heads[0].text)} and {quoted(heads[1].text)}, which say their units; "
            f"leave out the unit {unit!r}"
        )
    below = time_units.SUB.get(time_units.last_word(heads[1].name), "ns")
    size = Fraction(time_units.size(heads[1].unit or below) or Fraction(1, 10**9))
    most = int(1 / size)
    whole, parts = (_whole(column, head) for column, head in zip(columns, heads, strict=True))
    if ((parts < 0) | (parts >= most)).any():
        bad = int(np.argmax((parts < 0) | (parts >= most)))
        raise TraceError(
            f"{quoted(heads[1].text)} is {parts[bad]} at sample {bad}; what is below a second is from 0 to {most - 1}"
        )
    if whole.size and np.abs(whole).max() > 2**62 // most:
        raise TraceError(f"{quoted(heads[0].text)} holds numbers that are no seconds since 1970")
    return _since(whole * most + parts, size, first)


def _whole(column: Column, head: Head) -> NDArray[np.int64]:
    values = cells.parsed(list(column.values)) if column.texts else column.values
    if values.dtype.kind == "f" and np.isfinite(values).all() and (values == np.round(values)).all():
        values = values.astype(np.int64)
    if values.dtype.kind not in "iu":
        raise TraceError(f"{quoted(head.text)} does not hold whole numbers, which one part of a time is")
    return values.astype(np.int64)


def _counts(values: NDArray[Any], head: Head, unit: str | None, first: Any) -> Times:
    """Return the seconds of plain numbers."""
    size, notes = _size(head, unit)
    if size is None:
        ends = [values[0], values[-1]] if values.size and first is None else []
        likely = next(filter(None, (time_units.looks_like(float(end)) for end in ends)), None)
        if likely is not None:
            raise TraceError(
                f"the times of {quoted(head.text)} begin at {values[0]} and are no seconds since 1970, but "
                f"look like {likely}: give --time-unit {likely} (or s for seconds)"
            )
        size = Fraction(1)
    found = _since(values, size, first)
    return Times(found.seconds, found.first, found.begins, notes)


def _since(values: NDArray[Any], size: Fraction, first: Any) -> Times:
    """Return the seconds of counts, from the first one if they are dates."""
    start = values[0] if first is None and values.size else first
    dated = start is not None and stamps.dates(np.array([start]), size)
    seconds = stamps.counted(values, size, from_first=dated, first=start)
    if not dated:
        return Times(seconds, start)
    since = Fraction(start.item()) * size
    if DATES <= since < dates.LAST:
        return Times(seconds, start, dates.text(np.datetime64(int(since * 10**9), "ns")))
    return Times(seconds, start, f"{float(since):.9g} s")


def _size(head: Head, unit: str | None) -> tuple[Fraction | None, tuple[str, ...]]:
    """Return the unit of a column's numbers [s], None if nothing says it, and a note if its name alone does."""
    stated = None if unit is None else time_units.size(unit)
    declared = head.unit if head.unit is not None else time_units.in_brackets(head.name)
    if declared is not None:
        size = time_units.size(declared)
        if size is None:
            raise TraceError(
                f"the times are in {quoted(declared)}, which is no unit of time; write for example t [ms]"
            )
        if stated is not None and stated != size:
            raise TraceError(
                f"the file has its times in {declared}, but {unit} is stated: leave the unit out"
            )
        return size, ()
    if stated is not None:
        return stated, ()
    name = time_units.said(head.name)
    if name is None:
        return None, ()
    note = () if name == "s" else (f"the times are read in {name}, as the name {quoted(head.name)} says",)
    return time_units.size(name), note
