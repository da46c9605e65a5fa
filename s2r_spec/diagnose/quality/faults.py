"""The family of mistakes that all channels together tell: transformations of the recordings, each undone.

A mistake has a size x and a group G of m channels, or of recordings, that share it. Undone, the discrepancy is a sum of
parts with weights W (1 + m, parts), so that Q of every group follows from the products of the parts:

    r(x, G) = Σ_p (W_0p(x) + Σ_G W_jp(x)) r_p
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.quality.finding import Finding, join_words
from s2r_spec.trace.samples import period_of

ChannelGroup = frozenset[str]
"""Channels, or recordings, that share a mistake."""
Parts = tuple[FloatArray, FloatArray | float]
"""(parts, n, T, c) parts of a discrepancy, r₀ first, and what of it counts: (T, 1) instants or (n, 1, 1) recordings, of
1 and 0."""

PER_RADIAN = {"rad": 1.0, "deg": 180.0 / np.pi}
"""Definition: units of angles, and how many of it a radian is."""
LATEST = 0.25
"""Definition: part of a rollout that a delay is looked for up to."""
FACTORS = tuple(np.geomspace(0.4, 2.5, 59).tolist())
"""Definition: factors of scales and clocks that are tried, before the best is refined. A rate that was set twice as
high as it was lies well inside; a best at either end is no minimum."""


@dataclass(frozen=True, eq=False)
class Undone:
    """The recordings (n, T, c) without a mistake of one size, which a group has.

    ``there`` has 1 and 0: (T, 1) which instants can be read, or (n, 1, 1) which recordings count. ``price`` is
    2 log |∂ recorded / ∂ undone|, a number of a recording: what shrinks everything must explain better.
    """

    size: float
    group: ChannelGroup
    values: FloatArray
    there: FloatArray | float = 1.0
    price: float = 0.0


Fault = tuple[Finding, Undone]
"""A mistake: what is said of it, and the recordings without it."""


def faults(c: Comparison) -> list[Fault]:
    """Return the mistake of each kind that explains most."""
    kinds = (delays, clock, exchanges, sign, scale, turns, offset)
    return [fault for kind in kinds for fault in kind(c)]


def delays(c: Comparison) -> Iterable[Fault]:
    """Read channels later: by a delay [s] after the others, or early by a negative one.

    All channels together mean that the recordings begin at another time than their tests.
    """
    names, period = channels(c), max(period_of(trace.times) for trace in c.traces)
    steps = np.geomspace(period, LATEST * c.view.times[-1], 9).tolist()
    sizes = [*(-by for by in steps[::-1]), *steps]
    for one in search(c, names, sizes, _read(c, names, lambda by: c.read(late=by)), starts=_units(c)):
        rest = [name for name in names if name not in one.group]
        # Nobody reads two clocks better than to a sample.
        much = f"{abs(round(one.size / period) * period):.2g} s"
        early = one.size < 0.0
        if not rest:
            text = (
                f"all channels of the real rollouts are {much} {'earlier' if early else 'later'} than the simulator's. "
                f"Do the recordings begin {much} too {'late' if early else 'early'}? If so, shift the times so that "
                f"each recording begins with its test"
            )
            yield Finding("begin", "the clock", text, "a recording that begins at another time"), one
            continue
        # It is the few that are said to be wrong; late poses are early commands.
        many = len(one.group) > len(rest)
        text = (
            f"{channel_names(c, one.group)} {'is' if len(one.group) == 1 and not many else 'are'} {much} "
            f"{'early' if early else 'late'} against {join_words(rest) if many else 'the other channels'} from "
            f"the first sample on. Do all channels get their timestamps from the same clock? If not, shift their times "
            f"by this delay"
        )
        yield Finding("late", channel_names(c, one.group), text, "a wrong clock"), one


def clock(c: Comparison) -> Iterable[Fault]:
    """Read all channels at stretched times: by the real seconds that a stamped second was."""
    period = float(np.median([period_of(trace.times) for trace in c.traces]))
    for one in search(c, ["all"], FACTORS, _read(c, None, lambda stretch: c.read(stretch=stretch))):
        text = (
            f"all channels of the real rollouts, commands included, run {1.0 / one.size:.3g} times as fast as the "
            f"simulator's. Were samples taken at {one.size / period:.3g} Hz stamped at {1.0 / period:.3g} Hz?"
        )
        yield Finding("clock", "the clock", text, "a wrong clock"), one


def exchanges(c: Comparison) -> Iterable[Fault]:
    """Assign the recorded columns of each unit to the simulator's that they are nearest to."""
    from scipy.optimize import linear_sum_assignment

    order = np.arange(len(c.columns))
    for unit in {column.unit for column in c.columns}:
        mine = np.array([k for k, column in enumerate(c.columns) if column.unit == unit])
        apart = (c.recorded[..., mine, None] - c.nominal[..., None, mine]) / c.floor[mine]
        rows, names = linear_sum_assignment((apart**2).mean(axis=(0, 1)))
        order[mine[names]] = mine[rows]
    cycles = _cycles(order)
    swapped = np.array(
        [(c.recorded[..., order] - c.recorded) / c.floor * np.isin(order, cycle) for cycle in cycles]
    )
    names = [str(cycle[0]) for cycle in cycles]
    parts = np.concatenate([c.rest(c.recorded)[None], swapped.reshape(-1, *c.nominal.shape)]), 1.0
    for one in search(c, names, [1.0], parts, prices=lambda _: np.full(len(names), c.clear)):
        moved = sorted(k for cycle in cycles for k in cycle if str(cycle[0]) in one.group)
        words = join_words([c.columns[k].name for k in moved])
        under = ", ".join(f"{c.columns[k].name} is named {c.columns[order[k]].name}" for k in moved[:4])
        text = f"{words} of the real rollouts seem exchanged: {under}. If so, correct the names in the recordings"
        yield Finding("exchanged", words, text, "an exchange of channels"), replace(one, price=0.0)


def _cycles(order: NDArray[np.int64]) -> list[list[int]]:
    cycles, left = list[list[int]](), {k for k, other in enumerate(order.tolist()) if other != k}
    while left:
        cycle = [left.pop()]
        while (after := int(order[cycle[-1]])) in left:
            left.remove(after)
            cycle.append(after)
        cycles.append(cycle)
    return cycles


def sign(c: Comparison) -> Iterable[Fault]:
    """Change the sign of channels, as between two conventions of axes."""
    for one in _scale(c, channels(c), [-1.0], 0.0):
        words = channel_names(c, one.group)
        has, it = ("has", "it") if len(one.group) == 1 else ("have", "them")
        text = (
            f"{words} of the real rollouts {has} the opposite sign of the simulator's. Do both use one sign "
            f"convention? If not, change the sign of {it} in the recordings"
        )
        yield Finding("sign", words, text, "the opposite sign"), one


def scale(c: Comparison) -> Iterable[Fault]:
    """Divide channels of one unit by one factor, measured from zero or from their first sample."""
    for unit, group in zip(dict.fromkeys(column.unit for column in c.columns), _units(c), strict=True):
        among = [name for name in channels(c) if name in group]
        options = [
            (c.misfit(one.values) + one.price, about, one)
            for begin, about in ((c.recorded[:, :1], "its first sample"), (0.0, "zero"))
            for one in _scale(c, among, FACTORS, begin)
        ]
        for _, about, one in sorted(options, key=lambda option: option[0])[:1]:
            text = (
                f"{channel_names(c, one.group)} of the real rollouts {'is' if len(one.group) == 1 else 'are'} "
                f"{100.0 * abs(one.size - 1.0):.2g} % too {'large' if one.size > 1.0 else 'small'}, measured from "
                f"{about} and judged by other channels. Check the scale{f', or the unit {unit},' if unit else ''} in "
                f"the recordings"
            )
            yield Finding("scale", channel_names(c, one.group), text, "a wrong scale"), one


def turns(c: Comparison) -> Iterable[Fault]:
    """Turn two neighbouring columns of one unit back about their first sample, and angles by the same angle."""
    moved = c.recorded - c.recorded[:, :1]
    per = np.array([PER_RADIAN.get(column.unit, 0.0) for column in c.columns])
    angles = [name for name in channels(c) if per[mask(c, [name])].any()]
    back = [-per / c.floor * mask(c, [name]) * np.ones_like(moved) for name in angles]

    def weights(a: float) -> FloatArray:
        rows = np.eye(1 + len(angles), 3 + len(angles), 2) * a
        rows[0, :3] = 1.0, np.cos(a) - 1.0, np.sin(a)
        return rows

    tried = []
    for i, j in _neighbours(c):
        along, aside = np.zeros_like(moved), np.zeros_like(moved)
        along[..., [i, j]] = moved[..., [i, j]] / c.floor[[i, j]]
        aside[..., i], aside[..., j] = moved[..., j] / c.floor[i], -moved[..., i] / c.floor[j]
        parts = np.array([c.rest(c.recorded), along, aside, *back]), 1.0
        starts = [ChannelGroup(), *(ChannelGroup([name]) for name in angles)]
        for one in search(c, angles, np.linspace(-np.pi, np.pi, 37).tolist(), parts, weights, starts):
            tried.append((c.misfit(one.values), [c.columns[i].name, c.columns[j].name], one))
    for _, pair, one in sorted(tried, key=lambda option: option[0])[:1]:
        words = join_words([*pair, *(name for name in angles if name in one.group)])
        more = (
            f". {channel_names(c, one.group)} is off by the same angle from the first sample on"
            if one.group
            else ""
        )
        text = (
            f"{pair[0]} and {pair[1]} of the real rollouts are rotated by {one.size:.2g} rad against the "
            f"simulator's{more}. Are they in the same frame? If not, rotate them back in the recordings"
        )
        yield Finding("frame", words, text, "a rotated frame"), one


def offset(c: Comparison) -> Iterable[Fault]:
    """Subtract the constant by which columns are off in the first sample of every recording."""
    first = (c.recorded - c.nominal)[:, 0]
    by = np.median(first, axis=0)
    by = np.where((np.abs(by) > 2.0 * np.abs(first - by).max(axis=0)) & (np.abs(by) > c.floor), by, 0.0)
    names = [name for name in channels(c) if by[mask(c, [name])].any()]
    for one in search(c, names, [1.0], (_split(c, names, -by / c.floor * np.ones_like(c.recorded)), 1.0)):
        each = ", ".join(
            f"{c.columns[k].name} by {by[k]:.2g} {c.columns[k].unit}".rstrip()
            for k in np.flatnonzero(by * mask(c, one.group))[:4]
        )
        text = (
            f"the real rollouts have a constant offset against the simulator from the first sample on ({each}). Do "
            f"both use the same zero? If not, subtract the offset in the recordings"
        )
        yield Finding("offset", channel_names(c, one.group), text, "a constant offset of the recording"), one


def channels(c: Comparison) -> list[str]:
    """Return the names of the channels that are compared, in order."""
    return list(dict.fromkeys(column.channel for column in c.columns))


def mask(c: Comparison, group: Iterable[str]) -> NDArray[np.bool_]:
    """Return (c,) which columns are of these channels."""
    return np.isin([column.channel for column in c.columns], list(group))


def channel_names(c: Comparison, group: ChannelGroup) -> str:
    """Return the channels of a group in words."""
    return join_words([name for name in channels(c) if name in group])


def _units(c: Comparison) -> list[ChannelGroup]:
    units = dict.fromkeys(column.unit for column in c.columns)
    return [ChannelGroup(column.channel for column in c.columns if column.unit == unit) for unit in units]


def _neighbours(c: Comparison) -> list[tuple[int, int]]:
    units = [column.unit for column in c.columns]
    pairs = [(i, j) for i in range(len(units)) for j in (i + 1, i + 2) if j < len(units)]
    return [(i, j) for i, j in pairs if units[i] == units[j] and units[i] and units[i] not in PER_RADIAN]


def _split(c: Comparison, names: Sequence[str] | None, change: FloatArray) -> FloatArray:
    """Return (1 + m, n, T, c) r₀ and the change (n, T, c) of each channel, in floors, or of all at once."""
    return np.array([c.rest(c.recorded), *([change * mask(c, [n]) for n in names] if names else [change])])


def _read(
    c: Comparison, names: Sequence[str] | None, read: Callable[[float], tuple[FloatArray, FloatArray]]
) -> Callable[[float], Parts]:
    def parts(size: float) -> Parts:
        values, there = read(size)
        return _split(c, names, (values - c.recorded) / c.floor), there

    return parts


def _scale(
    c: Comparison, names: Sequence[str], factors: Sequence[float], begin: FloatArray | float
) -> Iterator[Undone]:
    """Divide channels by a factor, measured from ``begin``."""
    shares = np.array([mask(c, [name]).mean() for name in names])

    def weights(factor: float) -> FloatArray:
        return np.diag([1.0, *[1.0 / factor - 1.0] * len(names)])

    def prices(factor: float) -> FloatArray:
        return np.asarray(max(2.0 * np.log(abs(factor)), 0.0) * shares)

    parts = _split(c, names, (c.recorded - begin) / c.floor), 1.0
    return search(c, names, factors, parts, weights, _units(c), prices)


def search(
    c: Comparison,
    names: Sequence[str],
    sizes: Sequence[float],
    parts: Parts | Callable[[float], Parts],
    weights: Callable[[float], FloatArray] | None = None,
    starts: Sequence[ChannelGroup] = (),
    prices: Callable[[float], FloatArray] | None = None,
) -> Iterator[Undone]:
    """Find the size and the group that leave least; none where that is at an end of several sizes.

    Args:
        c: the recordings.
        names: of the m channels, or recordings.
        sizes: that are tried, rising; the best is refined between its neighbours.
        parts: of the discrepancy, fixed or for each size; see the module.
        weights: of them for a size; the identity if not given.
        starts: groups to begin with, beside all and each alone. An empty one among them may be the best.
        prices: (m,) of a size for each channel; see :class:`Undone`.
    """
    fixed = np.zeros(0) if callable(parts) else c.products(parts[0] * parts[1])
    empty = ChannelGroup() in starts

    def form(size: float) -> FloatArray:
        """Return (1 + m, 1 + m) products of the weighted parts, less that of r₀."""
        products = c.products(np.multiply(*parts(size))) if callable(parts) else fixed
        rows = np.eye(len(products)) if weights is None else weights(size)
        quadratic = rows @ products @ rows.T
        quadratic[0, 0] -= products[0, 0]
        if callable(parts):  # sizes that leave other instants are compared by the part that they remove
            quadratic /= max(float(products[0, 0]), 1e-300)
        return np.asarray(quadratic if prices is None else quadratic + np.diag([0.0, *prices(size)]))

    groups = [ChannelGroup(names), *(ChannelGroup([name]) for name in names), *starts]
    begin = np.unique([[1.0, *(float(name in group) for name in names)] for group in groups], axis=0)
    begin = begin[begin.sum(axis=1) > (0.0 if empty else 1.0)]
    forms = ((k, form(size)) for k, size in enumerate(sizes))
    tried = [(*_grown(products, on, empty), k) for k, products in forms for on in begin]
    if not tried:
        return
    _, on, k = min(tried, key=lambda one: one[0])
    size = sizes[k]
    if len(sizes) > 1:
        if k in (0, len(sizes) - 1):
            return
        low, high = sizes[k - 1], sizes[k + 1]
        for _ in range(3):
            size = min(np.linspace(low, high, 9).tolist(), key=lambda x: float(on @ form(x) @ on))
            low, high = size - (high - low) / 8.0, size + (high - low) / 8.0
        _, on = _grown(form(size), on, empty)
    rests, observed = parts(size) if callable(parts) else parts
    rows = np.eye(len(rests)) if weights is None else weights(size)
    values = c.nominal + c.floor * np.einsum("p,pntc->ntc", on @ rows, rests)
    price = 0.0 if prices is None else float(prices(size) @ on[1:])
    group = ChannelGroup(name for name, one in zip(names, on[1:], strict=True) if one)
    yield Undone(size, group, values, observed, price)


def _grown(products: FloatArray, on: FloatArray, empty: bool) -> tuple[float, FloatArray]:
    """Return the least rest, and (1 + m,) which parts are on, as one after the other is put on or off.

    Args:
        products: (1 + m, 1 + m) of the weighted parts.
        on: of the parts at first; r₀ stays on.
        empty: whether all others may be off.
    """
    on = on.copy()
    while True:
        change = 2.0 * (1.0 - 2.0 * on) * (products @ on) + np.diag(products)
        change[0] = np.inf
        if not empty and on.sum() == 2.0:
            change = np.where(on == 1.0, np.inf, change)
        if change.min() >= 0.0:
            return float(on @ products @ on), on
        k = int(change.argmin())
        on[k] = 1.0 - on[k]
