"""Which columns of a file make which channels: by their names, by what the spec reads, and by ``--map``.

A vector is one column of lists, or one column a component: ``q[0]``, ``q_0``, ``q.0``, ``q/0`` or ``q0``, numbered
from 0 or from 1 without a gap. ``position[3]`` is one component, of either form.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from s2r_spec.errors import TraceError, UsageError, one_of, suggest
from s2r_spec.lang.units import UnknownUnitError, parse_unit
from s2r_spec.logs import time_units
from s2r_spec.logs.table import Head, quoted
from s2r_spec.logs.times import TIME

ANY = -1
"""A channel of which it is not known whether it is a vector."""

_JOINTS = ("_", ".", "/", ":", "[", "")
"""Definition: what stands between the name of a vector and the number of a component."""


@dataclass(frozen=True)
class Request:
    """What is to be read.

    Args:
        columns: channel, or ``t``, or one component ``q[1]`` → what the file calls it.
        wanted: channel → None for a number a sample, its width for a vector, or :data:`ANY`; None for all there is.
        time_unit: of times that are plain numbers, where nothing else says it.
        gather: where all is read, make vectors of numbered columns, too.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    wanted: Mapping[str, int | None] | None = None
    time_unit: str | None = None
    gather: bool = False


@dataclass(frozen=True)
class Part:
    """A column, or one component of a column of vectors; its unit, where the column's name has it in brackets."""

    number: int
    component: int | None = None
    unit: str | None = None


@dataclass(frozen=True)
class Channel:
    """The parts that make a channel; ``vector`` if it is one even of a single part; the width that is wanted."""

    name: str
    parts: tuple[Part, ...]
    vector: bool
    width: int | None = ANY


@dataclass(frozen=True)
class Plan:
    """What to read from a file.

    Args:
        times: the column of the times, or that of seconds and that of what is below.
        channels: in order.
        faults: channel → why it cannot be made.
        notes: what was decided by names alone, in sentences.
    """

    times: tuple[int, ...]
    channels: tuple[Channel, ...]
    faults: Mapping[str, str]
    notes: tuple[str, ...]

    @property
    def needed(self) -> set[int]:
        """Numbers of the columns to read."""
        return {*self.times, *(part.number for channel in self.channels for part in channel.parts)}


def planned(heads: Sequence[Head], request: Request) -> Plan:
    """Return which columns make the times and the channels.

    Raises:
        TraceError: there are no times; the message lists what there is.
    """
    names = _Names(heads)
    times = names.times(request.columns.get(TIME, TIME))
    names.taken = frozenset(times)
    columns = {name: text for name, text in request.columns.items() if name != TIME}
    if request.wanted is None:
        return _everything(names, times, columns, request.gather)
    channels, faults = [], {}
    for name, width in request.wanted.items():
        try:
            channels.append(replace(names.channel(name, width, columns), width=width))
        except TraceError as error:
            faults[name] = str(error)
    return Plan(times, tuple(channels), faults, tuple(names.notes))


def _everything(names: _Names, times: tuple[int, ...], columns: Mapping[str, str], gather: bool) -> Plan:
    """Return every column as a channel, under its own name unless it is mapped."""
    channels, faults = [], {}
    taken = set(columns.values())
    components = {name.partition("[")[0] for name in columns if name.endswith("]") and "[" in name}
    mapped = [*(name for name in columns if not (name.endswith("]") and "[" in name)), *components]
    found: dict[str, None] = {
        head.name: None for i, head in enumerate(names.heads) if head.name and i not in times
    }
    own = [name for name in found if name not in taken and name not in columns]
    for name in mapped:
        channels.append(names.channel(name, ANY, columns))
    for name in own:
        try:
            channels.append(names.own(name, times))
        except TraceError as error:
            faults[name] = str(error)
    if gather:
        known = {channel.name for channel in channels}
        for name, parts in names.groups():
            if name not in known:
                channels.append(Channel(name, parts, True))
    return Plan(times, tuple(channels), faults, tuple(names.notes))


class _Names:
    """The heads of a file, by name."""

    def __init__(self, heads: Sequence[Head]) -> None:
        self.heads = heads
        self.notes: list[str] = []
        self.taken: frozenset[int] = frozenset()
        self.by_name: dict[str, list[int]] = defaultdict(list)
        for number, head in enumerate(heads):
            self.by_name[head.name].append(number)
        self._numbered: dict[tuple[str, str], dict[int, list[int]]] | None = None

    @property
    def numbered(self) -> dict[tuple[str, str], dict[int, list[int]]]:
        """(name of a vector, joint) → number of a component → heads."""
        if self._numbered is None:
            self._numbered = defaultdict(lambda: defaultdict(list))
            for number, head in enumerate(self.heads):
                for stem, joint, index in _numbered(head):
                    self._numbered[stem, joint][index].append(number)
        return self._numbered

    def channel(self, name: str, width: int | None, columns: Mapping[str, str]) -> Channel:
        """Return what makes a channel.

        Raises:
            TraceError: nothing does, or several things do.
        """
        parts = {
            key: text for key, text in columns.items() if key.startswith(f"{name}[") and key.endswith("]")
        }
        if parts:
            return self._by_parts(name, width, parts)
        text = columns.get(name, name)
        exact = self.by_name.get(text, [])
        if exact:
            return self._exact(name, text, exact)
        if (component := self._component(text)) is not None:
            return Channel(name, (component,), False)
        if (loose := self._loose(text)) is not None:
            return Channel(name, (loose,), False)
        if width is not None and (group := self._group(text, width)) is not None:
            return Channel(name, group, True)
        hint = ""
        if width is None and any((text, joint) in self.numbered for joint in _JOINTS):
            hint = f"; {name!r} is one number: map it to a component, such as --map {name}={text}[0]"
        raise TraceError(f"the trace has no channel {text!r}{hint}") if hint else self._no(text)

    def _no(self, text: str) -> TraceError:
        """Return the error for a name that the file does not have, with those that it has."""
        there = dict.fromkeys(
            head.text for number, head in enumerate(self.heads) if head.name and number not in self.taken
        )
        return TraceError(f"the trace has no channel {text!r}{suggest(text, there)} it has {one_of(there)}")

    def own(self, name: str, times: Sequence[int]) -> Channel:
        """Return the channel that a file itself has under a name."""
        return self._exact(name, name, [number for number in self.by_name[name] if number not in times])

    def groups(self) -> list[tuple[str, tuple[Part, ...]]]:
        """Return (name, parts) of every set of two numbered columns or more that is a vector beyond doubt."""
        stems = defaultdict(list)
        for stem, joint in self.numbered:
            if joint != "[":
                stems[stem].append(joint)
        found = []
        for stem, joints in stems.items():
            parts = [parts for joint in joints if (parts := _complete(self.numbered[stem, joint], 2))]
            if len(parts) == 1 == len(joints) and stem not in self.by_name:
                found.append((stem, parts[0]))
        return found

    def _by_parts(self, name: str, width: int | None, texts: Mapping[str, str]) -> Channel:
        found: dict[int, Part] = {}
        for key, text in texts.items():
            digits = key[len(name) + 1 : -1]
            if not (digits.isascii() and digits.isdigit()):
                raise TraceError(
                    f"--map {key}={text}: {digits!r} is not the number of a component, from 0 on"
                )
            exact = [n for n in self.by_name.get(text, []) if self.heads[n].index is None]
            part = Part(exact[0]) if len(exact) == 1 else self._component(text)
            if part is None:
                raise self._no(text)
            found[int(digits)] = part
        if width is None:
            raise TraceError(
                f"{name!r} is one number a sample, and --map gives it components: leave out the [ ]"
            )
        count = len(found) if width == ANY else width
        lacking = sorted(set(range(count)) - set(found))
        if lacking or len(found) != count:
            wrong = f"{name}[{lacking[0]}] is missing" if lacking else f"there are {len(found)}"
            raise TraceError(f"{name!r} has components 0 to {count - 1}, of which --map gives each: {wrong}")
        return Channel(name, tuple(found[i] for i in range(count)), True)

    def _exact(self, name: str, text: str, exact: Sequence[int]) -> Channel:
        """Return the channel of the columns that have just this name."""
        plain = [number for number in exact if self.heads[number].index is None]
        if len(plain) == 1 == len(exact):
            return Channel(name, (Part(plain[0]),), False)
        if plain:
            raise TraceError(
                f"{len(exact)} columns are called {quoted(text)}; it cannot be said which one is meant"
            )
        parts: dict[int, int] = {}
        for number in exact:
            index = self.heads[number].index
            assert index is not None
            if index in parts:
                raise TraceError(f"two columns are called {quoted(self.heads[number].text)}")
            parts[index] = number
        if set(parts) != set(range(len(parts))):
            raise TraceError(
                f"the components of {quoted(text)} are not numbered {text}[0] to {text}[{len(parts) - 1}]"
            )
        return Channel(name, tuple(Part(parts[index]) for index in range(len(parts))), True)

    def _component(self, text: str) -> Part | None:
        """Return what ``position[3]`` means, or None if it is no component of anything."""
        stem, bracket, rest = text.rpartition("[")
        digits = rest.removesuffix("]")
        if not bracket or rest == digits or not (digits.isascii() and digits.isdigit()):
            return None
        index = int(digits)
        exact = self.by_name.get(stem, [])
        if len(exact) == 1 and self.heads[exact[0]].index is None:
            return Part(exact[0], index)
        found = [
            heads[0]
            for joint in _JOINTS
            if len(heads := self.numbered.get((stem, joint), {}).get(index, [])) == 1
        ]
        return Part(found[0]) if len(found) == 1 else None

    def _loose(self, text: str) -> Part | None:
        """Return the one column that is ``text`` but for a unit in brackets, ``v (m/s)`` or ``v[m/s]``; or None."""
        found = []
        for number, head in enumerate(self.heads):
            if number in self.taken:
                continue
            if head.unit is not None and text == f"{head.text} [{head.unit}]":
                found.append(Part(number))
            unit = time_units.bracketed(head.name) if head.index is None else None
            if unit is not None and unit[0] == text and head.unit is None and _is_unit(unit[1]):
                found.append(Part(number, None, unit[1]))
        return found[0] if len(found) == 1 else None

    def _group(self, text: str, width: int) -> tuple[Part, ...] | None:
        """Return the numbered columns that make a vector; None if there are none.

        Raises:
            TraceError: there are some, but not one for each component, or in several forms.
        """
        joints = [joint for joint in _JOINTS if (text, joint) in self.numbered]
        least = 1 if width == ANY else width
        groups = {joint: parts for joint in joints if (parts := _complete(self.numbered[text, joint], least))}
        if width != ANY:
            groups = {joint: parts for joint, parts in groups.items() if len(parts) == width}
        if len(groups) == 1:
            ((joint, parts),) = groups.items()
            if 0 not in self.numbered[text, joint]:
                first, last = (self.heads[parts[i].number].name for i in (0, -1))
                self.notes.append(
                    f"the components of {text!r} are read from {quoted(first)} to {quoted(last)}"
                )
            return parts
        if not joints:
            return None
        there = one_of(
            self.heads[number].text
            for joint in joints
            for heads in self.numbered[text, joint].values()
            for number in heads
        )
        what = "several forms" if groups else "other numbers than 0 on"
        count = "" if width == ANY else f" with {width} components"
        raise TraceError(
            f"the vector {text!r}{count} cannot be made of {there}, which have {what}: "
            f"map each, such as --map '{text}[0]={text}_0'"
        )

    def times(self, text: str) -> tuple[int, ...]:
        """Return the column of the times, or that of the seconds and that of what is below.

        Raises:
            TraceError: there is none; the message lists what there is.
        """
        exact = [number for number in self.by_name.get(text, []) if self.heads[number].index is None]
        if len(exact) > 1:
            raise TraceError(f"{len(exact)} columns are called {text!r}; one holds the times")
        if exact:
            self._alone(text)
            return (exact[0],)
        pair = self._given_pair(text) or self._pair(text)
        if pair is not None:
            return pair
        if (loose := self._loose(text)) is not None:
            return (loose.number,)
        names = dict.fromkeys(head.text for head in self.heads if head.name)
        likely = next((name for name in names if _TIMELY & {*_words(name)}), "time")
        for stem, (whole, below) in self._halves().items():
            likely = stem or f"{self.heads[whole].name}+{self.heads[below].name}"
        raise TraceError(
            f"there is no column {text!r} with the times; there are {one_of(names)}. "
            f"Another name is mapped like that of a signal, for example --map {TIME}={likely}"
        )

    def _alone(self, text: str) -> None:
        """Refuse one half of a time whose other half is there, too."""
        for stem, heads in self._halves().items():
            for half in heads:
                if self.heads[half].name == text and len(heads) == 2:
                    whole, below = (self.heads[number].name for number in heads)
                    given = stem or f"{whole}+{below}"
                    raise TraceError(
                        f"{quoted(text)} is one half of the times, {quoted(whole)} and {quoted(below)}: "
                        f"say --map {TIME}={given}"
                    )

    def _given_pair(self, text: str) -> tuple[int, int] | None:
        whole, plus, below = text.partition("+")
        if not plus:
            return None
        found = []
        for name in (whole.strip(), below.strip()):
            heads = [number for number in self.by_name.get(name, []) if self.heads[number].index is None]
            if len(heads) != 1:
                names = dict.fromkeys(head.text for head in self.heads if head.name)
                raise TraceError(
                    f"there is no column {name!r}{suggest(name, names)} there are {one_of(names)}"
                )
            found.append(heads[0])
        return found[0], found[1]

    def _pair(self, text: str) -> tuple[int, int] | None:
        """Return the columns ``text.sec`` and ``text.nanosec``, in any of their spellings."""
        found = self._halves().get(text)
        return (found[0], found[1]) if found and len(found) == 2 else None

    def _halves(self) -> dict[str, list[int]]:
        """Return name → the column of whole seconds and that of what is below, where there is one of each."""
        whole: dict[str, list[int]] = defaultdict(list)
        below: dict[str, list[int]] = defaultdict(list)
        for number, head in enumerate(self.heads):
            word = time_units.last_word(head.name)
            stem = head.name[: len(head.name) - len(word)].rstrip("._/:")
            if word in time_units.WHOLE - {"s"}:
                whole[stem].append(number)
            elif word in time_units.SUB and word not in ("ns", "us", "ms"):
                below[stem].append(number)
        return {
            stem: [whole[stem][0], below[stem][0]]
            for stem in whole
            if len(whole[stem]) == 1 == len(below.get(stem, []))
        }


_TIMELY = frozenset(("time", "times", "timestamp", "stamp", "stamps", "clock", "datetime"))
"""Definition: words in the names of columns that hold times, for a hint."""


def _words(name: str) -> Iterable[str]:
    return "".join(letter if letter.isalnum() else " " for letter in name[:100].lower()).split()


def _is_unit(text: str) -> bool:
    try:
        return bool(parse_unit(text).dimension) or not text.isdigit()
    except UnknownUnitError:
        return False


def _numbered(head: Head) -> Iterable[tuple[str, str, int]]:
    """Return (name of the vector, joint, number) that the name of a column may mean."""
    if head.index is not None:
        return [(head.name, "[", head.index)]
    name = head.name
    if name.endswith("]"):
        stem, _, digits = name[:-1].rpartition("[")
        joints = ["["] if stem else []
    else:
        stem = name.rstrip("0123456789")
        digits = name[len(stem) :]
        joints = [joint for joint in _JOINTS if joint and joint != "[" and stem.endswith(joint)] or [""]
        stem = stem[:-1] if joints != [""] else stem
    if not stem or not 0 < len(digits) < 7 or not (digits.isascii() and digits.isdigit()):
        return []
    return [(stem, joint, int(digits)) for joint in joints]


def _complete(numbers: Mapping[int, Sequence[int]], least: int) -> tuple[Part, ...] | None:
    """Return the components in order if they are numbered from 0 or 1 without a gap, each once."""
    start = min(numbers)
    if start > 1 or len(numbers) < least or any(len(heads) != 1 for heads in numbers.values()):
        return None
    if set(numbers) != set(range(start, start + len(numbers))):
        return None
    return tuple(Part(numbers[index][0]) for index in sorted(numbers))


def read_map(texts: Iterable[str]) -> dict[str, str]:
    """Return channel → column of texts like ``vx=velocity.x``.

    Raises:
        UsageError: a text is not of this form, or a name is mapped twice.
    """
    names: dict[str, str] = {}
    for text in texts:
        name, _, column = (part.strip() for part in text.partition("="))
        if not name or not column:
            raise UsageError("--map is written name=column, for example --map vx=velocity.x")
        if names.get(name, column) != column:
            raise UsageError(f"--map says what {name!r} is called twice: {names[name]!r} and {column!r}")
        names[name] = column
    return names
