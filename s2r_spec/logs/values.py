"""The samples of a channel: the one place where numbers, truth values, durations and gaps are decided."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from s2r_spec import stamps
from s2r_spec.errors import TraceError, shortened
from s2r_spec.logs import cells
from s2r_spec.logs.table import Column

FloatArray = NDArray[np.float64]


def read(column: Column, name: str, place: Callable[[int], str]) -> tuple[FloatArray, str | None]:
    """Return (n,) or (n, k) samples, NaN where there is none, and their unit where the type says it.

    Truth values are 1 and 0; durations are seconds.

    Args:
        column: as found.
        name: of it, in quotes.
        place: number of a sample → where it is.

    Raises:
        TraceError: it holds no numbers.
    """
    if column.fault:
        raise TraceError(f"{name} {column.fault}")
    values, unit = column.values, None
    if values.dtype.kind == "M":
        raise TraceError(f"{name} holds dates, not numbers")
    if values.dtype.kind == "m":
        gaps = np.isnat(values)
        filled = np.where(gaps, np.zeros(1, values.dtype), values)
        values, unit = stamps.seconds(filled.ravel(), np.timedelta64(0, "s")), "s"
        values = values.reshape(gaps.shape)
        values[gaps] = np.nan
    found = _texts(column, name, place) if column.texts else np.array(values, dtype=np.float64)
    if column.missing is not None:
        found[column.missing] = np.nan
    return found, unit


def _texts(column: Column, name: str, place: Callable[[int], str]) -> FloatArray:
    if column.values.ndim != 1:
        raise TraceError(f"{name} holds texts, not numbers")
    found = np.full(len(column.values), np.nan)
    there = np.flatnonzero(~cells.missing(column.values))
    known = cells.truths([column.values[sample] for sample in there])
    if known is not None:
        found[there] = known
        return found
    for sample in there:
        try:
            found[sample] = cells.number(column.values[sample])
        except ValueError:
            raise TraceError(
                f"{place(int(sample))} is {shortened(column.values[sample])!r}, not a number"
            ) from None
    return found
