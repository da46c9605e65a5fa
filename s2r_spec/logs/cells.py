"""Read numbers, truth values and durations from the cells of a column, typed or as text, with NaN for gaps."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError, shortened
from s2r_spec.logs.table import Column
from s2r_spec.trace import stamps

_PANDAS = "nan|-nan|na|<na>|n/a|#n/a|#n/a n/a|#na|null|none|-1.#ind|1.#ind|-1.#qnan|1.#qnan"
MISSING = frozenset(("", "nat", *_PANDAS.split("|")))
"""Definition: texts for a missing value, in lower case: the texts of pandas.read_csv, and NaT."""
TRUE = frozenset(("true", "t", "yes", "y", "on"))
"""Definition: texts for true, in lower case."""
FALSE = frozenset(("false", "f", "no", "n", "off"))
"""Definition: texts for false, in lower case."""
_AS_NUMBERS = {"0": 0.0, "1": 1.0, "0.0": 0.0, "1.0": 1.0}


def parse(texts: Sequence[str]) -> NDArray[Any]:
    """Return (n,) texts as whole numbers if all are, else as numbers with NaN for missing ones, else as objects."""
    if "_" not in "".join(texts):  # Python alone reads 1_000 as a number
        for convert, kind in ((int, np.int64), (float, np.float64), (_number, np.float64)):
            try:
                numbers: NDArray[Any] = np.array([convert(text) for text in texts], dtype=kind)
            except (ValueError, OverflowError):
                continue
            if kind is np.int64 or not _overflows(numbers, texts):
                return numbers
    return words(text.strip() for text in texts)


def words(texts: Iterable[str]) -> NDArray[Any]:
    """Return texts as an array of objects."""
    items = list(texts)
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array


def is_missing(texts: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (n,) bool: whether each text is a missing value."""
    return np.array([text.lower() in MISSING for text in texts], dtype=bool)


def truths(texts: Sequence[str]) -> NDArray[np.float64] | None:
    """Return 1 and 0 for truth values, which may be mixed with the texts 1 and 0; None if a text is anything else."""
    values = np.empty(len(texts))
    has_words = False
    for place, text in enumerate(texts):
        word = text.lower()
        if word in TRUE or word in FALSE:
            values[place] = word in TRUE
            has_words = True
        elif word in _AS_NUMBERS:
            values[place] = _AS_NUMBERS[word]
        else:
            return None
    return values if has_words else None


def number(text: str) -> float:
    """Parse a number.

    Raises:
        ValueError: the text is not a number.
    """
    if "_" in text or _overflows(np.array([float(text)]), [text]):
        raise ValueError(text)
    return float(text)


def decimal_point(text: str) -> str:
    """Return what to do if a text is a number with a decimal comma, to follow a message; else ""."""
    return "; write a decimal point, not a comma" if re.fullmatch(r"[+-]?\d+,\d+", text) else ""


def _overflows(numbers: NDArray[Any], texts: Sequence[str]) -> bool:
    """Return whether a text such as 1e999, too large for float64, was read as infinite."""
    infinite = np.flatnonzero(np.isinf(numbers))
    return any("n" not in texts[place].lower() for place in infinite.tolist())


def _number(text: str) -> float:
    return np.nan if text.strip().lower() in MISSING else float(text)


def read_samples(
    column: Column, name: str, place: Callable[[int], str]
) -> tuple[NDArray[np.float64], str | None]:
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
    samples = _read_texts(column, name, place) if column.texts else np.asarray(values, dtype=np.float64)
    if column.missing is not None:
        samples = samples.copy()
        samples[column.missing] = np.nan
    return samples, unit


def _read_texts(column: Column, name: str, place: Callable[[int], str]) -> NDArray[np.float64]:
    if column.values.ndim != 1:
        raise TraceError(f"{name} holds texts, not numbers")
    samples = np.full(len(column.values), np.nan)
    present = np.flatnonzero(~is_missing(column.values))
    truth = truths([column.values[sample] for sample in present])
    if truth is not None:
        samples[present] = truth
        return samples
    for sample in present:
        try:
            samples[sample] = number(column.values[sample])
        except ValueError:
            raise TraceError(
                f"{place(int(sample))} is {shortened(column.values[sample])!r}, not a number"
                f"{decimal_point(column.values[sample])}"
            ) from None
    return samples
