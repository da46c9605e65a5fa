"""Read the times of a trace from one or two columns, and decide their unit.

Data: counts, numbers, durations or dates, typed or as text. The unit comes from the type, the header or
``--time-unit``; else from the name of the column. Otherwise it is the second, unless the numbers are too large for
seconds since 1970. Dates, times of day, and counts since 1970 in a unit other than the second count from the first
sample: whole numbers are subtracted before they are rounded. Numbers in seconds stay unchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError
from s2r_spec.logs import cells
from s2r_spec.logs.options import TIME
from s2r_spec.logs.table import Column, Head, quote
from s2r_spec.logs.times import dates, durations, time_units
from s2r_spec.logs.times.durations import ClockTime
from s2r_spec.trace import stamps
from s2r_spec.trace.instants import DATES
from s2r_spec.trace.samples import FAST, SLOW

Place = Callable[[int], str]


@dataclass(frozen=True)
class Times:
    """The times of a trace.

    Args:
        seconds: (n,) times [s].
        first: the first stamp as in the file; later rows of a followed trace count from it.
        begins: the date or clock time from which the times count; "" if they are unchanged.
        notes: a note if the unit comes from the name of the column.
        since: the date from which the times count, in seconds since 1970, exactly; None if they are no dates.
        stated: whether the type, the header, the name or the user states the unit; else it is taken to be the second.
    """

    seconds: FloatArray
    first: Any
    begins: str = ""
    notes: tuple[str, ...] = ()
    since: Fraction | None = None
    stated: bool = True


def read(
    columns: Sequence[Column], heads: Sequence[Head], unit: str | None, place: Place, first: Any = None
) -> Times:
    """Return the times in one column, or in two with whole seconds and fractions.

    Args:
        columns: one or two columns.
        heads: their heads.
        unit: unit of plain numbers that the user states, if any.
        place: sample number → its place in the file.
        first: :attr:`Times.first` of a trace whose first samples were read before.

    Raises:
        TraceError: a stamp is missing or no time, units contradict each other, or the numbers are too large for
            seconds.
    """
    columns = [  # MATLAB writes numbers as vectors of one component
        replace(one, values=one.values[:, 0]) if one.values.shape[1:] == (1,) else one for one in columns
    ]
    for column, head in zip(columns, heads, strict=True):
        _check_usable(column, head, place)
    if len(columns) == 2:
        return _pair(columns, heads, unit, first)
    (column,), (head,) = columns, heads
    values = column.values
    if column.texts:
        numbers = cells.parse(list(values))
        if numbers.dtype == object and durations.is_one(values[0]):
            return _durations(values, unit, place, first)
        if numbers.dtype == object:
            _refuse_odd_cell(values, place)
            numbers = dates.nanoseconds(values, place)
        values = numbers
    _check_form(values, first, column.values, place)
    if values.dtype.kind == "b":
        raise TraceError(f"the column {quote(head.text)} holds truth values; map t to a column of times")
    if stamps.is_typed(values):
        return _read_typed(values, unit, first)
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        bad = int(np.argmin(np.isfinite(values)))
        fault = "has no time" if np.isnan(values[bad]) else f"is {values[bad]}, not a time"
        raise TraceError(f"{place(bad)} {fault}")
    return _counts(values, head, unit, first)


def _refuse_odd_cell(texts: NDArray[Any], place: Place) -> None:
    number = np.array([cells.parse([text]).dtype != object for text in texts])
    if 2 * number.sum() > number.size:
        bad = int(np.argmin(number))
        raise TraceError(f"{place(bad)} is {quote(str(texts[bad]))}, and the other times are numbers")


def _check_usable(column: Column, head: Head, place: Place) -> None:
    if column.fault:
        raise TraceError(f"{quote(head.text)} {column.fault}; map t to a column of times")
    if column.values.ndim != 1:
        raise TraceError(f"{quote(head.text)} holds vectors; map t to a column of times")
    if column.missing is not None and column.missing.any():
        raise TraceError(f"{place(int(np.argmax(column.missing)))} has no time")


def _read_typed(values: NDArray[Any], unit: str | None, first: Any) -> Times:
    dated = values.dtype.kind == "M"
    if unit is not None:
        raise TraceError(
            f"the times are {'dates' if dated else 'durations'}, which state their unit; leave out time-unit {unit!r}"
        )
    seconds = stamps.seconds(values, first)
    start = values[0] if first is None and values.size else first
    if not dated or start is None:
        return Times(seconds, start)
    since = Fraction(int(start.astype("M8[ns]").astype(np.int64)), 10**9)
    return Times(seconds, start, dates.text(start), since=since)


def _durations(texts: NDArray[Any], unit: str | None, place: Place, first: Any) -> Times:
    """Return the times of durations as text; those of a clock without a date count from the first one."""
    values = durations.nanoseconds(texts, place)
    clock = durations.of_clock(texts[0])
    _check_form(ClockTime(0) if clock else values, first, texts, place)
    if not clock:
        return _read_typed(values, unit, first)
    start = ClockTime(int(values[0].astype(np.int64))) if first is None else first
    counts = np.concatenate(([start.count], values.astype(np.int64)))
    if (np.diff(counts) < 0).any():
        back = int(np.argmax(np.diff(counts) < 0))
        raise TraceError(
            f"{place(back)} is {texts[back]!r}, before the time of day above it. If midnight lies between, write the "
            f"date before each time"
        )
    times = _read_typed(values - np.timedelta64(start.count, "ns"), unit, np.timedelta64(0, "ns"))
    return replace(times, first=start, begins=str(start))


def _check_form(values: Any, first: Any, written: NDArray[Any], place: Place) -> None:
    """Refuse a time of another form than the first one of a trace that is read row by row."""
    if first is not None and _form(values) != _form(first):
        raise TraceError(
            f"{place(0)} is {str(written[0])!r}, and the first time is {str(first)!r}; write all times in one form"
        )


def _form(values: Any) -> str:
    """Return the form of times: of a clock, dates (M), durations (m) or numbers ("")."""
    return "clock" if isinstance(values, ClockTime) else np.asarray(values).dtype.kind.strip("iufb")


def _pair(columns: Sequence[Column], heads: Sequence[Head], unit: str | None, first: Any) -> Times:
    if unit is not None:
        raise TraceError(
            f"the times are in {quote(heads[0].text)} and {quote(heads[1].text)}, which state their units; "
            f"leave out time-unit {unit!r}"
        )
    below = time_units.SUB.get(time_units.last_word(heads[1].name), "ns")
    size = Fraction(time_units.size(heads[1].unit or below) or Fraction(1, 10**9))
    most = int(1 / size)
    whole, parts = (_whole_numbers(column, head) for column, head in zip(columns, heads, strict=True))
    if ((parts < 0) | (parts >= most)).any():
        bad = int(np.argmax((parts < 0) | (parts >= most)))
        raise TraceError(
            f"{quote(heads[1].text)} is {parts[bad]} at sample {bad}; a fraction of a second must be from 0 to "
            f"{most - 1}"
        )
    if whole.size and np.abs(whole).max() > 2**62 // most:
        raise TraceError(f"{quote(heads[0].text)} holds numbers too large for seconds since 1970")
    return _since(whole * most + parts, size, first)


def _whole_numbers(column: Column, head: Head) -> NDArray[np.int64]:
    values = cells.parse(list(column.values)) if column.texts else column.values
    if values.dtype.kind == "f" and np.isfinite(values).all() and (values == np.round(values)).all():
        values = values.astype(np.int64)
    if values.dtype.kind not in "iu":
        raise TraceError(f"{quote(head.text)} is one of two columns of times; it must hold whole numbers")
    return values.astype(np.int64)


def _counts(values: NDArray[Any], head: Head, unit: str | None, first: Any) -> Times:
    size, notes = _size(head, unit)
    stated = size is not None
    if head.name == TIME:  # the times of a trace are in seconds unless they say so, if they look like seconds
        steps = np.abs(np.diff(values.astype(np.float64)))
        stated = stated or not steps.size or FAST < float(np.median(steps)) < SLOW
    if size is None:
        ends = [values[0], values[-1]] if values.size and first is None else []
        likely = next(filter(None, (time_units.looks_like(float(end)) for end in ends)), None)
        if likely is not None or any(abs(float(end)) >= time_units.TOO_LARGE for end in ends):
            way = (
                f"they look like {likely}: add --time-unit {likely}" if likely else "state their --time-unit"
            )
            raise TraceError(
                f"the times of {quote(head.text)} begin at {values[0]}, too large for seconds since 1970; {way} "
                f"(or s for seconds)"
            )
        size = Fraction(1)
        notes = _assumption_notes(values, head) if first is None else ()
    times = _since(values, size, first)
    return replace(times, notes=notes, stated=stated)


def _assumption_notes(values: NDArray[Any], head: Head) -> tuple[str, ...]:
    """Return a note if whole numbers without a unit are taken for seconds, as those of a column ``t`` are."""
    if head.name == TIME or values.size < 2 or not (values == np.round(values)).all():
        return ()
    step = float(np.median(np.diff(values)))
    return (
        f"the times of {quote(head.text)} are whole numbers without a unit, {step:g} apart, and are read in seconds; "
        f"if they are in ms, add --time-unit ms",
    )


def _since(values: NDArray[Any], size: Fraction, first: Any) -> Times:
    start = values[0] if first is None and values.size else first
    dated = start is not None and stamps.dates(np.array([start]), size)
    seconds = stamps.to_seconds(values, size, from_first=dated, first=start)
    if not dated:
        return Times(seconds, start)
    since = Fraction(start.item()) * size
    if DATES <= since < dates.LAST:
        return Times(seconds, start, dates.text(np.datetime64(int(since * 10**9), "ns")), since=since)
    return Times(seconds, start, f"{float(since):.9g} s", since=since)


def _size(head: Head, unit: str | None) -> tuple[Fraction | None, tuple[str, ...]]:
    """Return the unit of a column's numbers [s], or None; and a note if only the column's name states it."""
    stated = None if unit is None else time_units.size(unit)
    declared = head.unit
    if declared is None and (split := time_units.split_brackets(head.name)) is not None:
        declared = split[1] if time_units.size(split[1]) is not None else None
    if declared is not None:
        size = time_units.size(declared)
        if size is None:
            raise TraceError(
                f"the times are in {quote(declared)}, which is not a unit of time; write a header such as t [ms]"
            )
        if stated is not None and stated != size:
            raise TraceError(
                f"the file has its times in {declared}, but time-unit is {unit}: leave time-unit out"
            )
        return size, ()
    if stated is not None:
        return stated, ()
    word = time_units.last_word(head.name)
    if word in time_units.WHOLE:
        return Fraction(1), ()
    if (name := time_units.SUB.get(word)) is None:
        return None, ()
    return time_units.size(name), (
        f"the times are read in {name}, the unit in the column name {quote(head.name)}",
    )
