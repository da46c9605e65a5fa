"""Find the columns of a file that hold its times, by their names.

The times are in one column, or in two: ``stamp.sec`` of whole seconds and ``stamp.nanosec`` of fractions.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence

from s2r_spec.base.errors import NoTimesError, TraceError, one_of, suggest
from s2r_spec.logs.options import TIME, map_argument
from s2r_spec.logs.table import INDEX, Head, quote
from s2r_spec.logs.times import time_units

TIME_WORDS = frozenset(
    ("time", "times", "timestamp", "timestamps", "stamp", "stamps", "clock", "datetime", "tout")
)
"""Definition: words in names of columns of times; ``tout`` is Simulink's."""


def find_times(heads: Sequence[Head], text: str, called: Sequence[int]) -> tuple[int, ...]:
    """Return the column of the times; or the two columns of whole seconds and of fractions.

    Args:
        heads: heads of the columns.
        text: name of the times, as ``--map t=`` takes it.
        called: the columns with this name, whatever unit in brackets follows it.

    Raises:
        TraceError: there is none; the message lists all columns.
    """
    halves = _halves(heads)
    exact = [number for number, head in enumerate(heads) if head.name == text and head.index is None]
    exact = [number for number in exact if not heads[number].fault] or exact
    if exact and (fault := heads[exact[0]].fault):
        raise TraceError(f"{quote(text)} {fault}; --clock and --stamps choose the times of a log of topics")
    if len(exact) > 1:
        raise _several_error(heads, text, exact)
    if exact:
        for stem, pair in halves.items():
            names = [heads[number].name for number in pair]
            if text in names:
                raise TraceError(
                    f"the times are in two columns, {quote(names[0])} and {quote(names[1])}, and {quote(text)} is one "
                    f"of them: write --map {TIME}={stem or '+'.join(names)}"
                )
        return (exact[0],)
    whole, plus, below = text.partition("+")
    if plus:
        return _only_column(heads, whole.strip()), _only_column(heads, below.strip())
    if text in halves:
        return halves[text]
    loose = called or [number for number, head in enumerate(heads) if f"{head.text} [{head.unit}]" == text]
    if len(loose) == 1:
        return (loose[0],)
    candidates = time_candidates(heads)
    if text == TIME and len(candidates) > 1:
        raise NoTimesError(
            f"there is no column {text!r} with the times; they may be {' or '.join(map(quote, candidates))}. "
            f"Choose one, as in --map {map_argument(candidates[0])}",
            candidates[0],
            candidates,
        )
    readable = _readable(heads)
    likely = next(iter(candidates), INDEX if INDEX in readable else "time")
    hint = ";" if text == TIME else suggest(text, readable)
    raise NoTimesError(
        f"there is no column {text!r} with the times{hint} the columns are {one_of(readable)}. "
        f"Map another name, for example --map {map_argument(likely)}",
        likely,
    )


def _several_error(heads: Sequence[Head], text: str, exact: Sequence[int]) -> TraceError:
    """Return the error of several columns with one name, which asks for one if their units differ."""
    full = tuple(dict.fromkeys(_full_names(heads, exact)))
    if len(full) < len(exact):
        return TraceError(
            f"{len(exact)} columns are called {text!r}; only one may hold the times, so rename the others"
        )
    return NoTimesError(
        f"the times may be {' or '.join(map(quote, full))}. Choose one, as in --map {map_argument(full[0])}",
        full[0],
        full,
    )


def time_candidates(heads: Sequence[Head]) -> tuple[str, ...]:
    """Return the columns whose names say that they hold times, as ``--map t=`` takes them; pairs of halves first."""
    halves = _halves(heads)
    pairs = [stem or "+".join(heads[number].name for number in pair) for stem, pair in halves.items()]
    taken = {number for pair in halves.values() for number in pair}
    words = [
        number
        for number, head in enumerate(heads)
        if number not in taken
        and head.name
        and not head.fault
        and TIME_WORDS & {*time_units.words(head.text[:100])}
    ]
    return tuple(dict.fromkeys([*pairs, *_full_names(heads, words)]))


def _full_names(heads: Sequence[Head], numbers: Sequence[int]) -> list[str]:
    """Return the names of columns, with the unit where the name alone is that of several."""
    counts = Counter(head.name for head in heads)
    return [
        f"{head.text} [{head.unit}]"
        if head.unit is not None and head.index is None and counts[head.name] > 1
        else head.text
        for head in (heads[number] for number in numbers)
    ]


def _readable(heads: Sequence[Head]) -> dict[str, None]:
    return dict.fromkeys(head.text for head in heads if head.name and not head.fault)


def _only_column(heads: Sequence[Head], name: str) -> int:
    numbers = [number for number, head in enumerate(heads) if head.name == name and head.index is None]
    if len(numbers) != 1:
        readable = _readable(heads)
        raise TraceError(
            f"there is no column {name!r}{suggest(name, readable)} the columns are {one_of(readable)}"
        )
    return numbers[0]


def _halves(heads: Sequence[Head]) -> dict[str, tuple[int, int]]:
    """Return name → columns of whole seconds and of fractions, in any spelling, if there is one of each."""
    whole: dict[str, list[int]] = defaultdict(list)
    below: dict[str, list[int]] = defaultdict(list)
    for number, head in enumerate(heads):
        word = time_units.last_word(head.name)
        stem = head.name[: len(head.name) - len(word)].rstrip("._/:")
        if word in time_units.WHOLE - {"s"}:
            whole[stem].append(number)
        elif word in time_units.SUB and word not in ("ns", "us", "ms"):
            below[stem].append(number)
    return {
        stem: (numbers[0], below[stem][0])
        for stem, numbers in whole.items()
        if len(numbers) == 1 == len(below.get(stem, ()))
    }
