"""Options for reading the traces of a folder, as in ``log:night?nan=hold&time-unit=ms&map=vx=v.x``."""

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
class LogOptions:
    """A folder of traces, and the options for reading them.

    Args:
        folder: the folder.
        text: the text after the ``?``; "" if there is none.
        columns: channel or ``t`` → name of its column in the files.
        time_unit: unit of times that are plain numbers; None if not stated.
        hold: whether a missing sample takes the value of the sample before it.
    """

    folder: Path
    text: str
    columns: Mapping[str, str]
    time_unit: str | None
    hold: bool

    @classmethod
    def parse(cls, backend: str, text: str) -> LogOptions:
        """Read a text such as ``night?nan=hold``.

        Args:
            backend: name of the backend, for messages.
            text: the text after the backend's name and colon.

        Raises:
            UsageError: an option after the ``?`` is unknown or has a wrong value.
        """
        name, mark, options = text.partition("?")
        if not mark or Path(text).is_dir():
            return cls(Path(text), "", {}, None, False)
        values: dict[str, list[str]] = {"nan": [], "time-unit": [], "map": []}
        for option in filter(None, options.split("&")):
            key, _, value = option.partition("=")
            if key not in values:
                raise UsageError(
                    f"{backend}:{text}: the options after the ? are nan=hold, time-unit=UNIT and map=NAME=COLUMN, "
                    f"not {option!r}"
                )
            values[key].append(unquote(value))
        if not set(values["nan"]) <= {"hold", "error"} or len(set(values["nan"])) > 1:
            raise UsageError(
                f"{backend}:{text}: nan must be error or hold, not {' and '.join(values['nan'])}"
            )
        if len(set(values["time-unit"])) > 1:
            raise UsageError(
                f"{backend}:{text}: time-unit has several values, {' and '.join(values['time-unit'])}; give one"
            )
        unit = unit_of_option(values["time-unit"][0]) if values["time-unit"] else None
        return cls(Path(name), options, read_map(values["map"]), unit, "hold" in values["nan"])

    def load(self, path: Path) -> Loaded:
        """Read a file; numbered columns become vectors, because no spec says which form is meant."""
        return logs.load(path, self.columns, time_unit=self.time_unit, gather=True)

    def fill_gaps(self, trace: Trace) -> Trace:
        """Return the trace with each missing sample replaced by the one before, if ``nan=hold`` is set."""
        gaps = any(np.isnan(values).any() for values in trace.channels.values())
        if not (self.hold and gaps):
            return trace
        channels = {name: _last_known(values) for name, values in trace.channels.items()}
        return Trace(trace.times, channels, trace.units, trace.meta)


def _last_known(values: FloatArray) -> FloatArray:
    """Return (n,) or (n, k) samples with each NaN replaced by the sample before it; a NaN at the start stays."""
    samples = np.arange(len(values)).reshape(-1, *(1,) * (values.ndim - 1))
    known = np.maximum.accumulate(np.where(np.isnan(values), 0, samples), axis=0)
    return np.take_along_axis(values, known, axis=0)
