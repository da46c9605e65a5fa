"""Another frame of reference: two columns of one unit turned about their first sample, angles off by the same angle.

And a column that is off by a constant from the first sample on.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.suspects import (
    PER_RADIAN,
    Group,
    Suspect,
    alone,
    best_group,
    channels,
    listed,
    mask,
    named,
    refined,
    undo,
)

FloatArray = NDArray[np.float64]

PAIRS = 12
"""Budget: pairs of columns that are tried, nearest in the list of channels first. Twice as many cost
twice the time."""


def turned(c: Comparison) -> list[Suspect]:
    """Return the pair of columns and the angle by which its frame is turned that explain most."""
    begin = c.read(stretch=0.0)
    angles = frozenset(column.channel for column in c.columns if column.unit in PER_RADIAN)
    per = np.array([PER_RADIAN.get(column.unit, 0.0) for column in c.columns])
    units = [column.unit for column in c.columns]
    pairs = [
        (i, j)
        for i, j in combinations(range(len(units)), 2)
        if units[i] == units[j] and units[i] and units[i] not in PER_RADIAN
    ]
    pairs = sorted(pairs, key=lambda pair: pair[1] - pair[0])[:PAIRS]

    def undone(a: float, pair: tuple[int, int], offset: Group) -> FloatArray:
        values = c.recorded - np.where(mask(c, offset), a * per, 0.0)
        back = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
        first = begin[..., pair]
        values[..., pair] = first + (c.recorded[..., pair] - first) @ back
        return np.asarray(values)

    step = np.pi / 18.0
    offsets = list(dict.fromkeys([Group(), angles, *alone(c, angles)]))
    tried = [
        (c.misfit(undone(n * step, pair, offset)), n * step, pair, offset)
        for pair in pairs
        for offset in offsets
        for n in range(-18, 19)
        if n
    ]
    if not tried:
        return []
    _, a, pair, offset = min(tried, key=lambda one: one[0])
    a = refined(lambda x: c.misfit(undone(x, pair, offset)), a, a - step, a + step)
    words = listed([*(c.columns[k].name for k in pair), *(name for name in channels(c) if name in offset)])
    more = f". {named(c, offset)} is off by the same angle from the first sample on" if offset else ""
    text = (
        f"{c.columns[pair[0]].name} and {c.columns[pair[1]].name} of the real rollouts are rotated by {a:.2g} rad "
        f"against the simulator's{more}. Are they in the same frame? If not, rotate them back in the recordings"
    )
    return [Suspect(Finding("frame", words, text, "a rotated frame"), undone(a, pair, offset))]


def offset(c: Comparison) -> list[Suspect]:
    """Return the channels whose constant offset, that of their first samples, explains most."""
    first = (c.recorded - c.nominal)[:, 0]
    by = np.median(first, axis=0)
    off = np.abs(by) > 2.0 * np.abs(first - by).max(axis=0)
    off &= np.abs(by) > c.floor
    among = frozenset(column.channel for column, one in zip(c.columns, off, strict=True) if one)
    if not among:
        return []
    undone = c.recorded - np.where(off, by, 0.0)
    options = [best_group(c, undone, begin, among) for begin in (among, *alone(c, among))]
    group, _ = min(options, key=lambda one: one[1])
    each = ", ".join(
        f"{c.columns[k].name} by {by[k]:.2g} {c.columns[k].unit}".rstrip()
        for k in np.flatnonzero(off & mask(c, group))[:4]
    )
    text = (
        f"the real rollouts have a constant offset against the simulator from the first sample on ({each}). Do both "
        f"use the same zero? If not, subtract the offset in the recordings"
    )
    said = Finding("offset", named(c, group), text, "a constant offset of the recording")
    return [Suspect(said, undo(c, undone, group))]
