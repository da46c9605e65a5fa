"""How the traces of a folder are read: what follows its name, as in ``log:night?nan=hold&time-unit=ms&map=vx=v.x``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from s2r_spec import logs
from s2r_spec.errors import UsageError
from s2r_spec.logs.interpret import Loaded
from s2r_spec.logs.mapping import read_map
from s2r_spec.logs.times import unit_of_option
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Reading:
    """How the traces of a folder are read.

    Args:
        folder: where they are.
        words: what follows the ``?``, "" for none.
        columns: channel or ``t`` → what the files call it.
        time_unit: of times that are plain numbers; None if not stated.
        hold: whether a missing sample is the one before it.
    """

    folder: Path
    words: str
    columns: Mapping[str, str]
    time_unit: str | None
    hold: bool

    @classmethod
    def of(cls, kind: str, text: str) -> Reading:
        """Return what a text such as ``night?nan=hold`` means.

        Args:
            kind: of the backend that is given it, for its sentences.
            text: what follows the backend's name.

        Raises:
            UsageError: a word after the ``?`` is not known.
        """
        name, mark, words = text.partition("?")
        if not mark or Path(text).is_dir():
            return cls(Path(text), "", {}, None, False)
        found: dict[str, list[str]] = {"nan": [], "time-unit": [], "map": []}
        for word in filter(None, words.split("&")):
            key, _, value = word.partition("=")
            if key not in found:
                raise UsageError(
                    f"{kind}:{text}: after the ? are nan=hold, time-unit=UNIT and map=NAME=COLUMN, not {word!r}"
                )
            found[key].append(unquote(value))
        if not set(found["nan"]) <= {"hold", "error"} or len(set(found["nan"])) > 1:
            raise UsageError(f"{kind}:{text}: nan is error or hold, not {' and '.join(found['nan'])}")
        if len(set(found["time-unit"])) > 1:
            raise UsageError(
                f"{kind}:{text}: the unit of the times is given as {' and '.join(found['time-unit'])}"
            )
        unit = unit_of_option(found["time-unit"][0]) if found["time-unit"] else None
        return cls(Path(name), words, read_map(found["map"]), unit, "hold" in found["nan"])

    def load(self, path: Path) -> Loaded:
        """Return all that a file holds; numbered columns are vectors, too, as no spec says what is meant."""
        return logs.load(path, self.columns, time_unit=self.time_unit, gather=True)

    def held(self, trace: Trace) -> Trace:
        """Return the trace with each missing sample replaced by the one before, if that is how it is read."""
        gaps = any(np.isnan(values).any() for values in trace.channels.values())
        if not (self.hold and gaps):
            return trace
        channels = {name: _last_known(values) for name, values in trace.channels.items()}
        return Trace(trace.times, channels, trace.units, trace.meta)


def _last_known(values: FloatArray) -> FloatArray:
    """Return (n,) or (n, k) with each NaN replaced by the sample before it; the first cannot be."""
    samples = np.arange(len(values)).reshape(-1, *(1,) * (values.ndim - 1))
    known = np.maximum.accumulate(np.where(np.isnan(values), 0, samples), axis=0)
    return np.take_along_axis(values, known, axis=0)
