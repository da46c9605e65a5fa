"""Candidate mistakes, each undone: a search over the channels that share one, and over its size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.quality.finding import Finding

FloatArray = NDArray[np.float64]
Group = frozenset[str]
"""Channels that share a mistake."""

SHOWN = 6
"""Definition: channels that a sentence names; of more the number is said. Doubled, sentences get longer."""
PER_RADIAN = {"rad": 1.0, "deg": 180.0 / np.pi}
"""Definition: units of angles, and how many of it a radian is."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """A mistake of a certain size in certain channels, and the recordings without it.

    Attributes:
        finding: what is said of it.
        values: (n, T, c) recordings after undoing it.
        beside: what they are compared with then; None for the same as before.
        there: of 1 and 0, (T, 1) which instants can be read when it is undone, or (n, 1, 1) which recordings count.
        volume: 2 log |∂ recorded / ∂ undone|, a number of a recording: what shrinks everything must explain better.
    """

    finding: Finding
    values: FloatArray
    beside: Comparison | None = None
    there: FloatArray | float = 1.0
    volume: float = 0.0


def channels(c: Comparison) -> tuple[str, ...]:
    """Return the names of the channels that are compared, in order."""
    return tuple(dict.fromkeys(column.channel for column in c.columns))


def mask(c: Comparison, group: Group) -> NDArray[np.bool_]:
    """Return (c,) which columns are of these channels."""
    return np.array([column.channel in group for column in c.columns])


def alone(c: Comparison, group: Group) -> list[Group]:
    """Return groups of one channel each."""
    return [frozenset([name]) for name in channels(c) if name in group]


def named(c: Comparison, group: Group) -> str:
    """Return the channels of a group in words."""
    return listed([name for name in channels(c) if name in group])


def listed(names: Sequence[str]) -> str:
    """Return "x, y and heading"."""
    if len(names) > SHOWN:
        return f"{', '.join(names[:SHOWN])} and {len(names) - SHOWN} more"
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def by_unit(c: Comparison) -> dict[str, Group]:
    """Return unit → the channels that have it."""
    units = dict.fromkeys(column.unit for column in c.columns)
    return {unit: frozenset(one.channel for one in c.columns if one.unit == unit) for unit in units}


def undo(c: Comparison, undone: FloatArray, group: Group) -> FloatArray:
    """Return (n, T, c) with the columns of these channels taken from ``undone``."""
    return np.where(mask(c, group), undone, c.recorded)


def refined(loss: Callable[[float], float], x: float, low: float, high: float, rounds: int = 3) -> float:
    """Return the place of the least loss between two ends: the best of nine, a few times ever closer."""
    least = loss(x)
    for _ in range(rounds):
        found, at = min((loss(each), each) for each in np.linspace(low, high, 9).tolist())
        if found < least:
            least, x = found, at
        step = (high - low) / 8
        low, high = x - step, x + step
    return x


def best_group(
    c: Comparison,
    undone: FloatArray,
    begin: Group,
    among: Group,
    price: Callable[[Group], float] = lambda _: 0.0,
) -> tuple[Group, float]:
    """Return the channels, and Q with its price, where adding or dropping one of them lowers it no more."""
    group, best = begin, c.misfit(undo(c, undone, begin)) + price(begin)
    while True:
        others = [changed for one in alone(c, among) if (changed := group ^ one)]
        tried = [(c.misfit(undo(c, undone, other)) + price(other), other) for other in others]
        if not tried or (least := min(tried, key=lambda one: one[0]))[0] >= best:
            return group, best
        best, group = least


def search(
    c: Comparison,
    sizes: Sequence[float],
    undone: Callable[[float], FloatArray],
    among: Group | None = None,
    price: Callable[[float, Group], float] = lambda size, group: 0.0,
) -> tuple[float, Group, float]:
    """Return the size, the channels and Q of the mistake of one kind that leaves least.

    Args:
        c: the recordings.
        sizes: that are tried, rising; the best is refined between its neighbours.
        undone: from a size to (n, T, c) with the mistake undone in every channel.
        among: the channels that can have it; all if not given.
        price: that is added to Q; see :class:`Suspect`.
    """
    among = frozenset(channels(c)) if among is None else among

    def loss(values: FloatArray, size: float, group: Group) -> float:
        return c.misfit(undo(c, values, group)) + price(size, group)

    first = [
        (loss(values, size, group), size, group)
        for size in sizes
        for values in [undone(size)]
        for group in _starts(c, values, among)
    ]
    _, size, group = min(first, key=lambda one: one[0])
    group, _ = best_group(c, undone(size), group, among, partial(price, size))
    place = list(sizes).index(size)
    low, high = sizes[max(place - 1, 0)], sizes[min(place + 1, len(sizes) - 1)]
    size = refined(lambda x: loss(undone(x), x, group), size, low, high)
    return size, *best_group(c, undone(size), group, among, partial(price, size))


def _starts(c: Comparison, undone: FloatArray, among: Group) -> list[Group]:
    """Return groups to begin a search with: all, each unit's, each alone, those that look nearer by themselves."""
    nearer = ((c.rest(undone) ** 2) - (c.rest(c.recorded) ** 2)).mean(axis=(0, 1)) < 0.0
    some = [one for one in alone(c, among) if nearer[mask(c, one)].mean() > 0.5]
    units = [group & among for group in by_unit(c).values()]
    every = [among, frozenset().union(*some), *units, *alone(c, among)]
    return [group for group in dict.fromkeys(every) if group]
