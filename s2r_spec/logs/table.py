"""What a file holds, before anything is decided: columns as found. The one form that every format is parsed to."""

from __future__ import annotations

import stat
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import TraceError, shortened

MOST_NUMBERS = 2**25
"""Budget: numbers that are read from one file, 34 million; near it s2r takes 0.8 GB, at twice as many 1.6 GB."""
TEXT_SIZE = 8
"""Definition: a text counts as so many numbers; Python keeps one in 60 bytes and more."""
MOST_COLUMNS = 100_000
"""Budget: columns of one file. Twice as many take twice the time to name, 2 s."""


@dataclass(frozen=True)
class Head:
    """What a file calls a column.

    Args:
        name: without unit and number.
        index: number of the component, where the format itself numbers those of a vector (``u[0]`` in CSV).
        unit: as written; None if none is.
    """

    name: str
    index: int | None = None
    unit: str | None = None

    @property
    def text(self) -> str:
        """The name with the number of the component."""
        return self.name if self.index is None else f"{self.name}[{self.index}]"


@dataclass(frozen=True)
class Column:
    """Values of a column, in the type they have in the file.

    Args:
        values: (n,) or (n, k) numbers, booleans, dates (M8), durations (m8), or texts (as objects).
        missing: (n,) where nothing is written; None if nowhere.
        fault: why there are no values, after the column's name; "" if there are.
    """

    values: NDArray[Any]
    missing: NDArray[np.bool_] | None = None
    fault: str = ""

    @classmethod
    def without(cls, fault: str) -> Column:
        """Return a column that cannot be used, with the reason."""
        return cls(np.zeros(0), fault=fault)

    @property
    def texts(self) -> bool:
        """Whether the values are texts."""
        return bool(self.values.dtype == object)


@dataclass(frozen=True)
class Table:
    """The parsed columns of a file.

    Args:
        heads: of all columns.
        columns: number of a head → its column, for those that were asked for.
        meta: what the file says of the whole rollout.
        notes: what the reader left out, each in a sentence.
        place: (number of a sample, number of a head) → where that is, such as "line 3, column 2 (vx)".
    """

    heads: tuple[Head, ...]
    columns: Mapping[int, Column]
    meta: Mapping[str, Any]
    place: Callable[[int, int], str]
    notes: Sequence[str] = field(default=())


Chooser = Callable[[tuple[Head, ...]], Iterable[int]]
"""Heads of a file → the numbers of those whose columns are to be read."""


def regular(path: Path) -> None:
    """Refuse what would hang or never end.

    Raises:
        OSError: there is no such file.
        TraceError: it is a pipe, a device or a folder.
    """
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise TraceError("this is a folder, not a file")
    if not stat.S_ISREG(mode):
        raise TraceError("this is a pipe or a device, not a file; copy what it gives to a file")


def affordable(numbers: int) -> None:
    """Refuse what would take all memory.

    Raises:
        TraceError: more numbers are to be read than :data:`MOST_NUMBERS`.
    """
    if numbers > MOST_NUMBERS:
        raise TraceError(
            f"{numbers / 1e6:,.0f} million numbers are to be read, and s2r reads {MOST_NUMBERS / 1e6:.0f} million "
            f"of one file at most; cut the log, or read fewer columns"
        )


def few(columns: int) -> None:
    """Refuse a file that is nothing but names.

    Raises:
        TraceError: it has more columns than :data:`MOST_COLUMNS`.
    """
    if columns > MOST_COLUMNS:
        raise TraceError(
            f"there are {columns:,} columns, and s2r reads {MOST_COLUMNS:,} at most; cut the table"
        )


def described(record: Any, what: str) -> tuple[dict[str, str], dict[str, Any]]:
    """Return units and meta of what a file of s2r says beside its columns.

    Raises:
        TraceError: it has another form.
    """
    if not isinstance(record, dict):
        raise TraceError(f"{what} is not a JSON object")
    units, meta = record.get("units", {}), record.get("meta", {})
    if not isinstance(units, dict) or not all(isinstance(unit, str) for unit in units.values()):
        raise TraceError(f'{what}: "units" must map names to texts, such as "m/s"')
    if not isinstance(meta, dict):
        raise TraceError(f'{what}: "meta" must be a JSON object')
    return units, meta


def quoted(name: str) -> str:
    """Return a name in quotes, shortened."""
    return repr(shortened(name))
