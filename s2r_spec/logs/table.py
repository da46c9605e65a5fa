"""The parsed content of a file, the same for every format: columns in the types that they have in the file."""

from __future__ import annotations

import json
import stat
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError, shortened
from s2r_spec.logs.account import Account

MOST_NUMBERS = 2**25
"""Budget: numbers read from one file, 34 million, which take 0.8 GB."""
TEXT_SIZE = 8
"""Definition: memory of a text, in numbers of 8 bytes; Python needs at least 60 bytes for one."""
MOST_COLUMNS = 100_000
"""Budget: columns of one file."""
INDEX = "Unnamed: 0"
"""Definition: pandas' name of a first column without one, which is often the index of a frame."""


@dataclass(frozen=True)
class Head:
    """The head of a column.

    Args:
        name: name without unit and number.
        index: number of the component, if the format numbers components of a vector (``u[0]`` in CSV); else None.
        unit: unit as written; None if there is none.
        fault: why the column cannot be read, as text after its name; "" if it can, as far as its head tells.
    """

    name: str
    index: int | None = None
    unit: str | None = None
    fault: str = ""

    @property
    def text(self) -> str:
        """Name with the number of the component."""
        return self.name if self.index is None else f"{self.name}[{self.index}]"


@dataclass(frozen=True)
class Column:
    """The values of a column, in the type that they have in the file.

    Args:
        values: (n,) or (n, k) numbers, booleans, dates (M8), durations (m8), or texts (as objects).
        missing: (n,) bool: whether each value is missing; None if none is.
        fault: why the column cannot be read, as text after its name; "" if it can.
        stamps: (n,) stamps of its own, not decreasing; None for those of the table's rows.
        log_end: stamp at which the log of these stamps ends; None if it is not known.
        linear: whether its values are linear between these stamps; else the last one is held.
    """

    values: NDArray[Any]
    missing: NDArray[np.bool_] | None = None
    fault: str = ""
    stamps: NDArray[Any] | None = None
    log_end: Any = None
    linear: bool = False

    @classmethod
    def without(cls, fault: str) -> Column:
        """Return a column that cannot be read, with the reason."""
        return cls(np.zeros(0), fault=fault)

    def only(self, kept: Any) -> Column:
        """Return some of the samples, by a slice, their numbers or a mask."""
        missing = None if self.missing is None else self.missing[kept]
        return replace(self, values=self.values[kept], missing=missing)

    @property
    def texts(self) -> bool:
        """Whether the values are texts."""
        return bool(self.values.dtype == object)


@dataclass(frozen=True)
class Table:
    """The parsed columns of a file.

    Args:
        heads: heads of all columns.
        columns: number of a head → its column, for the chosen columns.
        meta: meta of the trace.
        notes: notes on rows left out, one sentence each.
        place: (sample number, head number) → place in the file, such as "line 3, column 2 (vx)".
        accounts: number of a head → what became of its messages; empty for a table that is none of topics.
        clock: stamps of the topic at which requirements are evaluated; None for every instant.
        own: the record of own samples that s2r wrote beside the columns; empty if all are own.
    """

    heads: tuple[Head, ...]
    columns: Mapping[int, Column]
    meta: Mapping[str, Any]
    place: Callable[[int, int], str]
    notes: Sequence[str] = field(default=())
    accounts: Mapping[int, Account] = field(default_factory=dict)
    clock: NDArray[Any] | None = None
    own: Mapping[str, Any] = field(default_factory=dict)

    def places(self, number: int) -> Callable[[int], str]:
        """Return sample number → place in the file, for a column."""
        return lambda sample: self.place(sample, number)


def places_in(heads: Sequence[Head], form: str) -> Callable[[int, int], str]:
    """Return (sample number, head number) → place, from a form such as ``row {} of the column {}``."""
    return lambda sample, number: form.format(sample, quote(heads[number].text))


Chooser = Callable[[tuple[Head, ...]], Iterable[int]]
"""Heads of a file → numbers of the columns to read."""


def check_file(path: Path) -> None:
    """Refuse a path that is not a regular file, because a read could hang or never end.

    Raises:
        OSError: there is no such file.
        TraceError: the path is a pipe, a device or a folder.
    """
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise TraceError("this is a folder, not a file")
    if not stat.S_ISREG(mode):
        raise TraceError("this is a pipe or a device, not a file; copy its data to a file")


def check_size(numbers: int) -> None:
    """Refuse a file that would take too much memory.

    Raises:
        TraceError: it has more numbers than :data:`MOST_NUMBERS`.
    """
    if numbers > MOST_NUMBERS:
        raise TraceError(
            f"the file has {numbers / 1e6:,.0f} million numbers, and s2r reads at most {MOST_NUMBERS / 1e6:.0f} "
            f"million; cut the log, or read fewer columns"
        )


def check_columns(columns: int) -> None:
    """Refuse a file with too many columns.

    Raises:
        TraceError: it has more columns than :data:`MOST_COLUMNS`.
    """
    if columns > MOST_COLUMNS:
        raise TraceError(
            f"the file has {columns:,} columns, and s2r reads at most {MOST_COLUMNS:,}; remove some"
        )


Description = tuple[dict[str, str], dict[str, Any], dict[str, Any]]
"""Units, meta, and the record of own samples (:mod:`s2r_spec.logs.own`)."""


def parse_description(text: str | bytes, source: str) -> Description:
    """Return what s2r writes beside the columns, from its JSON; messages name its source in the file.

    Raises:
        TraceError: it is not JSON, or has another form.
    """
    try:
        return read_description(json.loads(text), source)
    except (ValueError, RecursionError) as error:
        raise TraceError(f"{source} is not JSON: {error}") from None


def read_description(record: Any, source: str) -> Description:
    """Return what s2r writes beside the columns, from a parsed record; see :func:`parse_description`."""
    if not isinstance(record, dict):
        raise TraceError(f"{source} is not a JSON object")
    units, meta, own = (record.get(key, {}) for key in ("units", "meta", "own"))
    if not isinstance(units, dict) or not all(isinstance(unit, str) for unit in units.values()):
        raise TraceError(f'{source}: "units" must map names to texts, such as "m/s"')
    if not isinstance(meta, dict):
        raise TraceError(f'{source}: "meta" must be a JSON object')
    if not isinstance(own, dict):
        raise TraceError(f'{source}: "own" must be a JSON object')
    return units, meta, own


def quote(name: str) -> str:
    """Return a name in quotes, shortened."""
    return repr(shortened(name))
