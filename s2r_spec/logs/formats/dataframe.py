"""Data frames: tables of pandas and polars, Arrow tables, and datasets of xarray.

A frame is read as a file with the same columns is: :mod:`s2r_spec.logs.interpret` gives the columns their meaning.
Arrow is the common form: a frame hands over its columns through the Arrow interface (``__arrow_c_stream__``).

A vector has one column for each component, ``q[0]``, ``q[1]``. Units and meta are in ``attrs`` of a pandas frame, and
in the metadata of an Arrow table. A polars frame has no place for them.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from s2r_spec.base.errors import NoTimesError, TraceError, UsageError, one_of, suggest
from s2r_spec.logs.formats.csv_format import head_of
from s2r_spec.logs.formats.parquet_format import NOTES, as_column, in_one_piece
from s2r_spec.logs.interpret import Loaded, build_trace, request
from s2r_spec.logs.library import library
from s2r_spec.logs.mapping import ColumnRequest, plan_columns
from s2r_spec.logs.options import TIME
from s2r_spec.logs.own import description, rows
from s2r_spec.logs.table import Column, Head, Table, places_in, read_description
from s2r_spec.logs.time_columns import time_candidates
from s2r_spec.logs.times.candidates import of_table
from s2r_spec.trace import Trace

Library = Literal["pandas", "polars", "pyarrow"]
"""Where a frame comes from."""


def read(
    frame: Any, time: str | None = None, units: Mapping[str, str] | None = None, time_unit: str | None = None
) -> Loaded:
    """Return the trace of a frame, with notes for the user.

    Args:
        frame: a DataFrame of pandas or polars, an Arrow table, or another object with the Arrow interface.
        time: name of the column, or of the index, with the times; None for the column ``t``, or else for an index of
            times.
        units: channel → unit, on top of the units that the frame states.
        time_unit: unit of times that are plain numbers; None for seconds, or for the unit in the column's name.

    Raises:
        TraceError: the frame has no valid times, or a unit is for no channel.
        UsageError: it is not a frame, or ``time_unit`` is not a unit of time.
    """
    pandas = sys.modules.get("pandas")  # a frame of pandas has loaded it
    of_pandas = pandas is not None and isinstance(frame, pandas.DataFrame)
    heads, columns, notes = _pandas(frame, time) if of_pandas else _arrow(frame)
    noted, meta, own = read_description(notes, "attrs of the frame")
    names = {head.name for head in heads}
    user_units = dict(units or {})
    if unknown := sorted(user_units.keys() - names):
        raise TraceError(
            f"a unit is given for {unknown[0]!r}, which the frame does not have"
            f"{suggest(unknown[0], names)} it has {one_of(names)}"
        )
    stated = noted | user_units
    heads = tuple(replace(head, unit=stated.get(head.name, head.unit)) for head in heads)
    place = places_in(heads, "row {} of the column {}")
    table = Table(heads, dict(enumerate(columns)), meta, place, own=own)
    plan_request = request({TIME: _times(heads, time)}, None, time_unit)
    try:
        loaded = build_trace(table, plan_columns(heads, plan_request), plan_request)
        return replace(loaded, notes=tuple(map(_in_python, loaded.notes)))
    except NoTimesError as error:
        rivals = {one: plan_columns(heads, ColumnRequest({TIME: one}, {})).times for one in error.candidates}
        raise TraceError(_in_python(str(of_table(table, rivals, time_unit) if rivals else error))) from None
    except TraceError as error:
        raise TraceError(_in_python(str(error))) from None


def _times(heads: tuple[Head, ...], time: str | None) -> str:
    names = [head.text for head in heads]
    likely = time_candidates(heads)
    stem, _, _ = (time or TIME).partition("+")
    if any(name.startswith(stem) for name in names) or (time is None and len(likely) > 1):
        return time or TIME
    raise TraceError(
        f"the frame has no column {time or TIME!r} with the times{suggest(time or TIME, names)} it has "
        f"{one_of(names)}; name the column or the index of its times, such as time={next(iter(likely), 'stamp')!r}"
    )


def _in_python(text: str) -> str:
    """Return an error of the readers of files with the arguments of Python in place of the command's options."""
    text = re.sub(r"--time-unit (\w+)", r'time_unit="\1"', text)
    text = re.sub(r"--map '?t=([^']+?)'?$", r"time='\1'", text)
    text = text.replace("the file has", "the frame has")
    return text.replace("map t to a column of times", "name a column of times, as time=…")


def _pandas(frame: Any, time: str | None) -> tuple[tuple[Head, ...], list[Column], dict[str, Any]]:
    """Return the columns of a pandas frame, with its index as the first one if that holds times."""
    arrow = _pyarrow()
    series = [(str(name), frame.iloc[:, number]) for number, name in enumerate(frame.columns)]
    index = frame.index
    if index.nlevels > 1:
        raise TraceError(
            f"the frame has an index of {index.nlevels} levels; make columns of them by reset_index()"
        )
    own = index.name is not None and index.name in (TIME, time)
    typed = index.dtype.kind in "mM" or hasattr(index.dtype, "tz")
    if own or (typed and time is None and TIME not in frame.columns):
        series.insert(0, (TIME if time is None else str(index.name), index))
    columns = [_of_series(arrow, values) for _, values in series]
    notes = {key: frame.attrs[key] for key in ("units", "meta", "own") if key in frame.attrs}
    return tuple(head_of(name) for name, _ in series), columns, notes


def _of_series(arrow: Any, values: Any) -> Column:
    try:
        array = arrow.array(values, from_pandas=True)
    except (arrow.ArrowException, TypeError, ValueError, OverflowError):
        return Column.without("holds Python objects that are not numbers; convert it by pd.to_numeric")
    return _column(arrow, array)


def _arrow(frame: Any) -> tuple[tuple[Head, ...], list[Column], dict[str, Any]]:
    if hasattr(frame, "collect") and not hasattr(frame, "__arrow_c_stream__"):
        raise UsageError(f"a {type(frame).__name__} holds no data yet; give frame.collect()")
    if not hasattr(frame, "__arrow_c_stream__") or type(frame).__name__ == "Series":
        raise UsageError(
            f"frame must be a DataFrame of pandas or polars, or an Arrow table, not a value of type "
            f"{type(frame).__name__}"
        )
    arrow = _pyarrow()
    try:
        table = arrow.table(frame)
    except (arrow.ArrowException, TypeError, ValueError) as error:
        raise TraceError(f"the frame does not become an Arrow table: {error}") from None
    columns = [_column(arrow, in_one_piece(arrow, one)) for one in table.columns]
    try:
        notes = json.loads((table.schema.metadata or {}).get(NOTES, b"{}"))
    except ValueError as error:
        raise TraceError(f"the metadata 's2r' of the frame is not JSON: {error}") from None
    return tuple(map(head_of, table.column_names)), columns, notes


def _column(arrow: Any, values: Any) -> Column:
    if arrow.types.is_string_view(values.type):
        values = values.cast(arrow.string())
    return as_column(arrow, values)


def _pyarrow() -> Any:
    library("pyarrow.compute", "data frames")
    return library("pyarrow", "data frames")


def frame_of(trace: Trace, package: Library = "pandas") -> Any:
    """Return a frame with a column for each channel, and for each component of a vector.

    Args:
        trace: the trace.
        package: library of the frame. A frame of pandas has the times as its index, the others as the column ``t``.

    Raises:
        TraceError: the library is not installed, or two columns would have one name.
        UsageError: there is no such library.
    """
    if package not in get_args(Library):
        raise UsageError(
            f"no data frame is called {package!r}; the libraries are {one_of(get_args(Library))}"
        )
    times, channels, record = rows(trace)
    parts: list[tuple[str, Any]] = []
    for name, values in channels.items():
        if values.ndim == 1:
            parts.append((name, values))
        else:
            parts += [(f"{name}[{k}]", values[:, k]) for k in range(values.shape[1])]
    names = [TIME, *(name for name, _ in parts)]
    if twice := [name for name in names if names.count(name) > 1]:
        raise TraceError(f"two columns of the frame would be called {twice[0]!r}; rename a channel first")
    columns, notes = dict(parts), description(trace, record)
    if package == "polars":
        return library("polars", "frames of polars").DataFrame({TIME: times, **columns})
    if package == "pandas":
        pandas = library("pandas", "frames of pandas")
        frame = pandas.DataFrame(columns, index=pandas.Index(times, name=TIME))
        frame.attrs.update({key: value for key, value in notes.items() if value})
        return frame
    plain = {name: np.ascontiguousarray(values) for name, values in columns.items()}
    table = _pyarrow().table({TIME: times, **plain})
    return table.replace_schema_metadata({NOTES: json.dumps(notes).encode()})


def dataset_of(trace: Trace) -> Any:
    """Return an xarray Dataset: dimension ``t`` [s], and ``<channel>_component`` for a vector; units in ``attrs``.

    Raises:
        TraceError: xarray is not installed, or a channel is called ``t``.
    """
    xarray = library("xarray", "datasets")
    if TIME in trace.channels:
        raise TraceError(f"a channel of a dataset cannot be called {TIME!r}; rename it first")
    variables = {
        name: (
            (TIME,) if values.ndim == 1 else (TIME, f"{name}_component"),
            values.copy(),
            {"units": trace.units[name]} if name in trace.units else {},
        )
        for name, values in trace.channels.items()
    }
    times = (TIME, trace.times.copy(), {"units": "s"})
    return xarray.Dataset(variables, coords={TIME: times}, attrs=dict(trace.meta))
