"""What a trace accepts: numbers, units, masks and the word for a failure, copied and checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from s2r_spec.base.arrays import BoolArray, FloatArray
from s2r_spec.base.errors import TraceError, one_of
from s2r_spec.base.printable import one_line
from s2r_spec.trace import stamps


def frozen_mask(mask: ArrayLike, count: int, name: str) -> BoolArray:
    """Return a read-only copy of a mask.

    Raises:
        TraceError: it has another length.
    """
    array = np.array(mask, dtype=bool)
    if array.shape != (count,):
        raise TraceError(f"the mask of {name!r} has shape {array.shape}, but there are {count} time stamps")
    array.setflags(write=False)
    return array


def frozen_floats(values: ArrayLike, name: str, *, dates: bool = False) -> tuple[FloatArray, str | None]:
    """Return a read-only copy as float64, and the unit that the type states: "s" for durations, else None."""
    values, unit = _magnitude(values, dates)
    try:
        raw = stamps.as_nanoseconds(np.asarray(_fill(values)))
        if stamps.is_typed(raw) and raw.dtype.kind == "M" and not dates:
            raise TypeError("it holds dates")
        if raw.dtype.kind == "c":
            raise TypeError("it holds complex numbers")
        if stamps.is_typed(raw):
            raw, unit = stamps.seconds(raw.ravel()).reshape(raw.shape), "s"
        frozen = raw.dtype == np.float64 and raw.flags.owndata and not raw.flags.writeable
        array = raw if frozen and raw.flags.c_contiguous else np.array(raw, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise TraceError(f"channel {name!r} is not numeric: {error}") from None
    array.setflags(write=False)
    return array, unit


def _magnitude(values: Any, times: bool) -> tuple[Any, str | None]:
    """Return the numbers and the unit of a pint Quantity, times in seconds; any other value, and None.

    Raises:
        TraceError: the times are of another dimension.
    """
    if not (hasattr(values, "magnitude") and hasattr(values, "units")):
        return values, None
    if not times:
        return values.magnitude, f"{values.units:~C}"
    try:
        return values.to("s").magnitude, None
    except Exception as error:  # of pint, which the caller has loaded
        raise TraceError(f"the times are in {values.units}, which is not a unit of time: {error}") from None


def _fill(values: Any) -> Any:
    """Return a masked array of numbers with NaN for masked values; numpy's own conversion would unmask them."""
    plain = type(values) is np.ndarray or not isinstance(values, np.ndarray)  # else numpy loads np.ma here
    masked = not plain and isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "biuf"
    return values.astype(np.float64).filled(np.nan) if masked else values


def unit_texts(units: Any, channels: Mapping[str, Any]) -> dict[str, str]:
    """Return the units after a check that they are texts, each for a channel.

    Raises:
        TraceError: a unit is not a string, or is for no channel.
    """
    if not isinstance(units, Mapping):
        raise TraceError(f"units are {units!r}; they must map names of channels to texts, such as 'm/s'")
    for name, unit in units.items():
        if not isinstance(unit, str):
            raise TraceError(f"the unit of channel {name!r} is {unit!r}; it must be a string, such as 'm/s'")
    if unknown := set(units) - set(channels):
        raise TraceError(
            f"units are given for {one_of(unknown)}, which the trace does not have: {one_of(channels)}"
        )
    return dict(units)


def failure_word(meta: Mapping[str, Any]) -> str | None:
    """Return the word for a failure; None, False, 0 and "" mean no failure.

    Raises:
        TraceError: the value is not a word.
    """
    word = meta.get("failure")
    if word is None or isinstance(word, str):
        return one_line(word.strip()) or None if word else None
    if isinstance(word, bool | np.bool_ | int | float):
        return "failure" if word else None
    raise TraceError(f'meta["failure"] is {word!r}; it must be a short word, such as "fall"')
