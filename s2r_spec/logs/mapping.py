"""Map the columns of a file to channels, from their names, the channels of the spec, and ``--map``.

A vector is one column of lists, or one column per component: ``q[0]``, ``q_0``, ``q.0``, ``q/0`` or ``q0``, numbered
from 0 or 1 without a gap. ``position[3]`` is one component of either form. A unit in brackets at the end of a name,
``v(m/s)`` or ``q_0 [deg]``, is the unit of the column; a spec and ``--map`` may leave it out. Any other text in
brackets is part of the name. ``v [m/s]`` in ``--map`` states the unit, whatever the file writes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from typing import Any

from s2r_spec.base.errors import TraceError, one_of, suggest
from s2r_spec.lang.units import UnknownUnitError, is_unit, parse_unit
from s2r_spec.logs.options import TIME
from s2r_spec.logs.table import Head, quote
from s2r_spec.logs.time_columns import find_times
from s2r_spec.logs.times import time_units

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


def plan_columns(heads: Sequence[Head], request: ColumnRequest) -> ColumnPlan:
    """Return the columns of the times and of each channel.

    Raises:
        TraceError: there is no column of times; the message lists all columns.
    """
    names = _Names(heads)
    text = request.columns.get(TIME, TIME)
    times = find_times(heads, text, names.columns_called(text))
    names.taken = frozenset(times)
    columns = {name: text for name, text in request.columns.items() if name != TIME}
    if request.wanted is None:
        return _plan_all(names, times, columns, request)
    channels, faults = [], {}
    for name, width in request.wanted.items():
        try:
            channels.append(replace(names.channel(name, width, columns), width=width))
        except TraceError as error:
            faults[name] = str(error)
    return ColumnPlan(times, tuple(channels), faults, tuple(names.notes))


def _plan_all(
    names: _Names, times: tuple[int, ...], columns: Mapping[str, str], request: ColumnRequest
) -> ColumnPlan:
    """Return a plan with every column as a channel, under its own name unless it is mapped."""
    bracketed = {name: name.partition("[")[0] for name in columns if name.endswith("]") and "[" in name}
    vectors = dict.fromkeys(stem for name, stem in bracketed.items() if name != columns[name])
    mapped = [*(name for name in columns if bracketed.get(name) not in vectors), *vectors]
    channels = [names.channel(name, ANY, columns) for name in mapped]
    faults = {}
    own = dict.fromkeys(
        head.name for i, head in enumerate(names.heads) if head.name and i not in times and not head.fault
    )
    for name in own:
        hidden = request.identifiers and not name.isidentifier()
        if not hidden and name not in columns and name not in columns.values():
            try:
                numbers = [number for number in names.by_name[name] if number not in times]
                channels.append(names.exact(name, name, numbers))
            except TraceError as error:
                faults[name] = str(error)
    if request.gather:
        known = {channel.name for channel in channels}
        for channel in names.groups():
            if channel.name not in known and (channel.name.isidentifier() or not request.identifiers):
                channels.append(channel)
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

    @cached_property
    def numbered(self) -> dict[tuple[str, str], dict[int, list[int]]]:
        """(name of a vector, separator) → number of a component → heads."""
        numbered: dict[Any, dict[int, list[int]]] = defaultdict(lambda: defaultdict(list))
        for number, head in enumerate(self.heads):
            stem, _ = self.bracketed.get(number, (head.name, ""))
            for name in () if head.fault else {head.name, stem}:
                for vector, separator, index in _numbered_names(name, head.index):
                    numbered[vector, separator][index].append(number)
        return numbered

    def channel(self, name: str, width: int | None, columns: Mapping[str, str]) -> MappedChannel:
        parts = {
            key: text for key, text in columns.items() if key.startswith(f"{name}[") and key.endswith("]")
        }
        if any(key != text for key, text in parts.items()):
            return self._by_parts(name, width, parts)
        text = columns.get(name, name)
        if (channel := self._called(name, text, width)) is not None:
            return channel
        if width is None and any((text, separator) in self.numbered for separator in _SEPARATORS):
            raise TraceError(
                f"the trace has no channel {text!r}; {name!r} is one number: map it to a component, such as "
                f"--map {name}={text}[0]"
            )
        raise self._missing_error(text, name)

    def _called(self, name: str, text: str, width: int | None) -> MappedChannel | None:
        return self._from_columns(name, text, width) or self._with_stated_unit(name, text, width)

    def _from_columns(self, name: str, text: str, width: int | None) -> MappedChannel | None:
        if called := self.columns_called(text):
            return self.exact(name, text, called)
        if (component := self._component(text)) is not None:
            return MappedChannel(name, (component,), False)
        if width is not None and (group := self._group(text, width)) is not None:
            return MappedChannel(name, group, True)
        return None

    def columns_called(self, text: str) -> list[int]:
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

    def groups(self) -> Iterator[MappedChannel]:
        """Yield every unambiguous vector of two or more numbered columns."""
        separators: dict[str, list[str]] = defaultdict(list)
        for stem, separator in self.numbered:
            if separator != "[":
                separators[stem].append(separator)
        for stem, (first, *more) in separators.items():
            columns = _complete(self.numbered[stem, first], 2)
            if columns and not more and stem not in self.by_name:
                yield MappedChannel(stem, tuple(map(self._part, columns)), True)

    def _by_parts(self, name: str, width: int | None, texts: Mapping[str, str]) -> MappedChannel:
        parts: dict[int, ColumnPart] = {}
        for key, text in texts.items():
            digits = key[len(name) + 1 : -1]
            if not (digits.isascii() and digits.isdigit()):
                raise TraceError(
                    f"--map {key}={text}: {digits!r} is not the number of a component; numbers begin at 0"
                )
            component = self._called(key, text, None)
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

    def exact(self, name: str, text: str, exact: Sequence[int]) -> MappedChannel:
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
        called = self.columns_called(stem)
        if len(called) == 1 and self.heads[called[0]].index is None:
            return self._part(called[0], index)
        columns = [
            heads[0]
            for separator in _SEPARATORS
            if len(heads := self.numbered.get((stem, separator), {}).get(index, [])) == 1
        ]
        return self._part(columns[0]) if len(columns) == 1 else None

    def _with_stated_unit(self, name: str, text: str, width: int | None) -> MappedChannel | None:
        """Return the channel of ``v [m/s]`` in this unit, with a note where the file writes another."""
        split = time_units.split_brackets(text)
        if split is None or split[1].isdigit():
            return None
        column, unit = split
        if (channel := self._called(name, column, width)) is None:
            return None
        if not is_unit(unit):
            if not any(head.unit is not None and f"{head.text} [{head.unit}]" == text for head in self.heads):
                raise TraceError(
                    f"{quote(unit)} is not a unit: write --map '{name}={column}', or a unit such as [m/s]"
                )
            return channel
        files = {part.unit or self.heads[part.number].unit for part in channel.parts}
        self.notes += [
            f"{name!r} is read in {unit}, as --map states; the file writes the unit {quote(written)}"
            for written in sorted(one for one in files if one is not None and not _alike(one, unit))
        ]
        return replace(channel, parts=tuple(replace(part, unit=unit) for part in channel.parts))

    def _group(self, text: str, width: int) -> tuple[ColumnPart, ...] | None:
        separators = [separator for separator in _SEPARATORS if (text, separator) in self.numbered]
        groups = {
            separator: columns
            for separator in separators
            if (columns := _complete(self.numbered[text, separator], 1)) and width in (ANY, len(columns))
        }
        if len(groups) == 1:
            ((separator, columns),) = groups.items()
            if 0 not in self.numbered[text, separator]:
                first, last = (self.heads[columns[place]].name for place in (0, -1))
                self.notes.append(f"the components of {text!r} are read from {quote(first)} to {quote(last)}")
            return tuple(map(self._part, columns))
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
