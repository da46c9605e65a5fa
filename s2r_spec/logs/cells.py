"""Texts as numbers and truth values: what people write in a cell."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PANDAS = "nan|-nan|na|<na>|n/a|#n/a|#n/a n/a|#na|null|none|-1.#ind|1.#ind|-1.#qnan|1.#qnan"
MISSING = frozenset(("", "nat", *_PANDAS.split("|")))
"""Definition: texts in which there is no value, in small letters: those of pandas.read_csv, and NaT."""
TRUE = frozenset(("true", "t", "yes", "y", "on"))
"""Definition: texts that say yes, in small letters."""
FALSE = frozenset(("false", "f", "no", "n", "off"))
"""Definition: texts that say no, in small letters."""
_AS_NUMBERS = {"0": 0.0, "1": 1.0, "0.0": 0.0, "1.0": 1.0}


def parsed(texts: Sequence[str]) -> NDArray[Any]:
    """Return (n,) whole numbers if all texts are, or numbers with NaN for a missing one, or the texts (as objects)."""
    if "_" not in "".join(texts):  # Python reads 1_000, no one else does
        for convert, kind in ((int, np.int64), (float, np.float64), (_number, np.float64)):
            try:
                found: NDArray[Any] = np.array([convert(text) for text in texts], dtype=kind)
            except (ValueError, OverflowError):
                continue
            if kind is np.int64 or not _overflown(found, texts):
                return found
    return words(text.strip() for text in texts)


def words(texts: Iterable[str]) -> NDArray[Any]:
    """Return texts as an array of objects."""
    listed = list(texts)
    found = np.empty(len(listed), dtype=object)
    found[:] = listed
    return found


def missing(texts: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (n,) where a text is none."""
    return np.array([text.lower() in MISSING for text in texts], dtype=bool)


def truths(texts: Sequence[str]) -> NDArray[np.float64] | None:
    """Return 1 and 0 for texts that say yes and no, or are 1 and 0 beside them; None if one is anything else."""
    found = np.empty(len(texts))
    said = False
    for place, text in enumerate(texts):
        word = text.lower()
        if word in TRUE or word in FALSE:
            found[place] = word in TRUE
            said = True
        elif word in _AS_NUMBERS:
            found[place] = _AS_NUMBERS[word]
        else:
            return None
    return found if said else None


def number(text: str) -> float:
    """Return the number that a text is.

    Raises:
        ValueError: it is none.
    """
    if "_" in text or _overflown(np.array([float(text)]), [text]):
        raise ValueError(text)
    return float(text)


def _overflown(numbers: NDArray[Any], texts: Sequence[str]) -> bool:
    """Return whether a text such as 1e999, which no float64 holds, was read as infinite."""
    infinite = np.flatnonzero(np.isinf(numbers))
    return any("n" not in texts[place].lower() for place in infinite.tolist())


def _number(text: str) -> float:
    return np.nan if text.strip().lower() in MISSING else float(text)
