"""Files of named arrays without topics of their own: each folder of arrays with an array of times is a topic.

Data: arrays by path, ``odom.t`` (n,) and ``odom.vx`` (n,) or (n, k). The array of times is called ``t``, ``time`` or
another word for it, or ``--map t=`` names it. Arrays of a folder without times belong to the times of the folder above,
if their lengths agree. Of two arrays that may be the times, ``t`` has them; else the user is asked.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import TraceError, one_of
from s2r_spec.logs.mapping import ColumnRequest, plan_columns
from s2r_spec.logs.options import TIME, TimeOptions
from s2r_spec.logs.table import Column, Head, check_columns, check_size, quote
from s2r_spec.logs.time_columns import TIME_WORDS
from s2r_spec.logs.times import candidates, times
from s2r_spec.logs.times.dates import LAST
from s2r_spec.logs.topics.topic import Stamps, Topic, TopicHead

_UNITS = ("unit", "units")
"""Definition: names of a text, or of a structure of texts, that states the units of the arrays beside it."""


@dataclass(frozen=True)
class Array:
    """An array of a file before it is read: its shape with the samples first, what reads it, its unit as written."""

    shape: tuple[int, ...]
    read: Callable[[], NDArray[Any]]
    unit: str | None = None


Clock = tuple[str, ...]
"""Path of an array of times; or two paths, of whole seconds and of fractions."""


@dataclass
class _TopicArrays:
    """A topic: its clock, the arrays that may be it as well, its fields, and why other arrays below it are none."""

    clock: Clock
    rivals: tuple[str, ...] = ()
    fields: list[str] = field(default_factory=list)
    other: dict[str, str] = field(default_factory=dict)


class ArrayLog:
    """Topics of named arrays; see :class:`s2r_spec.logs.topics.topic.TopicLog`.

    Args:
        arrays: path → array; the parts of a path are joined by dots.
        options: what the user says of the times.
        objects: path of a variable that cannot be read → what it is, as text after its name.

    Raises:
        NoTimesError: the array that the user names is not in the file.
        TraceError: no array has times, or those that the user names.
    """

    def __init__(
        self,
        arrays: Mapping[str, Array],
        options: TimeOptions | None = None,
        objects: Mapping[str, str] | None = None,
    ) -> None:
        check_columns(len(arrays))
        self.sortable = False
        self._arrays, self._options = arrays, options or TimeOptions()
        self.notes: list[str] = []
        self._mapped = _mapped_clocks(arrays, self._options.times)
        self._clocks: dict[str, list[str]] = defaultdict(list)
        for path in filter(is_word, arrays):
            self._clocks[_folder(path)].append(path)
        self._topics = self._group_fields()
        if not self._topics:
            raise TraceError(
                f"no array of the file has times; {_advice(arrays, self._mapped, objects or {})}"
            )
        self._describe_others(objects or {})
        self.heads: Sequence[TopicHead] = [
            self._head(topic, fields) for topic, fields in self._topics.items()
        ]

    def _group_fields(self) -> dict[str, _TopicArrays]:
        """Return topic → its clock and fields. A topic has one clock: the user's, ``t``, or the first."""
        clocks = {
            path: clock for path, array in self._arrays.items() if (clock := self._clock(path, array.shape))
        }
        clocks = {path: clock for path, clock in clocks.items() if path not in clock}
        first: dict[str, Clock] = {}

        def rank(one: tuple[str, Clock]) -> tuple[bool, bool]:
            return one[1] not in self._mapped, _last(one[1][0]) != TIME

        for path, clock in sorted(clocks.items(), key=rank):
            first.setdefault(_topic(path, clock), clock)
        topics: dict[str, _TopicArrays] = {}
        for path, clock in clocks.items():
            topic = _topic(path, clock)
            own = topics.setdefault(topic, _TopicArrays(first[topic]))
            name = _below(path, topic)
            if clock != own.clock:
                own.other[name] = (
                    f"has the times {_clock_text(clock)}, and other arrays beside it have {_clock_text(own.clock)}; "
                    f"choose by --map {TIME}={'+'.join(clock)}"
                )
            elif path == TIME:  # a trace has one t
                own.other[name] = f"is not the times, which are {_clock_text(clock)}"
            else:
                own.fields.append(name)
                own.rivals = own.rivals or self._rivals(clock)
        return {topic: own for topic, own in topics.items() if own.fields}

    def _clock(self, path: str, shape: tuple[int, ...]) -> Clock:
        """Return the times of an array, those that have as many samples; () if there are none.

        They are the array that the user names, in the nearest folder above; else one of the words, likewise; else the
        only array that the user names, wherever it is.
        """
        if not shape:
            return ()
        named = [clock for clock in self._mapped if self._arrays[clock[0]].shape == (shape[0],)]
        for folder in _above(path):
            if clocks := [clock for clock in named if _folder(clock[0]) == folder]:
                return clocks[0]
        for folder in _above(path):
            if words := self._words(folder, (shape[0],)):
                return (words[0],)
        return named[0] if len(self._mapped) == 1 and named else ()

    def _rivals(self, clock: Clock) -> tuple[str, ...]:
        """Return the arrays that may be the times as well as a clock that nobody chose, with the clock."""
        if clock in self._mapped or _last(clock[0]) == TIME:
            return ()
        rivals = self._words(_folder(clock[0]), self._arrays[clock[0]].shape)
        return rivals if len(rivals) > 1 else ()

    def _words(self, folder: str, shape: tuple[int, ...]) -> tuple[str, ...]:
        """Return the arrays of a folder that are called ``t`` or by a word for times, and have a shape; t first."""
        paths = [path for path in self._clocks.get(folder, ()) if self._arrays[path].shape == shape]
        return tuple(sorted(paths, key=lambda path: _last(path) != TIME))

    def _describe_others(self, objects: Mapping[str, str]) -> None:
        known = {path for fields in self._topics.values() for path in fields.clock}
        known |= {
            _path(topic, name)
            for topic, fields in self._topics.items()
            for name in (*fields.fields, *fields.other)
        }
        others = {
            path: f"has {_shape(array)} numbers, and no array of times has as many samples"
            for path, array in self._arrays.items()
            if path not in known and not is_word(path) and max(array.shape, default=1) > 1
        }
        for path, text in {**others, **objects}.items():
            topic = next((folder for folder in _above(path) if folder in self._topics), None)
            if topic is not None:
                self._topics[topic].other[_below(path, topic)] = text

    def _head(self, topic: str, fields: _TopicArrays) -> TopicHead:
        written = {name: self._arrays[_path(topic, name)].unit for name in fields.fields}
        units = {name: unit for name, unit in written.items() if unit is not None}
        count = self._arrays[fields.clock[0]].shape[0]
        return TopicHead(
            topic, tuple(fields.fields), count, units=units, faults=fields.other, other=fields.other
        )

    def read(self, wanted: Mapping[str, Sequence[str]], stamps: Stamps) -> dict[str, Topic]:
        """Read arrays; see :meth:`s2r_spec.logs.topics.topic.TopicLog.read`.

        Raises:
            NoTimesError: several arrays may be the times of a topic.
            TraceError: the topics are none of those whose times the user names, or their times do not fit together.
        """
        self._check_clocks(wanted)
        paths = [_path(topic, name) for topic, names in wanted.items() for name in names]
        shapes = [self._arrays[path].shape for path in paths]
        shapes += [self._arrays[path].shape for topic in wanted for path in self._topics[topic].clock]
        check_size(sum(int(np.prod(shape)) for shape in shapes))
        topics: dict[str, Topic] = {}
        dated: dict[bool, str] = {}
        for topic, names in wanted.items():
            own = self._stamps(topic)
            dated.setdefault(own.dtype.kind == "M", topic)
            if len(dated) == 2:
                raise TraceError(
                    f"the times of {quote(dated[True])} are dates and those of {quote(dated[False])} are not, so "
                    f"they come from different clocks; save both with the same clock"
                )
            columns = {name: Column(self._arrays[_path(topic, name)].read()) for name in names}
            topics[topic] = Topic(topic, own, columns)
        end = self._end(topics)
        return {name: replace(topic, log_end=end) for name, topic in topics.items()}

    def _end(self, read: Mapping[str, Topic]) -> Any:
        """Return the last stamp of all topics with the clock of those that are read; None if none has a message."""
        kind = next(iter(read.values())).stamps.dtype.kind if read else ""
        last = []
        for topic in self._topics:
            try:
                stamps = read[topic].stamps if topic in read else self._stamps(topic)
            except TraceError:  # of a topic that nobody reads
                continue
            if stamps.size and stamps.dtype.kind == kind:
                last.append(stamps.max())
        return max(last, default=None)

    def _check_clocks(self, wanted: Mapping[str, Sequence[str]]) -> None:
        """Refuse times that nobody chose of several, and times that the user names and that no topic has."""
        clocks = {topic: self._topics[topic].clock for topic in wanted}
        for topic in wanted:
            if rivals := self._topics[topic].rivals:
                readable = {_last(path): self._readable([path]) for path in rivals}
                raise candidates.question(readable, self._options.unit)
        own = {topic: clock for topic, clock in clocks.items() if self._mapped and clock not in self._mapped}
        if own and len(own) == len(clocks):
            topic, clock = next(iter(own.items()))
            named = self._mapped[0]
            raise TraceError(
                f"{_clock_text(named)} of {_shape(self._arrays[named[0]])} numbers cannot be the times of "
                f"{quote(topic)}, which has {_shape(self._arrays[clock[0]])} samples. Its own times are "
                f"{_clock_text(clock)}"
            )
        self.notes += [
            f"the times of {topic or 'the file'} are its own, {_clock_text(clock)}"
            for topic, clock in own.items()
        ]

    def _readable(self, paths: Sequence[str]) -> tuple[list[Column], list[Head]]:
        heads = [Head(_last(path), None, self._arrays[path].unit) for path in paths]
        return [Column(self._arrays[path].read()) for path in paths], heads

    def _stamps(self, topic: str) -> NDArray[Any]:
        """Return (n,) dates to the nanosecond, or seconds of a clock without a date."""
        clock = self._topics[topic].clock
        times_read = times.read(
            *self._readable(clock),
            self._options.unit,
            lambda sample: f"sample {sample} of {_clock_text(clock)}",
        )
        self.notes += times_read.notes
        if times_read.since is None:
            return times_read.seconds
        # Dates of two topics must be comparable, whatever unit each is in.
        if times_read.since >= LAST:
            raise TraceError(
                f"the times of {_clock_text(clock)} begin at {times_read.begins}, which is no date"
            )
        counts = np.rint(times_read.seconds * 1e9).astype(np.int64)
        stamps: NDArray[Any] = round(times_read.since * 10**9) + counts
        return stamps.view("M8[ns]")


def squeeze(shape: Sequence[int]) -> tuple[int, ...]:
    """Return the shape of a vector for that of a row, a column or a signal of 1×1×n."""
    longer = [size for size in shape if size != 1]
    return tuple(longer or [1]) if shape and len(longer) < 2 else tuple(shape)


def is_unit_path(path: str) -> bool:
    """Return whether a text with this path states a unit: ``gap.unit`` or ``units.gap``."""
    folder, _, name = path.rpartition(".")
    return name.lower() in _UNITS or folder.rpartition(".")[2].lower() in _UNITS


def with_units(arrays: Mapping[str, Array], texts: Mapping[str, str]) -> dict[str, Array]:
    """Return arrays with the units that texts beside them state.

    The text ``s.units`` is for all arrays of ``s`` but the times, and ``s.units.gap`` for ``s.gap``.
    """
    labelled = dict(arrays)
    for path, text in texts.items():
        folder, _, name = path.rpartition(".")
        if name.lower() in _UNITS:
            beside = [one for one in arrays if one.rpartition(".")[0] == folder]
            chosen = [one for one in beside if not is_word(one)]
        else:
            chosen = [one for one in (_path(folder.rpartition(".")[0], name),) if one in arrays]
        labelled |= {one: replace(arrays[one], unit=text.strip() or None) for one in chosen}
    return labelled


def as_text(value: Any) -> str:
    """Return a text that may be bytes."""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def as_object(kind: str) -> str:
    """Return why an object of MATLAB cannot be read, as text after its name."""
    return (
        f"is an object of the class {quote(kind)}, in a form of MATLAB's own. Save its times as an array t, and its "
        f"values as arrays beside t"
    )


def _mapped_clocks(arrays: Mapping[str, Array], name: str | None) -> tuple[Clock, ...]:
    """Return the clocks that a user names by their path, or by its last part."""
    if name is None:
        return ()
    clocks = tuple((path,) for path in arrays if path == name or path.endswith(f".{name}"))
    if clocks:
        return clocks
    heads = [Head(path, None, array.unit) for path, array in arrays.items()]
    numbers = plan_columns(heads, ColumnRequest({TIME: name}, {})).times
    return (tuple(heads[number].name for number in numbers),)


def _advice(arrays: Mapping[str, Array], mapped: Sequence[Clock], objects: Mapping[str, str]) -> str:
    clock = mapped[0][0] if mapped else next(filter(is_word, arrays), "")
    why = f"no other array has as many samples as {clock}" if mapped else "no array of the file has times"
    if objects and not clock:
        name, fault = next(iter(objects.items()))
        return f"{why}. {quote(name)} {fault}"
    if not clock:
        return (
            f"{why}; there are {one_of(arrays)}. Map one, as in --map {TIME}=NAME, or save an array of times "
            f"beside them, called t"
        )
    shapes = one_of(f"{path} of {_shape(array)}" for path, array in arrays.items())
    return f"{why}; there are {shapes} numbers. Save the samples along the first axis, as many as {clock} has"


def _shape(array: Array) -> str:
    return "×".join(map(str, array.shape)) or "1"


def is_word(path: str) -> bool:
    """Return whether the name of an array says that it holds times."""
    name = _last(path)
    return name == TIME or name.lower() in TIME_WORDS


def _topic(path: str, clock: Clock) -> str:
    """Return the topic of an array: the folder of its times, or the file if they are elsewhere."""
    folder = _folder(clock[0])
    return folder if folder in _above(path) else ""


def _clock_text(clock: Clock) -> str:
    return quote("+".join(clock))


def _path(topic: str, name: str) -> str:
    return f"{topic}.{name}" if topic else name


def _below(path: str, topic: str) -> str:
    return path[len(topic) + 1 :] if topic and path.startswith(f"{topic}.") else path


def _folder(path: str) -> str:
    return path.rpartition(".")[0]


def _last(path: str) -> str:
    return path.rpartition(".")[2]


def _above(path: str) -> Iterator[str]:
    """Yield the folders of an array, the nearest first, and "" for the file."""
    while path:
        path = _folder(path)
        yield path
