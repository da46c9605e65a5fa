"""Read and extend the tables in a folder of tests; a table is replaced whole or not at all."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from s2r_spec.backend import Parameter
from s2r_spec.base.errors import UsageError
from s2r_spec.base.files import save


def header(parameters: Sequence[Parameter]) -> list[str]:
    """Return the header of ``rollouts.csv``: ``id, vd [m/s], …, seed``."""
    return ["id", *(f"{p.name} [{p.unit}]" if p.unit else p.name for p in parameters), "seed"]


def read(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return the header and the rows of a table, both empty if there is no file; a UsageError if it cannot be read."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        rows = [row for row in csv.reader(io.StringIO(text, newline=""), skipinitialspace=True) if any(row)]
    except FileNotFoundError:
        return [], []
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"cannot read {path}: {error}") from None
    return (rows[0], rows[1:]) if rows else ([], [])


def ids(path: Path) -> list[str]:
    """Return the first cell of every row."""
    return [row[0] for row in read(path)[1]]


def add(path: Path, names: Sequence[str], row: Sequence[str]) -> None:
    """Add a row to a table, or raise a UsageError and leave it unchanged; ``names`` is the header of a new one."""
    columns, rows = read(path)
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([columns or names, *rows, row])
    save(path, text.getvalue())
