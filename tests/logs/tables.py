"""The same table as a file of each format, written without s2r: what other tools leave behind."""

from __future__ import annotations

import csv
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

ENDINGS = [".csv", ".npz", *([".parquet"] if find_spec("pyarrow") else [])]


def write(path: Path, **columns: Any) -> Path:
    """Write columns as a file; a name's ``__`` is a point. None is a missing value, an array (n, k) vectors."""
    return written(path, {name.replace("__", "."): values for name, values in columns.items()})


def written(path: Path, columns: dict[str, Any]) -> Path:
    """Write columns, by name, as a file of the format that its ending says."""
    if path.suffix == ".csv":
        _csv(path, columns)
    elif path.suffix == ".npz":
        np.savez(path, **{name: _array(values) for name, values in columns.items()})
    else:
        import pyarrow
        import pyarrow.parquet

        table = {
            name: values if _flat(values) else list(map(list, values)) for name, values in columns.items()
        }
        pyarrow.parquet.write_table(pyarrow.table(table), path)
    return path


def _flat(values: Any) -> bool:
    return np.ndim(np.asarray(values, dtype=object)) == 1


def _array(values: Any) -> np.ndarray:
    if any(value is None for value in values):
        known = next(value for value in values if value is not None)
        return np.array([("" if isinstance(known, str) else np.nan) if v is None else v for v in values])
    return np.asarray(values)


def _csv(path: Path, columns: dict[str, Any]) -> None:
    names, parts = [], []
    for name, values in columns.items():
        if _flat(values):
            names.append(name)
            parts.append(["" if value is None else _text(value) for value in values])
        else:
            for k, one in enumerate(np.asarray(values).T):
                names.append(f"{name}[{k}]")
                parts.append([_text(value) for value in one])
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows([names, *zip(*parts, strict=True)])


def _text(value: Any) -> str:
    return (
        str(value)
        if isinstance(value, str | np.datetime64 | np.bool_ | bool)
        else repr(np.asarray(value).item())
    )
