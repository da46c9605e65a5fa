"""The family of mistakes that a parity relation shows: transformations g of recorded channels, each with an inverse.

A mistake has a form, a group of channels and a size x: g_x(y)(t) of a channel of the group is

    exchanged  the other channel of the pair         sign    −y(t)               late    y(t − x)
    scale      o + x (y(t) − o), o zero or y(0)      offset  y(t) + x            frame   turned about y(0) by x
    clock      y(x t), of all channels               begin   y(t − x), of all channels

The inverse has the size −x, or 1 / x of a factor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from s2r_spec.backend import Channel
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.quality.faults import FACTORS, LATEST, PER_RADIAN
from s2r_spec.trace import Trace
from s2r_spec.trace.samples import period_of

Group = tuple[str, ...]
Columns = dict[str, FloatArray]
"""Channel → (n,) values."""
Change = Callable[[Columns, Trace, Group, float], Columns]
"""(columns, recording, group, x) → the columns of the group after g_x."""

TURNS = tuple(np.linspace(-np.pi, np.pi, 19)[1:].tolist())
"""Definition: angles [rad] of a frame that are tried, before the best is refined."""
FORGOTTEN = (1e3, 1e2, 180.0 / np.pi, np.pi / 180.0, 1e-2, 1e-3)
"""Definition: factors of a forgotten unit: milli, centi, degrees, and their inverses."""


@dataclass(frozen=True)
class Form:
    """A form of a mistake.

    Attributes:
        code: of the finding.
        change: g of a size.
        groups: of channels that are tried first.
        grows: channels that may join a group.
        sizes: that are tried first.
        unit: of a size, or of the logarithm of a factor; 0 where there is nothing to refine.
        factor: whether a size is a factor.
        resampled: whether channels are read between samples.
        least: the smallest size that counts; nobody reads two clocks better than to half a sample.
    """

    code: str
    change: Change
    groups: Sequence[Group]
    grows: Callable[[Group], Sequence[str]]
    sizes: Sequence[float]
    unit: float
    factor: bool = False
    resampled: bool = False
    least: float = 0.0

    def undone(self, size: float) -> float:
        """Return the size of the inverse."""
        return 1.0 / size if self.factor else -size

    def coordinate(self, size: float) -> float:
        """Return a size in units; that of a factor is its logarithm."""
        return float(np.log(size) if self.factor else size) / self.unit

    def at(self, coordinate: float) -> float:
        """Return the size at a coordinate."""
        return float(np.exp(coordinate * self.unit)) if self.factor else coordinate * self.unit


def forms(
    channels: Sequence[Channel], traces: Sequence[Trace], reach: dict[str, float], sources: Sequence[Group]
) -> Iterator[Form]:
    """Yield every form for channels of these recordings.

    ``reach`` is the range of each channel; ``sources`` are channels that may share a clock.
    """
    names, units = [one.name for one in channels], {one.name: one.unit for one in channels}
    alone: list[Group] = [(name,) for name in names]
    alike: dict[str, list[str]] = {}
    for one in channels:
        alike.setdefault(one.unit, []).append(one.name)
    together: list[Group] = [tuple(each) for each in alike.values() if len(each) > 1]
    every, period = tuple(names), max(period_of(trace.times) for trace in traces)

    def others(group: Group) -> Sequence[str]:
        return [name for name in names if name not in group]

    def of_unit(group: Group) -> Sequence[str]:
        return [name for name in alike[units[group[0]]] if name not in group]

    def none(group: Group) -> Sequence[str]:
        return ()

    later = np.geomspace(2.0 * period, LATEST * min(trace.duration for trace in traces), 6).tolist()
    delays = [*(-by for by in later[::-1]), *later]
    near = list(FACTORS[1::8])
    factors = [*FORGOTTEN, *near]
    yield Form("exchanged", _exchange, list(combinations(names, 2)), none, [1.0], 0.0)
    yield Form("sign", _scale, [*alone, *together], others, [-1.0], 0.0, factor=True)
    yield Form(
        "late",
        _late,
        list(dict.fromkeys([*alone, *together, *sources])),
        others,
        delays,
        period,
        resampled=True,
    )
    yield Form("begin", _late, [every], none, delays, period, resampled=True, least=period / 2)
    yield Form("scale", _scale, [*alone, *together], of_unit, factors, 0.1, factor=True)
    yield Form("scale", _scale_from_first, [*alone, *together], of_unit, factors, 0.1, factor=True)
    for name in names:
        sizes = [sign * part * reach[name] for sign in (-1.0, 1.0) for part in (0.05, 0.5)]
        yield Form("offset", _offset, [(name,)], none, sizes, 0.1 * reach[name])
    yield Form("clock", _clock, [every], none, near, 0.01, factor=True, resampled=True)
    angles = [name for name in names if units[name] in PER_RADIAN]
    planes = [pair for each in together if units[each[0]] not in PER_RADIAN for pair in pairwise(each)]
    if angles and planes:
        groups = [(*pair, *more) for pair in planes for more in ((), *((name,) for name in angles))]
        yield Form("frame", _turned(units), groups, none, TURNS, 0.1)


def _exchange(columns: Columns, recorded: Trace, group: Group, size: float) -> Columns:
    del recorded, size
    return {group[0]: columns[group[1]], group[1]: columns[group[0]]}


def _scale(columns: Columns, recorded: Trace, group: Group, size: float) -> Columns:
    return {name: size * columns[name] for name in group}


def _scale_from_first(columns: Columns, recorded: Trace, group: Group, size: float) -> Columns:
    return {name: recorded[name][0] + size * (columns[name] - recorded[name][0]) for name in group}


def _offset(columns: Columns, recorded: Trace, group: Group, size: float) -> Columns:
    return {name: columns[name] + size for name in group}


def _late(columns: Columns, recorded: Trace, group: Group, size: float) -> Columns:
    return {name: _at(recorded.times - size, recorded.times, columns[name]) for name in group}


def _clock(columns: Columns, recorded: Trace, group: Group, size: float) -> Columns:
    own = recorded.times - recorded.times[0]
    return {name: _at(size * own, own, columns[name]) for name in group}


def _at(at: FloatArray, times: FloatArray, values: FloatArray) -> FloatArray:
    return np.asarray(np.interp(at, times, values, left=np.nan, right=np.nan))


def _turned(units: dict[str, str]) -> Change:
    def turn(columns: Columns, recorded: Trace, group: Group, size: float) -> Columns:
        (a, b, *angles), c, s = group, np.cos(size), np.sin(size)
        x, y = (columns[name] - recorded[name][0] for name in (a, b))
        out = {a: recorded[a][0] + c * x - s * y, b: recorded[b][0] + s * x + c * y}
        return out | {name: columns[name] + size * PER_RADIAN[units[name]] for name in angles}

    return turn
