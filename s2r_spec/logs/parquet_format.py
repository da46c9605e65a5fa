"""Apache Parquet: a column ``t`` [s], one a channel, vectors as lists of one length; units and meta beside.

Needs pyarrow, the extra ``logs``. Units and meta are the text ``s2r`` of the
file's own metadata; other tools read such a file as a plain table.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import TraceError, one_of
from s2r_spec.logs.times import TIME as _TIME
from s2r_spec.logs.times import no_times
from s2r_spec.trace import Trace

_NOTES = b"s2r"


def read(path: Path, time: str = _TIME) -> Trace:
    """Read a file of :func:`write`, or any other of numbers, one column of which holds the times."""
    arrow, parquet = _libraries()
    try:
        table = parquet.read_table(path)
    except arrow.ArrowInvalid as error:
        raise TraceError(f"this is not a Parquet file: {error}") from None
    if time not in table.column_names:
        raise TraceError(no_times("column", time, one_of(table.column_names)))
    notes = json.loads((table.schema.metadata or {}).get(_NOTES, b"{}"))
    columns = {name: _array(name, table.column(name)) for name in table.column_names}
    times = columns.pop(time)
    return Trace(times, columns, notes.get("units", {}), notes.get("meta", {}))


def _array(name: str, column: Any) -> NDArray[Any]:
    if column.null_count:
        raise TraceError(f"column {name!r} has {column.null_count} missing values; none is filled in")
    values: NDArray[Any] = column.to_numpy()
    if values.dtype != object:
        return values
    try:
        return np.stack([np.asarray(row, dtype=np.float64) for row in values])
    except (TypeError, ValueError):
        raise TraceError(
            f"column {name!r} holds neither numbers nor lists of numbers of one length"
        ) from None


def write(trace: Trace, path: Path) -> None:
    """Write a trace."""
    arrow, parquet = _libraries()
    if _TIME in trace.channels:
        raise TraceError(f"a channel cannot be called {_TIME!r} in a .parquet file")
    columns = {_TIME: arrow.array(trace.times)}
    for name, values in trace.channels.items():
        flat = arrow.array(values.reshape(-1))
        columns[name] = (
            flat if values.ndim == 1 else arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])
        )
    notes = json.dumps({"units": dict(trace.units), "meta": dict(trace.meta)}).encode()
    table = arrow.table(columns).replace_schema_metadata({_NOTES: notes})
    parquet.write_table(table, path)


def _libraries() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise TraceError(
            "Parquet files need the package pyarrow, which is not installed; try: pip install 's2r[logs]'"
        ) from None
    return pyarrow, pyarrow.parquet
