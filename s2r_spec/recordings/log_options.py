"""Options for reading the traces of a folder, as in ``log:night?nan=hold&time-unit=ms&map=vx=v.x``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from s2r_spec import logs
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.logs.interpret import Loaded
from s2r_spec.logs.options import read_map, unit_of_option
from s2r_spec.logs.topics.join import RULES, Joining
from s2r_spec.logs.topics.topic import STAMPS
from s2r_spec.recordings.log_episodes import EpisodeSettings, read_longest, read_sources
from s2r_spec.trace import Trace

_FORMS = {
    "nan": "hold",
    "time-unit": "UNIT",
    "map": "NAME=COLUMN",
    "when": "CONDITION",
    "start": "SECONDS",
    "duration": "SECONDS",
    "every": "SECONDS",
    "join": "RULE",
    "clock": "TOPIC",
    "stamps": "STAMPS",
    "longest": "SIGNAL=SECONDS",
    "param": "NAME=COLUMN@SECONDS",
}
"""Definition: the options after the ``?``, each with the form of its value."""
_REPEATED = ("map", "param", "longest")
"""Definition: options that may be given several times."""


@dataclass(frozen=True)
class LogOptions:
    """A folder of traces, and how they are read.

    Args:
        folder: the folder.
        text: the text after the ``?``; "" if there is none.
        settings: how a log becomes traces.
        hold: whether a missing sample takes the value of the sample before it.
    """

    folder: Path
    text: str
    settings: EpisodeSettings
    hold: bool

    @classmethod
    def parse(cls, backend: str, text: str) -> LogOptions:
        """Read the text after the backend's name and colon, such as ``night?nan=hold``.

        Raises:
            UsageError: an option after the ``?`` is unknown or has a wrong value.
        """
        name, mark, options = text.partition("?")
        if not mark or Path(text).is_dir():
            return cls(Path(text), "", EpisodeSettings(), False)
        where = f"{backend}:{text}"
        values = _values(where, options)
        if values.get("nan", "error") not in ("hold", "error"):
            raise UsageError(f"{where}: nan must be error or hold, not {values['nan']}")
        stated, sources = read_sources(values["param"])
        if stated:
            raise UsageError(f"{where}: param={stated[0]} names no column; write param=vd=COLUMN@0")
        columns, unit = read_map(values["map"]), unit_of_option(values.get("time-unit"))
        for key, allowed in (("join", RULES), ("stamps", STAMPS)):
            if values.get(key) not in (None, *allowed):
                raise UsageError(f"{where}: {key} must be {' or '.join(allowed)}, not {values[key]!r}")
        settings = EpisodeSettings(
            columns,
            unit,
            Joining.of_options(values.get("clock"), values.get("join"), values.get("stamps")),
            values.get("when"),
            _seconds(where, values, "start"),
            _seconds(where, values, "duration"),
            sources,
            read_longest(values["longest"]),
            _seconds(where, values, "every"),
        )
        if backend == "manual" and (settings.cuts or sources):
            raise UsageError(
                f"{where}: a person runs each test by itself: leave out when, start, duration and param"
            )
        return cls(Path(name), options, settings, values.get("nan") == "hold")

    def load(self, path: Path) -> Loaded:
        """Read a file; numbered columns become vectors, because no spec says which form is meant."""
        settings = self.settings
        return logs.load(
            path, settings.columns, time_unit=settings.time_unit, gather=True, joining=settings.joining
        )

    def fill_gaps(self, trace: Trace) -> Trace:
        """Return the trace with each missing sample replaced by the one before, if ``nan=hold`` is set."""
        own = [one.values for one in trace.messages.values()] or list(trace.channels.values())
        gaps = any(np.isnan(values).any() for values in own)
        return trace.with_channels(lambda _, values: _last_known(values)) if self.hold and gaps else trace


def _last_known(values: FloatArray) -> FloatArray:
    """Return (n,) or (n, k) samples with each NaN replaced by the sample before it; a NaN at the start stays."""
    samples = np.arange(len(values)).reshape(-1, *(1,) * (values.ndim - 1))
    known = np.maximum.accumulate(np.where(np.isnan(values), 0, samples), axis=0)
    return np.take_along_axis(values, known, axis=0)


def _values(where: str, options: str) -> dict[str, Any]:
    """Return option → its value; a list for one that may be repeated."""
    values: dict[str, Any] = {key: [] for key in _REPEATED}
    for option in filter(None, options.split("&")):
        key, _, value = option.partition("=")
        value = unquote(value)
        if key not in _FORMS:
            known = ", ".join(f"{word}={form}" for word, form in _FORMS.items())
            raise UsageError(
                f"{where}: the options after the ? are {known}, not {option!r}; within a value, write & as %26"
            )
        if key in _REPEATED:
            values[key].append(value)
        elif values.setdefault(key, value) != value:
            raise UsageError(f"{where}: {key} has several values, {values[key]} and {value}; give one")
    return values


def _seconds(where: str, values: Mapping[str, Any], key: str) -> float | None:
    if key not in values:
        return None
    with suppress(ValueError):
        seconds = float(values[key])
        if 0.0 <= seconds < math.inf:
            return seconds
    raise UsageError(f"{where}: {key} must be a number of seconds, not {values[key]!r}")
