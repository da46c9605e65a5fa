"""Apache Parquet: a column ``t`` [s], and one column per channel, with vectors as lists of equal length.

Needs pyarrow, the extra ``logs``. Units and meta are in the file's metadata under the key ``s2r``; other tools read
the file as a plain table. A field of a structure is a column of its own, such as ``header.stamp.sec``.
"""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from s2r_spec.base.errors import TraceError, shortened
from s2r_spec.logs import cells, own
from s2r_spec.logs import table as parsed
from s2r_spec.logs.library import library
from s2r_spec.logs.table import Chooser, Column, Head, Table, check_size, quote
from s2r_spec.trace import Trace

NOTES = b"s2r"
"""Definition: key of the metadata with units and meta."""
_ROWS = 8192
"""Budget: rows of one read."""


def load(path: Path, choose: Chooser) -> Table:
    """Read the chosen columns of a file.

    Raises:
        TraceError: the file is not a Parquet file, or is damaged.
        OSError: the file cannot be read.
    """
    arrow, parquet = _libraries()
    parsed.check_file(path)
    try:
        with parquet.ParquetFile(path) as file:
            return _table(arrow, file, choose)
    except (arrow.ArrowException, OSError, MemoryError, UnicodeDecodeError) as error:
        if getattr(error, "strerror", None) is not None:
            raise
        # pyarrow raises an OSError of its own for a damaged page
        raise TraceError(f"this is not a valid Parquet file: {shortened(str(error))}") from None


def _table(arrow: Any, file: Any, choose: Chooser) -> Table:
    parsed.check_columns(file.metadata.num_columns)
    notes = (file.metadata.metadata or {}).get(NOTES, b"{}")
    units, meta, record = parsed.parse_description(notes, "the metadata 's2r'")
    leaves = _leaves(arrow, file.schema_arrow)
    written = _units(file)
    heads = tuple(Head(name, None, units.get(name, written.get(name))) for name, _ in leaves)
    if unknown := set(units) - {head.name for head in heads}:
        raise TraceError(
            f"the metadata 's2r' has a unit for {quote(min(unknown))}, which is not a column of the file"
        )
    needed = sorted(set(choose(heads)))
    roots = {leaves[number][1][0] for number in needed}
    table = _read(arrow, file, sorted(roots))
    columns = {number: as_column(arrow, _leaf(arrow, table, leaves[number][1])) for number in needed}
    place = parsed.places_in(heads, "row {} of the column {}")
    return Table(heads, columns, meta, place, own=record)


def _units(file: Any) -> dict[str, str]:
    """Return column → unit, as the metadata of a field, or the ``attrs`` of a pandas frame, state it."""
    units: dict[str, str] = {}
    with suppress(ValueError, AttributeError):  # other metadata
        attributes = json.loads((file.metadata.metadata or {}).get(b"pandas", b"{}")).get("attributes") or {}
        units |= {name: unit for name, unit in attributes.get("units", {}).items() if isinstance(unit, str)}
    for field in file.schema_arrow:
        for key, value in (field.metadata or {}).items():
            if key.lower() in (b"unit", b"units"):
                units[field.name] = value.decode(errors="replace").strip()
    return units


def _leaves(arrow: Any, schema: Any) -> list[tuple[str, tuple[str, ...]]]:
    leaves: list[tuple[str, tuple[str, ...]]] = []

    def visit(field: Any, path: tuple[str, ...]) -> None:
        if arrow.types.is_struct(field.type):
            for number in range(field.type.num_fields):
                inner = field.type.field(number)
                visit(inner, (*path, inner.name))
        else:
            leaves.append((".".join(path), path))

    for field in schema:
        visit(field, (field.name,))
    return leaves


def _leaf(arrow: Any, table: Any, path: tuple[str, ...]) -> Any:
    column = in_one_piece(arrow, table.column(path[0]))
    for name in path[1:]:
        column = arrow.compute.struct_field(column, name)
    return column


def in_one_piece(arrow: Any, column: Any) -> Any:
    """Return a column of a table as one array."""
    return arrow.concat_arrays(column.chunks) if column.num_chunks else arrow.array([], column.type)


def _read(arrow: Any, file: Any, roots: list[str]) -> Any:
    """Return the columns as a table, read in parts, so that a compressed bomb is refused before it fills the memory.

    The sizes in the file's metadata are not used: if they are damaged, pyarrow ends the process.
    """
    check_size(file.metadata.num_rows * len(roots))
    batches, taken = [], 0
    for batch in file.iter_batches(batch_size=_ROWS, columns=roots, use_threads=False):
        for column in batch.columns:  # its memory in numbers of 8 bytes
            size = parsed.TEXT_SIZE if "string" in str(column.type) else 1
            taken += max(len(column) * size, int(column.nbytes) // 8)
        check_size(taken)
        batches.append(batch)
    if batches:
        return arrow.Table.from_batches(batches)
    return arrow.schema([file.schema_arrow.field(name) for name in roots]).empty_table()


def as_column(arrow: Any, column: Any) -> Column:
    """Return a column in the type that it has in the file."""
    kind, types = column.type, arrow.types
    if types.is_dictionary(kind):
        column = column.dictionary_decode()
        kind = column.type
    if types.is_null(kind):
        return Column(np.full(len(column), np.nan), np.ones(len(column), dtype=bool))
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        return _vectors(arrow, column)
    missing = np.asarray(column.is_null().to_numpy(zero_copy_only=False), dtype=bool)
    gaps = missing if missing.any() else None
    if types.is_string(kind) or types.is_large_string(kind):
        words = cells.words("" if word is None else word.strip() for word in column.to_pylist())
        return Column(words, cells.is_missing(words))
    if types.is_time(kind):  # a time of day is a duration since midnight
        column = column.cast(arrow.int64() if kind.bit_width == 64 else arrow.int32())
        values = np.asarray(column.fill_null(0).to_numpy(zero_copy_only=False), dtype=np.int64)
        return Column(values.view(f"m8[{kind.unit}]"), gaps)
    if types.is_decimal(kind):
        column = column.cast(arrow.float64())
    elif types.is_boolean(kind):
        column = column.fill_null(False)
    elif types.is_integer(kind):
        column = column.fill_null(0)
    elif not (types.is_floating(kind) or types.is_temporal(kind)):
        return Column.without(f"holds values of the type {kind}, not numbers")
    return Column(np.asarray(column.to_numpy(zero_copy_only=False)), gaps)


def _vectors(arrow: Any, column: Any) -> Column:
    """Return a column of (n, k) values from lists of equal length; a missing list becomes NaN."""
    lengths = column.value_lengths().fill_null(-1).to_numpy(zero_copy_only=False)
    missing = lengths < 0
    width = set(lengths[~missing].tolist())
    if len(width) > 1:
        return Column.without("holds lists of different lengths")
    inner = as_column(arrow, column.flatten())
    if inner.fault or inner.texts or inner.values.dtype.kind not in "biuf" or inner.values.ndim != 1:
        return Column.without("holds lists of values that are not numbers")
    values = np.full((len(column), width.pop() if width else 0), np.nan)
    flat = inner.values.astype(np.float64)
    if inner.missing is not None:
        flat[inner.missing] = np.nan
    values[~missing] = flat.reshape(-1, values.shape[1])
    return Column(values)


def write(trace: Trace, path: Path) -> None:
    """Write a trace."""
    arrow, parquet = _libraries()
    if "t" in trace.channels:
        raise TraceError("a channel cannot be called 't' in a .parquet file")
    times, channels, record = own.rows(trace)
    columns = {"t": arrow.array(times)}
    for name, values in channels.items():
        flat = arrow.array(values.reshape(-1))
        columns[name] = (
            flat if values.ndim == 1 else arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])
        )
    notes = json.dumps(own.description(trace, record)).encode()
    table = arrow.table(columns).replace_schema_metadata({NOTES: notes})
    parquet.write_table(table, path)


def _libraries() -> tuple[Any, Any]:
    arrow = library("pyarrow", "Parquet files")
    library("pyarrow.compute", "Parquet files")
    return arrow, library("pyarrow.parquet", "Parquet files")
