"""Map the columns of a file to channels, from their names, the channels of the spec, and ``--map``.

A vector is one column of lists, or one column per component: ``q[0]``, ``q_0``, ``q.0``, ``q/0`` or ``q0``, numbered
from 0 or 1 without a gap. ``position[3]`` is one component of either form. A unit in brackets at the end of a name,
``v(m/s)`` or ``q_0 [deg]``, is the unit of the column; a spec and ``--map`` may leave it out. Any other text in
brackets is part of the name. ``v [m/s]`` in ``--map`` states the unit, whatever the file writes.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches

from s2r_spec.base.errors import NoTimesError, TraceError, UsageError, one_of, suggest
from s2r_spec.lang.units import UnknownUnitError, is_unit, parse_unit
from s2r_spec.logs.table import INDEX, Head, quote
from s2r_spec.logs.times import time_units
from s2r_spec.logs.times.times import TIME, map_argument

ANY = -1
"""Definition: width of a channel that may be a number or a vector."""

_SEPARATORS = ("_", ".", "/", ":", "[", "")
"""Definition: text between the name of a vector and the number of a component."""


@dataclass(frozen=True)
class ColumnRequest:
    """The channels to read from a file.

    Args:
        columns: channel, ``t`` or component ``q[1]`` → name of its column.
        wanted: channel → None for one number per sample, its width for a vector, or :data:`ANY`; None for all columns.
        time_unit: unit of times that are plain numbers without a unit.
        gather: if all columns are read, whether to make vectors of numbered columns.
        identifiers: if all columns are read, whether to leave out those whose names no spec can have.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    wanted: Mapping[str, int | None] | None = None
    time_unit: str | None = None
    gather: bool = False
    identifiers: bool = False


@dataclass(frozen=True)
class ColumnPart:
    """A column, or one component of a column of vectors; and the unit in brackets in the column's name, if any."""

    number: int
    component: int | None = None
    unit: str | None = None


@dataclass(frozen=True)
class MappedChannel:
    """The parts of a channel, whether it is a vector (a single part may be one), and its requested width."""

    name: str
    parts: tuple[ColumnPart, ...]
    vector: bool
    width: int | None = ANY


@dataclass(frozen=True)
class ColumnPlan:
    """The columns to read from a file.

    Args:
        times: the column of the times; or the two columns of whole seconds and of fractions.
        channels: the channels in order.
        faults: channel → why it cannot be made.
        notes: decisions by names alone, one sentence each.
    """

    times: tuple[int, ...]
    channels: tuple[MappedChannel, ...]
    faults: Mapping[str, str]
    notes: tuple[str, ...]

    @property
    def needed(self) -> set[int]:
        """Numbers of the columns to read."""
        return {*self.times, *(part.number for channel in self.channels for part in channel.parts)}


def time_candidates(heads: Sequence[Head]) -> tuple[str, ...]:
    """Return the columns whose names say that they hold times, as ``--map t=`` takes them."""
    return _Names(heads).candidates()


def plan_columns(heads: Sequence[Head], request: ColumnRequest) -> ColumnPlan:
    """Return the columns of the times and of each channel.

    Raises:
        TraceError: there is no column of times; the message lists all columns.
    """
    names = _Names(heads)
    times = names.times(request.columns.get(TIME, TIME))
    names.taken = frozenset(times)
    columns = {name: text for name, text in request.columns.items() if name != TIME}
    if request.wanted is None:
        return plan_all(names, times, columns, request)
    channels, faults = [], {}
    for name, width in request.wanted.items():
        try:
            channels.append(replace(names.channel(name, width, columns), width=width))
        except TraceError as error:
            faults[name] = str(error)
    return ColumnPlan(times, tuple(channels), faults, tuple(names.notes))


def plan_all(
    names: _Names, times: tuple[int, ...], columns: Mapping[str, str], request: ColumnRequest
) -> ColumnPlan:
    """Return a plan with every column as a channel, under its own name unless it is mapped."""
    channels, faults = [], {}
    mapped_columns = set(columns.values())
    bracketed = {name: name.partition("[")[0] for name in columns if name.endswith("]") and "[" in name}
    vectors = {stem for name, stem in bracketed.items() if name != columns[name]}
    components = {name for name, stem in bracketed.items() if stem in vectors}
    mapped = [
        *(name for name in columns if name not in components),
        *vectors,
    ]
    names_in_file: dict[str, None] = {
        head.name: None
        for i, head in enumerate(names.heads)
        if head.name
        and i not in times
        and not head.fault
        and (head.name.isidentifier() or not request.identifiers)
    }
    own = [name for name in names_in_file if name not in mapped_columns and name not in columns]
    for name in mapped:
        channels.append(names.channel(name, ANY, columns))
    for name in own:
        try:
            channels.append(names.own(name, times))
        except TraceError as error:
            faults[name] = str(error)
    if request.gather:
        known = {channel.name for channel in channels}
        for name, parts in names.groups():
            if name not in known and (name.isidentifier() or not request.identifiers):
                channels.append(MappedChannel(name, parts, True))
    return ColumnPlan(times, tuple(channels), faults, tuple(names.notes))


class _Names:
    """The heads of a file's columns, by name, and by name without a unit in brackets."""

    def __init__(self, heads: Sequence[Head]) -> None:
        self.heads = heads
        self.notes: list[str] = []
        self.taken: frozenset[int] = frozenset()
        self.by_name: dict[str, list[int]] = defaultdict(list)
        self.by_stem: dict[str, list[int]] = defaultdict(list)
        self.bracketed: dict[int, tuple[str, str]] = {}
        for number, head in enumerate(heads):
            self.by_name[head.name].append(number)
            split = time_units.split_brackets(head.name) if head.unit is None else None
            if split is not None and is_unit(split[1]):
                self.bracketed[number] = split
                self.by_stem[split[0]].append(number)
        self._numbered: dict[tuple[str, str], dict[int, list[int]]] | None = None

    @property
    def numbered(self) -> dict[tuple[str, str], dict[int, list[int]]]:
        """(name of a vector, separator) → number of a component → heads."""
        if self._numbered is None:
            self._numbered = defaultdict(lambda: defaultdict(list))
            for number, head in enumerate(self.heads):
                stem, _ = self.bracketed.get(number, (head.name, ""))
                for name in () if head.fault else {head.name, stem}:
                    for vector, separator, index in _numbered_names(name, head.index):
                        self._numbered[vector, separator][index].append(number)
        return self._numbered

    def channel(self, name: str, width: int | None, columns: Mapping[str, str]) -> MappedChannel:
        """Return the parts of a channel.

        Raises:
            TraceError: no column makes it, or the choice is ambiguous.
        """
        parts = {
            key: text for key, text in columns.items() if key.startswith(f"{name}[") and key.endswith("]")
        }
        if any(key != text for key, text in parts.items()):
            return self._by_parts(name, width, parts)
        text = columns.get(name, name)
        if (
            channel := self._from_columns(name, text, width) or self._with_stated_unit(name, text, width)
        ) is not None:
            return channel
        hint = ""
        if width is None and any((text, separator) in self.numbered for separator in _SEPARATORS):
            hint = f"; {name!r} is one number: map it to a component, such as --map {name}={text}[0]"
        raise (
            TraceError(f"the trace has no channel {text!r}{hint}")
            if hint
            else self._missing_error(text, name)
        )

    def _from_columns(self, name: str, text: str, width: int | None) -> MappedChannel | None:
        """Return the channel that a name of columns makes; None if there are no such columns."""
        if called := self._columns_called(text):
            return self._exact(name, text, called)
        if (component := self._component(text)) is not None:
            return MappedChannel(name, (component,), False)
        if width is not None and (group := self._group(text, width)) is not None:
            return MappedChannel(name, group, True)
        return None

    def _columns_called(self, text: str) -> list[int]:
        """Return the columns with this name, else the one column (or all components) with it and a unit in brackets."""
        if exact := self.by_name.get(text, []):
            return exact
        numbers = [number for number in self.by_stem.get(text, []) if number not in self.taken]
        indexed = all(self.heads[number].index is not None for number in numbers)
        return numbers if len(numbers) == 1 or indexed else []

    def _part(self, number: int, component: int | None = None) -> ColumnPart:
        """Return a column, or a component of it, with the unit in brackets in its name."""
        return ColumnPart(number, component, self.bracketed.get(number, ("", None))[1])

    def _missing_error(self, text: str, name: str) -> TraceError:
        """Return the error for a channel whose column the file lacks; it lists the file's names."""
        for head in self.heads:  # a topic that cannot be read has no fields
            if head.fault and head.name and text.startswith(f"{head.name}."):
                return TraceError(f"{head.name} {head.fault}")
        names = dict.fromkeys(
            head.text
            for number, head in enumerate(self.heads)
            if head.name and number not in self.taken and not head.fault
        )
        mapped = "" if name != text else f". Map one of them, as in --map {name}=NAME"
        return TraceError(
            f"the trace has no channel {text!r}{suggest(text, names)} it has {_likely(text, names)}{mapped}"
        )

    def own(self, name: str, times: Sequence[int]) -> MappedChannel:
        """Return the channel with exactly this name in the file."""
        return self._exact(name, name, [number for number in self.by_name[name] if number not in times])

    def groups(self) -> list[tuple[str, tuple[ColumnPart, ...]]]:
        """Return (name, parts) of every unambiguous vector of two or more numbered columns."""
        separators_of = defaultdict(list)
        for stem, separator in self.numbered:
            if separator != "[":
                separators_of[stem].append(separator)
        vectors = []
        for stem, separators in separators_of.items():
            parts = [
                tuple(map(self._part, columns))
                for separator in separators
                if (columns := _complete(self.numbered[stem, separator], 2))
            ]
            if len(parts) == 1 == len(separators) and stem not in self.by_name:
                vectors.append((stem, parts[0]))
        return vectors

    def _by_parts(self, name: str, width: int | None, texts: Mapping[str, str]) -> MappedChannel:
        parts: dict[int, ColumnPart] = {}
        for key, text in texts.items():
            digits = key[len(name) + 1 : -1]
            if not (digits.isascii() and digits.isdigit()):
                raise TraceError(
                    f"--map {key}={text}: {digits!r} is not the number of a component; numbers begin at 0"
                )
            component = self._from_columns(key, text, None) or self._with_stated_unit(key, text, None)
            if component is None or len(component.parts) != 1:
                raise self._missing_error(text, key)
            parts[int(digits)] = component.parts[0]
        if width is None:
            raise TraceError(
                f"{name!r} is one number per sample, but --map gives it components: leave out the [ ]"
            )
        count = len(parts) if width == ANY else width
        lacking = sorted(set(range(count)) - set(parts))
        if lacking or len(parts) != count:
            fault = f"{name}[{lacking[0]}] is missing" if lacking else f"there are {len(parts)}"
            raise TraceError(f"--map must give every component of {name!r}, from 0 to {count - 1}: {fault}")
        return MappedChannel(name, tuple(parts[i] for i in range(count)), True)

    def _exact(self, name: str, text: str, exact: Sequence[int]) -> MappedChannel:
        """Return the channel of the columns with exactly this name."""
        plain = [number for number in exact if self.heads[number].index is None]
        if len(exact) == 1 and (fault := self.heads[exact[0]].fault):
            raise TraceError(f"{quote(text)} {fault}")
        if len(plain) == 1 == len(exact):
            return MappedChannel(name, (self._part(plain[0]),), False)
        if plain:
            raise TraceError(f"{len(exact)} columns are called {quote(text)}; give them different names")
        parts: dict[int, int] = {}
        for number in exact:
            index = self.heads[number].index
            assert index is not None
            if index in parts:
                raise TraceError(
                    f"two columns are called {quote(self.heads[number].text)}; give them different names"
                )
            parts[index] = number
        if set(parts) != set(range(len(parts))):
            raise TraceError(
                f"the components of {quote(text)} must be numbered {text}[0] to {text}[{len(parts) - 1}]"
            )
        return MappedChannel(name, tuple(self._part(parts[index]) for index in range(len(parts))), True)

    def _component(self, text: str) -> ColumnPart | None:
        """Return the component that ``position[3]`` names; None if there is no such component."""
        stem, bracket, rest = text.rpartition("[")
        digits = rest.removesuffix("]")
        if not bracket or rest == digits or not (digits.isascii() and digits.isdigit()):
            return None
        index = int(digits)
        called = self._columns_called(stem)
        if len(called) == 1 and self.heads[called[0]].index is None:
            return self._part(called[0], index)
        columns = [
            heads[0]
            for separator in _SEPARATORS
            if len(heads := self.numbered.get((stem, separator), {}).get(index, [])) == 1
        ]
        return self._part(columns[0]) if len(columns) == 1 else None

    def _with_stated_unit(self, name: str, text: str, width: int | None) -> MappedChannel | None:
        """Return the channel of ``v [m/s]``, in this unit; None if there is none.

        A note says so where the file writes another unit.

        Raises:
            TraceError: the text in square brackets is not a unit.
        """
        split = time_units.split_brackets(text)
        if split is None or split[1].isdigit():
            return None
        column, unit = split
        channel = self._from_columns(name, column, width) or self._with_stated_unit(name, column, width)
        if channel is None:
            return None
        if not is_unit(unit):
            written = next((head.unit for head in self.heads if f"{head.text} [{head.unit}]" == text), None)
            if written is None:
                raise TraceError(
                    f"{quote(unit)} is not a unit: write --map '{name}={column}', or a unit such as [m/s]"
                )
            return channel
        files = {part.unit or self.heads[part.number].unit for part in channel.parts}
        for written in sorted(one for one in files if one is not None and not _alike(one, unit)):
            self.notes.append(
                f"{name!r} is read in {unit}, as --map states; the file writes the unit {quote(written)}"
            )
        return replace(channel, parts=tuple(replace(part, unit=unit) for part in channel.parts))

    def _group(self, text: str, width: int) -> tuple[ColumnPart, ...] | None:
        """Return the numbered columns of a vector; None if there are none.

        Raises:
            TraceError: a component has no column or several, or the columns have several forms.
        """
        separators = [separator for separator in _SEPARATORS if (text, separator) in self.numbered]
        least = 1 if width == ANY else width
        groups = {
            separator: tuple(map(self._part, columns))
            for separator in separators
            if (columns := _complete(self.numbered[text, separator], least))
        }
        if width != ANY:
            groups = {separator: parts for separator, parts in groups.items() if len(parts) == width}
        if len(groups) == 1:
            ((separator, parts),) = groups.items()
            if 0 not in self.numbered[text, separator]:
                first, last = (self.heads[parts[i].number].name for i in (0, -1))
                self.notes.append(f"the components of {text!r} are read from {quote(first)} to {quote(last)}")
            return parts
        if not separators:
            return None
        listed = one_of(
            self.heads[number].text
            for separator in separators
            for heads in self.numbered[text, separator].values()
            for number in heads
        )
        fault = "have several forms" if groups else "are not numbered from 0 without a gap"
        count = "" if width == ANY else f" with {width} components"
        raise TraceError(
            f"the columns {listed} cannot make the vector {text!r}{count}, because they {fault}: "
            f"map each, such as --map '{text}[0]={text}_0'"
        )

    def times(self, text: str) -> tuple[int, ...]:
        """Return the column of the times; or the two columns of whole seconds and of fractions.

        Raises:
            TraceError: there is none; the message lists all columns.
        """
        exact = [number for number in self.by_name.get(text, []) if self.heads[number].index is None]
        exact = [number for number in exact if not self.heads[number].fault] or exact
        if exact and (fault := self.heads[exact[0]].fault):
            raise TraceError(
                f"{quote(text)} {fault}; --clock and --stamps choose the times of a log of topics"
            )
        if len(exact) > 1:
            full = tuple(dict.fromkeys(self._full_name(number) for number in exact))
            if len(full) == len(exact):
                columns_text = " or ".join(map(quote, full))
                raise NoTimesError(
                    f"the times may be {columns_text}. Choose one, as in --map {map_argument(full[0])}",
                    full[0],
                    full,
                )
            raise TraceError(
                f"{len(exact)} columns are called {text!r}; only one may hold the times, so rename the others"
            )
        if exact:
            self._refuse_half(text)
            return (exact[0],)
        pair = self._explicit_pair(text) or self._pair(text)
        if pair is not None:
            return pair
        loose = self._columns_called(text) or [
            number for number, head in enumerate(self.heads) if f"{head.text} [{head.unit}]" == text
        ]
        if len(loose) == 1:
            return (loose[0],)
        names = dict.fromkeys(head.text for head in self.heads if head.name and not head.fault)
        candidates = self.candidates() if text == TIME else ()
        if len(candidates) > 1:
            raise NoTimesError(
                f"there is no column {text!r} with the times; they may be {' or '.join(map(quote, candidates))}. "
                f"Choose one, as in --map {map_argument(candidates[0])}",
                candidates[0],
                candidates,
            )
        likely = next(iter(self.candidates()), INDEX if INDEX in names else "time")
        hint = ";" if text == TIME else suggest(text, names)
        raise NoTimesError(
            f"there is no column {text!r} with the times{hint} the columns are {one_of(names)}. "
            f"Map another name, for example --map {map_argument(likely)}",
            likely,
        )

    def candidates(self) -> tuple[str, ...]:
        """Return the columns that hold times by their names, as ``--map t=`` takes them; pairs of halves first."""
        halves = self._halves()
        pairs = [
            stem or f"{self.heads[whole].name}+{self.heads[below].name}"
            for stem, (whole, below) in halves.items()
        ]
        taken = {number for pair in halves.values() for number in pair}
        words = [
            number
            for number, head in enumerate(self.heads)
            if number not in taken and head.name and not head.fault and TIME_WORDS & {*_words(head.text)}
        ]
        return tuple(dict.fromkeys([*pairs, *map(self._full_name, words)]))

    def _full_name(self, number: int) -> str:
        """Return the name of a column, with its unit if the name alone is that of several."""
        head = self.heads[number]
        several = len(self.by_name[head.name]) > 1 and head.index is None
        return head.text if head.unit is None or not several else f"{head.text} [{head.unit}]"

    def _refuse_half(self, text: str) -> None:
        """Refuse one column of a pair of seconds and fractions."""
        for stem, heads in self._halves().items():
            for half in heads:
                if self.heads[half].name == text and len(heads) == 2:
                    whole, below = (self.heads[number].name for number in heads)
                    pair = stem or f"{whole}+{below}"
                    raise TraceError(
                        f"the times are in two columns, {quote(whole)} and {quote(below)}, and {quote(text)} is "
                        f"one of them: write --map {TIME}={pair}"
                    )

    def _explicit_pair(self, text: str) -> tuple[int, int] | None:
        whole, plus, below = text.partition("+")
        if not plus:
            return None
        columns = []
        for name in (whole.strip(), below.strip()):
            heads = [number for number in self.by_name.get(name, []) if self.heads[number].index is None]
            if len(heads) != 1:
                names = dict.fromkeys(head.text for head in self.heads if head.name and not head.fault)
                raise TraceError(
                    f"there is no column {name!r}{suggest(name, names)} the columns are {one_of(names)}"
                )
            columns.append(heads[0])
        return columns[0], columns[1]

    def _pair(self, text: str) -> tuple[int, int] | None:
        """Return the columns ``text.sec`` and ``text.nanosec``, in any of their spellings."""
        halves = self._halves().get(text)
        return (halves[0], halves[1]) if halves and len(halves) == 2 else None

    def _halves(self) -> dict[str, list[int]]:
        """Return name → columns of whole seconds and of fractions, if there is one of each."""
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


_SHOWN = 12
"""Budget: names that an error lists in full."""


def _likely(text: str, names: Collection[str]) -> str:
    """Return the names for an error: all, or of many the fields of the topic that was named, else the closest."""
    if len(names) <= _SHOWN:
        return one_of(names)
    below = [name for name in names if name.startswith(f"{text}.")]
    close = below[:_SHOWN] or get_close_matches(text, list(names)[:10_000], n=_SHOWN // 2, cutoff=0.5)
    if not close:
        return f"{one_of(names)} (`s2r log` lists the names)"
    return f"{one_of(close)} and {len(names) - len(close)} more, which `s2r log` lists"


TIME_WORDS = frozenset(
    ("time", "times", "timestamp", "timestamps", "stamp", "stamps", "clock", "datetime", "tout")
)
"""Definition: words in names of columns of times; ``tout`` is Simulink's."""


def _words(name: str) -> Iterable[str]:
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name[:100])]


def _alike(written: str, stated: str) -> bool:
    """Return whether a unit of a file is the stated one, in other words at most."""
    try:
        return replace(parse_unit(written), text="") == replace(parse_unit(stated), text="")
    except UnknownUnitError:
        return False


def _numbered_names(name: str, index: int | None) -> Iterable[tuple[str, str, int]]:
    """Return the possible meanings of a column's name: (name of the vector, separator, number)."""
    if index is not None:
        return [(name, "[", index)]
    if name.endswith("]"):
        stem, _, digits = name[:-1].rpartition("[")
        separators = ["["] if stem else []
    else:
        stem = name.rstrip("0123456789")
        digits = name[len(stem) :]
        separators = [mark for mark in _SEPARATORS if mark and mark != "[" and stem.endswith(mark)] or [""]
        stem = stem[:-1] if separators != [""] else stem
    if not stem or not 0 < len(digits) < 7 or not (digits.isascii() and digits.isdigit()):
        return []
    return [(stem, separator, int(digits)) for separator in separators]


def _complete(numbers: Mapping[int, Sequence[int]], least: int) -> tuple[int, ...] | None:
    """Return the columns in order if their numbers begin at 0 or 1 and have no gap, each once; else None."""
    start = min(numbers)
    if start > 1 or len(numbers) < least or any(len(heads) != 1 for heads in numbers.values()):
        return None
    if set(numbers) != set(range(start, start + len(numbers))):
        return None
    return tuple(numbers[index][0] for index in sorted(numbers))


def read_map(texts: Iterable[str]) -> dict[str, str]:
    """Return channel → column, from texts like ``vx=velocity.x``.

    Raises:
        UsageError: a text is not of this form, or a name is mapped twice.
    """
    names: dict[str, str] = {}
    for text in texts:
        name, _, column = (part.strip() for part in text.partition("="))
        if not name or not column:
            raise UsageError(f"--map {text!r} is not name=column, such as --map vx=velocity.x")
        if names.get(name, column) != column:
            raise UsageError(f"--map maps {name!r} twice, to {names[name]!r} and to {column!r}; map it once")
        names[name] = column
    return names
