"""The family of mistakes that all channels together tell: transformations of the recordings, each undone.

A mistake has a size x and a group G of channels that share it. Undone, the discrepancy is r(x, G) = r₀ + Σ_G v_j(x), so
that Q of every group follows from the products of r₀ and the v_j: a search over groups costs a search over sizes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.quality.finding import Finding, listed
from s2r_spec.samples import period_of

FloatArray = NDArray[np.float64]
Group = frozenset[str]
"""Channels that share a mistake."""
Form = Callable[[float], FloatArray]
"""From a size to (1 + m, 1 + m) products of r₀ and v_j of m channels; [0, 0] is relative to the recordings as they
are."""

PER_RADIAN = {"rad": 1.0, "deg": 180.0 / np.pi}
"""Definition: units of angles, and how many of it a radian is."""
LATEST = 0.25
"""Definition: part of a rollout that a delay is looked for up to. Twice as much looks for longer ones."""
FACTORS = tuple(np.geomspace(0.4, 2.5, 59).tolist())
"""Definition: factors of scales and clocks that are tried, before the best is refined. A rate that was set twice as
high as it was lies well inside; a best at either end is no minimum. Twice as many see clocks of longer rollouts."""


@dataclass(frozen=True, eq=False)
class Fault:
    """A mistake of a certain size in certain channels, and the recordings without it.

    Attributes:
        finding: what is said of it.
        values: (n, T, c) recordings after undoing it.
        there: of 1 and 0, (T, 1) which instants can be read when it is undone, or (n, 1, 1) which recordings count.
        price: 2 log |∂ recorded / ∂ undone|, a number of a recording: what shrinks everything must explain better.
    """

    finding: Finding
    values: FloatArray
    there: FloatArray | float = 1.0
    price: float = 0.0


def faults(c: Comparison) -> list[Fault]:
    """Return the mistake of each kind that explains most."""
    kinds = (late, clock, exchanged, sign, scale, turned, offset)
    return [fault for kind in kinds for fault in kind(c)]


def late(c: Comparison) -> Iterable[Fault]:
    """Read channels later: by a delay [s] after the others, or early by a negative one.

    All channels together mean that the recordings begin at another time than their tests.
    """
    names, duration = channels(c), float(c.view.times[-1])
    period = max(period_of(trace.times) for trace in c.traces)
    delays = np.geomspace(period, LATEST * duration, 9)
    found = search(_read(c, names, lambda by: c.read(late=by)), [*-delays[::-1], *delays], names, _units(c))
    if found is None:
        return
    by, group = round(found[0] / period) * period, found[1]  # nobody reads two clocks better than to a sample
    values, there = c.read(late=by)
    values = np.where(mask(c, group), values, c.recorded)
    rest = [name for name in names if name not in group]
    much, when = f"{abs(by):.2g} s", "late" if by > 0.0 else "early"
    if not rest:
        text = (
            f"all channels of the real rollouts are {much} {'later' if by > 0.0 else 'earlier'} than the simulator's. "
            f"Do the recordings begin {much} too {'early' if by > 0.0 else 'late'}? If so, shift the times so that "
            f"each recording begins with its test"
        )
        yield Fault(
            Finding("begin", "the clock", text, "a recording that begins at another time"), values, there
        )
        return
    # It is the few that are said to be wrong; late poses are early commands.
    many = len(group) > len(rest)
    text = (
        f"{named(c, group)} {'is' if len(group) == 1 and not many else 'are'} {much} {when} against "
        f"{listed(rest) if many else 'the other channels'} from the first sample on. Do all channels get their "
        f"timestamps from the same clock? If not, shift their times by this delay"
    )
    yield Fault(Finding("late", named(c, group), text, "a wrong clock"), values, there)


def clock(c: Comparison) -> Iterable[Fault]:
    """Read all channels at stretched times: by the real seconds that a stamped second was."""
    found = search(_read(c, None, lambda stretch: c.read(stretch=stretch)), FACTORS, ["all"])
    if found is None:
        return
    stretch, _ = found
    period = float(np.median([period_of(trace.times) for trace in c.traces]))
    text = (
        f"all channels of the real rollouts, commands included, run {1.0 / stretch:.3g} times as fast as the "
        f"simulator's. Were samples taken at {stretch / period:.3g} Hz stamped at {1.0 / period:.3g} Hz?"
    )
    yield Fault(Finding("clock", "the clock", text, "a wrong clock"), *c.read(stretch=stretch))


def exchanged(c: Comparison) -> Iterable[Fault]:
    """Assign the recorded columns of each unit to the simulator's that they are nearest to."""
    from scipy.optimize import linear_sum_assignment

    order = np.arange(len(c.columns))
    for unit in {column.unit for column in c.columns}:
        mine = np.array([k for k, column in enumerate(c.columns) if column.unit == unit])
        apart = (c.recorded[..., mine, None] - c.nominal[..., None, mine]) / c.floor[mine]
        rows, names = linear_sum_assignment((apart**2).mean(axis=(0, 1)))
        order[mine[names]] = mine[rows]
    moved = [k for k in range(len(order)) if order[k] != k]
    if not moved:
        return
    words = listed([c.columns[k].name for k in moved])
    under = ", ".join(f"{c.columns[k].name} is named {c.columns[order[k]].name}" for k in moved[:4])
    text = f"{words} of the real rollouts seem exchanged: {under}. If so, correct the names in the recordings"
    yield Fault(Finding("exchanged", words, text, "an exchange of channels"), c.recorded[..., order])


def sign(c: Comparison) -> Iterable[Fault]:
    """Change the sign of channels, as between two conventions of axes."""
    names = channels(c)
    found = search(_scaled(c, names, np.zeros(1)), [-1.0], names, _units(c))
    if found is None:
        return
    words = named(c, found[1])
    has, it = ("has", "it") if len(found[1]) == 1 else ("have", "them")
    text = (
        f"{words} of the real rollouts {has} the opposite sign of the simulator's. Do both use one sign convention? If "
        f"not, change the sign of {it} in the recordings"
    )
    said = Finding("sign", words, text, "the opposite sign")
    yield Fault(said, np.where(mask(c, found[1]), -c.recorded, c.recorded))


def scale(c: Comparison) -> Iterable[Fault]:
    """Divide channels of one unit by one factor, measured from zero or from their first sample."""
    for unit in dict.fromkeys(column.unit for column in c.columns):
        among = list(dict.fromkeys(column.channel for column in c.columns if column.unit == unit))
        options = []
        for begin, about in ((c.recorded[:, :1], "its first sample"), (np.zeros(1), "zero")):
            found = search(_scaled(c, among, begin), FACTORS, among)
            if found is None:
                continue
            factor, group = found
            text = (
                f"{named(c, group)} of the real rollouts {'is' if len(group) == 1 else 'are'} "
                f"{100.0 * abs(factor - 1.0):.2g} % too {'large' if factor > 1.0 else 'small'}, measured from {about} "
                f"and judged by other channels. Check the scale{f', or the unit {unit},' if unit else ''} in the "
                f"recordings"
            )
            values = np.where(mask(c, group), begin + (c.recorded - begin) / factor, c.recorded)
            said = Finding("scale", named(c, group), text, "a wrong scale")
            options.append(Fault(said, values, price=_price(c, factor, group)))
        yield from sorted(options, key=lambda one: c.misfit(one.values) + one.price)[:1]


def turned(c: Comparison) -> Iterable[Fault]:
    """Turn two neighbouring columns of one unit back about their first sample, and angles by the same angle."""
    now, moved = c.rest(c.recorded), c.recorded - c.recorded[:, :1]
    per = np.array([PER_RADIAN.get(column.unit, 0.0) for column in c.columns])
    angles = [name for name in channels(c) if per[mask(c, Group([name]))].any()]
    back = [-per / c.floor * mask(c, Group([name])) * np.ones_like(moved) for name in angles]
    starts = [Group(), Group(angles), *(Group([name]) for name in angles)]
    tried = []
    for i, j in _neighbours(c):
        along, aside = np.zeros_like(moved), np.zeros_like(moved)
        along[..., [i, j]] = moved[..., [i, j]] / c.floor[[i, j]]
        aside[..., i], aside[..., j] = moved[..., j] / c.floor[i], -moved[..., i] / c.floor[j]
        products = c.products(np.array([now, along, aside, *back]))

        def weights(a: float) -> FloatArray:
            rows = np.eye(1 + len(angles), 3 + len(angles), 2) * a
            rows[0, :3] = 1.0, np.cos(a) - 1.0, np.sin(a)
            return rows

        def form(a: float, products: FloatArray = products) -> FloatArray:
            return np.asarray(weights(a) @ products @ weights(a).T)

        found = search(form, np.linspace(-np.pi, np.pi, 37).tolist(), angles, starts)
        if found is not None:
            a, group = found
            rest = (
                np.array([name in group for name in angles]) @ weights(a)[1:, 3:] if angles else np.zeros(0)
            )
            each = [1.0, *weights(a)[0, 1:3], *rest]
            values = c.nominal + c.floor * np.einsum("m,mntc->ntc", each, [now, along, aside, *back])
            tried.append((c.misfit(values), a, i, j, group, values))
    if not tried:
        return
    _, a, i, j, group, values = min(tried, key=lambda one: one[0])
    words = listed([c.columns[i].name, c.columns[j].name, *(name for name in angles if name in group)])
    more = f". {named(c, group)} is off by the same angle from the first sample on" if group else ""
    text = (
        f"{c.columns[i].name} and {c.columns[j].name} of the real rollouts are rotated by {a:.2g} rad against the "
        f"simulator's{more}. Are they in the same frame? If not, rotate them back in the recordings"
    )
    yield Fault(Finding("frame", words, text, "a rotated frame"), values)


def offset(c: Comparison) -> Iterable[Fault]:
    """Subtract the constant by which columns are off in the first sample of every recording."""
    first = (c.recorded - c.nominal)[:, 0]
    by = np.median(first, axis=0)
    by = np.where((np.abs(by) > 2.0 * np.abs(first - by).max(axis=0)) & (np.abs(by) > c.floor), by, 0.0)
    names = list(dict.fromkeys(column.channel for column, one in zip(c.columns, by, strict=True) if one))
    if not names:
        return
    form = _form(c, names, -by / c.floor * np.ones_like(c.recorded))
    found = search(lambda _: form, [1.0], names)
    if found is None:
        return
    by = np.where(mask(c, found[1]), by, 0.0)
    each = ", ".join(
        f"{c.columns[k].name} by {by[k]:.2g} {c.columns[k].unit}".rstrip() for k in np.flatnonzero(by)[:4]
    )
    text = (
        f"the real rollouts have a constant offset against the simulator from the first sample on ({each}). Do both "
        f"use the same zero? If not, subtract the offset in the recordings"
    )
    yield Fault(
        Finding("offset", named(c, found[1]), text, "a constant offset of the recording"), c.recorded - by
    )


def channels(c: Comparison) -> list[str]:
    """Return the names of the channels that are compared, in order."""
    return list(dict.fromkeys(column.channel for column in c.columns))


def mask(c: Comparison, group: Group) -> NDArray[np.bool_]:
    """Return (c,) which columns are of these channels."""
    return np.array([column.channel in group for column in c.columns])


def named(c: Comparison, group: Group) -> str:
    """Return the channels of a group in words."""
    return listed([name for name in channels(c) if name in group])


def _units(c: Comparison) -> list[Group]:
    """Return the channels of each unit."""
    units = dict.fromkeys(column.unit for column in c.columns)
    return [Group(column.channel for column in c.columns if column.unit == unit) for unit in units]


def _neighbours(c: Comparison) -> list[tuple[int, int]]:
    """Return the pairs of columns of one unit, not of an angle, that are next to each other or next but one."""
    units = [column.unit for column in c.columns]
    pairs = [(i, j) for i in range(len(units)) for j in (i + 1, i + 2) if j < len(units)]
    return [(i, j) for i, j in pairs if units[i] == units[j] and units[i] and units[i] not in PER_RADIAN]


def _price(c: Comparison, factor: float, group: Group) -> float:
    """Return the price of dividing channels by a factor; see :class:`Fault`."""
    return max(2.0 * float(np.log(abs(factor)) * mask(c, group).mean()), 0.0)


def _form(
    c: Comparison, names: Sequence[str] | None, v: FloatArray, there: FloatArray | float = 1.0
) -> FloatArray:
    """Return the products of r₀ and the parts of a change v (n, T, c) of each channel, or of all at once."""
    parts = [v * mask(c, Group([name])) for name in names] if names else [v]
    products = c.products(np.array([c.rest(c.recorded), *parts]) * there)
    products[0, 0] = 0.0
    return products


def _read(
    c: Comparison, names: Sequence[str] | None, read: Callable[[float], tuple[FloatArray, FloatArray]]
) -> Form:
    """Return the form of channels that are read at other times."""

    def form(size: float) -> FloatArray:
        values, there = read(size)
        return _form(c, names, (values - c.recorded) / c.floor, there)

    return form


def _scaled(c: Comparison, names: Sequence[str], begin: FloatArray) -> Form:
    """Return the form of channels that are divided by a factor, measured from ``begin``."""
    products = _form(c, names, (c.recorded - begin) / c.floor)

    def form(factor: float) -> FloatArray:
        weights = np.array([1.0, *[1.0 / factor - 1.0] * len(names)])
        prices = [0.0, *(_price(c, factor, Group([name])) for name in names)]
        return np.asarray(products * np.outer(weights, weights) + np.diag(prices))

    return form


def search(
    form: Form, sizes: Sequence[float], names: Sequence[str], more: Sequence[Group] = ()
) -> tuple[float, Group] | None:
    """Return the size and the channels that leave least; None where that is at an end of several sizes.

    Args:
        form: of the kind of mistake.
        sizes: that are tried, rising; the best is refined between its neighbours.
        names: of the m channels.
        more: groups to begin with, beside all and each alone. An empty one among them may be the best.
    """
    starts = [Group(names), *(Group([name]) for name in names), *more]
    empty = Group() in starts

    def grown(products: FloatArray, on: FloatArray) -> tuple[float, FloatArray]:
        """Add or drop the channel that lowers Q most while any does."""
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

    begin = np.unique([[1.0, *(float(name in group) for name in names)] for group in starts], axis=0)
    begin = begin[begin.sum(axis=1) > (0.0 if empty else 1.0)]
    tried = [
        (*grown(products, on), k) for k, size in enumerate(sizes) for products in [form(size)] for on in begin
    ]
    _, on, k = min(tried, key=lambda one: one[0])
    size = float(sizes[k])
    if len(sizes) > 1:
        if k in (0, len(sizes) - 1):
            return None
        low, high = float(sizes[k - 1]), float(sizes[k + 1])
        for _ in range(3):
            size = min(np.linspace(low, high, 9).tolist(), key=lambda x: float(on @ form(x) @ on))
            low, high = size - (high - low) / 8.0, size + (high - low) / 8.0
        _, on = grown(form(size), on)
    return size, Group(name for name, one in zip(names, on[1:], strict=True) if one)
