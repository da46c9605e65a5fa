"""Read the samples of a channel from numbers, truth values, durations or texts, with NaN for gaps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError, shortened
from s2r_spec.logs import cells
from s2r_spec.logs.table import Column
from s2r_spec.trace import stamps

FloatArray = NDArray[np.float64]


def read(column: Column, name: str, place: Callable[[int], str]) -> tuple[FloatArray, str | None]:
    """Return (n,) or (n, k) samples, with NaN for missing ones, and the unit if the type states it.

    Truth values become 1 and 0, and durations seconds.

    Raises:
        TraceError: the column holds no numbers.
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
    samples = _texts(column, name, place) if column.texts else np.asarray(values, dtype=np.float64)
    if column.missing is not None:
        samples = samples.copy()
        samples[column.missing] = np.nan
    return samples, unit


def _texts(column: Column, name: str, place: Callable[[int], str]) -> FloatArray:
    if column.values.ndim != 1:
        raise TraceError(f"{name} holds texts, not numbers")
    samples = np.full(len(column.values), np.nan)
    present = np.flatnonzero(~cells.is_missing(column.values))
    truths = cells.truths([column.values[sample] for sample in present])
    if truths is not None:
        samples[present] = truths
        return samples
    for sample in present:
        try:
            samples[sample] = cells.number(column.values[sample])
        except ValueError:
            raise TraceError(
                f"{place(int(sample))} is {shortened(column.values[sample])!r}, not a number"
                f"{cells.decimal_point(column.values[sample])}"
            ) from None
    return samples
