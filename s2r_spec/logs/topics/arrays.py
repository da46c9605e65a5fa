"""Files of named arrays without topics of their own: each folder of arrays with an array of times is a topic.

Data: arrays by path, ``odom.t`` (n,) and ``odom.vx`` (n,) or (n, k). The array of times is called ``t``, ``time`` or
another word for it. Arrays of a folder without times belong to the times of the folder above, if their lengths agree.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import TraceError, one_of
from s2r_spec.logs import times
from s2r_spec.logs.dates import LAST
from s2r_spec.logs.mapping import TIME_WORDS
from s2r_spec.logs.table import Column, Head, affordable, few, quoted
from s2r_spec.logs.topics.topic import Stamps, Topic, TopicHead

_UNITS = ("unit", "units")
"""Definition: names of a text, or of a structure of texts, that states the units of the arrays beside it."""
WORDS = (times.TIME, *sorted(TIME_WORDS))
"""Definition: names of an array of times, the preferred first."""


@dataclass(frozen=True)
class Array:
    """An array of a file before it is read.

    Args:
        shape: its shape, with the samples first.
        read: reads it.
        unit: unit as written; None if there is none.
    """

    shape: tuple[int, ...]
    read: Callable[[], NDArray[Any]]
    unit: str | None = None


class ArrayLog:
    """Topics of named arrays; see :class:`s2r_spec.logs.topics.topic.TopicLog`.

    Args:
        arrays: path → array; the parts of a path are joined by dots.
        time_unit: unit of times that are plain numbers; None if not stated.

    Raises:
        TraceError: no array has times.
    """

    def __init__(self, arrays: Mapping[str, Array], time_unit: str | None = None) -> None:
        few(len(arrays))
        self.sortable = False
        self._arrays, self._time_unit = arrays, time_unit
        self.notes: tuple[str, ...] = ()
        folders: dict[str, list[str]] = defaultdict(list)
        for path in arrays:
            folders[path.rpartition(".")[0]].append(path)
        self._times: dict[str, str] = {}
        fields: dict[str, list[str]] = defaultdict(list)
        for folder, paths in folders.items():
            for path in paths:
                clock = self._clock(folder, arrays[path].shape)
                if clock is not None and clock != path:
                    topic = clock.rpartition(".")[0]
                    self._times[topic] = clock
                    fields[topic].append(path[len(topic) :].lstrip("."))
        if not fields:
            raise TraceError(f"no array of the file has times; {_advice(arrays)}")
        self.heads = tuple(self._head(topic, names) for topic, names in fields.items())

    def _head(self, topic: str, names: Sequence[str]) -> TopicHead:
        units = {name: unit for name in names if (unit := self._arrays[_path(topic, name)].unit) is not None}
        return TopicHead(topic, tuple(names), self._arrays[self._times[topic]].shape[0], units=units)

    def read(self, wanted: Mapping[str, Sequence[str]], stamps: Stamps) -> dict[str, Topic]:
        """Read arrays; see :meth:`s2r_spec.logs.topics.topic.TopicLog.read`."""
        paths = [_path(topic, name) for topic, names in wanted.items() for name in names]
        shapes = [self._arrays[path].shape for path in (*paths, *(self._times[topic] for topic in wanted))]
        affordable(sum(int(np.prod(shape)) for shape in shapes))
        topics: dict[str, Topic] = {}
        dated: dict[bool, str] = {}
        for topic, names in wanted.items():
            found = self._stamps(topic)
            dated.setdefault(found.dtype.kind == "M", topic)
            if len(dated) == 2:
                raise TraceError(
                    f"the times of {quoted(dated[True])} are dates and those of {quoted(dated[False])} are not, so "
                    f"they come from different clocks; save both with the same clock"
                )
            columns = {name: Column(self._arrays[_path(topic, name)].read()) for name in names}
            topics[topic] = Topic(topic, found, columns)
        return topics

    def _stamps(self, topic: str) -> NDArray[Any]:
        """Return (n,) dates to the nanosecond, or seconds of a clock without a date."""
        clock = self._times[topic]
        array = self._arrays[clock]
        head = Head(clock.rpartition(".")[2], None, array.unit)
        found = times.read(
            [Column(array.read())],
            [head],
            self._time_unit,
            lambda sample: f"sample {sample} of {quoted(clock)}",
            None,
        )
        if found.since is None:
            return found.seconds
        # Dates of two topics must be comparable, whatever unit each is in.
        if found.since >= LAST:
            raise TraceError(f"the times of {quoted(clock)} begin at {found.begins}, which is no date")
        stamps: NDArray[Any] = round(found.since * 10**9) + np.rint(found.seconds * 1e9).astype(np.int64)
        return stamps.view("M8[ns]")

    def _clock(self, folder: str, shape: tuple[int, ...]) -> str | None:
        """Return the array of times of an array in a folder: the nearest one above with as many samples."""
        if not shape:
            return None
        while True:
            for word in WORDS:
                path = _path(folder, word)
                if path in self._arrays and self._arrays[path].shape == (shape[0],):
                    return path
            if not folder:
                return None
            folder = folder.rpartition(".")[0]


def is_unit_path(path: str) -> bool:
    """Return whether a text with this path states a unit: ``gap.unit`` or ``units.gap``."""
    folder, _, name = path.rpartition(".")
    return name in _UNITS or folder.rpartition(".")[2] in _UNITS


def with_units(arrays: Mapping[str, Array], texts: Mapping[str, str]) -> dict[str, Array]:
    """Return arrays with the units that texts beside them state.

    Args:
        arrays: path → array.
        texts: path → text: ``s.units`` is for all arrays of ``s`` but the times, and ``s.units.gap`` for ``s.gap``.
    """
    found = dict(arrays)
    for path, text in texts.items():
        folder, _, name = path.rpartition(".")
        if name in _UNITS:
            beside = [one for one in arrays if one.rpartition(".")[0] == folder]
            chosen = [one for one in beside if one.rpartition(".")[2] not in WORDS]
        else:
            chosen = [one for one in (_path(folder.rpartition(".")[0], name),) if one in arrays]
        found |= {one: replace(arrays[one], unit=text.strip() or None) for one in chosen}
    return found


def _advice(arrays: Mapping[str, Array]) -> str:
    """Return what a file without a topic has, and what to save instead."""
    clocks = [path for path in arrays if path.rpartition(".")[2] in WORDS]
    if not clocks:
        return f"there are {one_of(arrays)}. Save an array of times beside them, called t"
    shapes = one_of(f"{path} of {'×'.join(map(str, array.shape)) or '1'}" for path, array in arrays.items())
    return f"there are {shapes} numbers. Save the samples along the first axis, as many as {clocks[0]} has"


def _path(topic: str, name: str) -> str:
    return f"{topic}.{name}" if topic else name
