"""The gap over the test space, and on held-out tests before and after the named effects are added."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from s2r_spec.base.quantity import signed_quantity
from s2r_spec.diagnose.gap.held_out import HeldOut, HeldOutGap
from s2r_spec.diagnose.gap.materiality import RolloutsAtTest
from s2r_spec.diagnose.gap.surface import GapSurface
from s2r_spec.report.check import test_words
from s2r_spec.report.figures.canvas import (
    BAD,
    BAND,
    GOOD,
    INK,
    MUTED,
    PAPER,
    Picture,
    add_scale,
    hover_points,
    paint_map,
    panels,
    pictured,
    shorten,
    with_unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_TESTS = 16
_DELTA = "Δρ = ρ real − ρ sim"


def over_space(space: GapSurface, far: HeldOutGap | None, name: str) -> Picture:
    """Draw Δρ over the test space: a curve over one parameter, maps over two, slices over more."""
    held = () if far is None else far.tests
    match space.space.dim:
        case 1:
            return _curve(space, held, name)
        case 2:
            return _maps(space, held, name)
        case _:
            return _slices(space, name)


def before_and_after(far: HeldOutGap, units: dict[str, str], name: str) -> Picture:
    """Draw |Δρ| of each held-out test before and after the named effects are added, largest first."""
    tests = sorted(far.tests, key=lambda test: -abs(test.before))[:_MOST_TESTS]
    rows = np.arange(len(tests))[::-1]
    named = [", ".join(f"{value:.3g}" for value in test.params.values()) or "the only test" for test in tests]

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        limit = far.floor + far.background
        axes.axvspan(0, limit, color=MUTED, alpha=0.15, lw=0, label="scatter and background effects")
        before = [abs(test.before) for test in tests]
        if far.after is not None:
            after = [abs(test.after or 0.0) for test in tests]
            axes.hlines(rows, after, before, color=MUTED, lw=1.2)
        axes.plot(before, rows, "o", color=BAD, mfc=PAPER, mec=BAD, mew=1.6, ms=7, zorder=3, label="before")
        if far.after is not None:
            axes.plot(after, rows, "o", color=GOOD, ms=6, zorder=4, label="after")
        counts = [f" (×{test.rollouts})" if test.rollouts > 1 else "" for test in tests]
        axes.set_yticks(rows, [shorten(name) + count for name, count in zip(named, counts, strict=True)])
        axes.set_ylabel(shorten(", ".join(tests[0].params)))
        hover_points(axes, before, rows, [_gaps(test, units, far.unit) for test in tests])
        axes.set_ylim(-0.7, len(tests) - 0.3)
        axes.set_xlim(left=0)
        axes.set_xlabel(with_unit("|Δρ|", far.unit))
        axes.grid(axis="y", visible=False)
        figure.legend(loc="outside upper left", ncols=3)

    alt = f"|Δρ| of {len(tests)} held-out tests: mean {far.before.mean:.4g} {far.unit} before"
    if far.after is not None:
        alt += f", {far.after.mean:.4g} {far.unit} after the named effects were added"
    params = ", ".join(with_unit(n, units.get(n, "")) for n in tests[0].params)
    params = f" ({params})" if params else ""
    caption = (
        f"Each row is a held-out test{params}. The ring is the gap between the real rollouts and the unchanged "
        "simulator; the dot is the gap with the named effects added. Grey is the gap due to scatter and to a few "
        "percent of every effect."
    )
    left = len(far.tests) - len(tests)
    if left:
        caption += f" {left} more tests, with smaller gaps, are not drawn."
    title = "Held-out tests: the gap before and after" if far.after else "Held-out tests: the gap"
    return pictured(title, caption, alt, name, 1.35 + 0.27 * len(tests), paint)


def _curve(space: GapSurface, held: Sequence[HeldOut], name: str) -> Picture:
    axis = space.space.axes[0]

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        _band(axes, space, 0, ms=3.5, label="mean of a test")
        where = [test.params[axis.name] for test in held]
        after = [test.after for test in held if test.after is not None]
        if after:
            axes.vlines(where, [test.before for test in held], after, color=MUTED, lw=0.8)
            axes.plot(where, after, "o", color=GOOD, ms=7, label="held out: after")
        if held:
            axes.plot(
                where, [test.before for test in held], "o", mfc="none", mec=BAD, mew=1.6, ms=8,
                ls="none", label="held out: before",
            )  # fmt: skip
        axes.set_xlim(axis.low - axis.width / 50, axis.high + axis.width / 50)
        axes.set_ylabel(with_unit(_DELTA, space.unit))
        figure.legend(loc="outside upper left", ncols=2)

    worst = space.worst[axis.name]
    alt = (
        f"Δρ over {axis.name} from {axis.low:g} to {axis.high:g} {axis.unit}: its expected value between "
        f"{space.signed.mean.min():.4g} and {space.signed.mean.max():.4g} {space.unit}; largest gap probably at "
        f"{worst:.4g} {axis.unit}; {len(held)} held-out tests"
    )
    caption = _caption(space, bool(held))
    return pictured("The gap over the test space", caption, alt, name, 3.4, paint)


def _band(axes: Axes, space: GapSurface, axis: int, **dots: Any) -> None:
    """Draw the expected Δρ along an axis through the worst test, and the gap at each test that was run."""
    on = space.along(axis)
    at = space.grid[on, axis]
    band = space.signed
    axes.fill_between(at, band.lower[on], band.upper[on], color=BAND, alpha=0.22, lw=0, label="E Δρ, 95 %")
    axes.plot(at, band.mean[on], color=BAND, lw=2)
    if space.tolerance:
        for sign in (-1, 1):
            axes.axhline(sign * space.tolerance, color=MUTED, lw=0.8, ls=(0, (4, 3)))
    axes.axhline(0, color=INK, lw=0.8)
    along = space.space.axes[axis]
    where, gaps = [test.params[along.name] for test in space.tests], [test.gap for test in space.tests]
    axes.plot(where, gaps, "o", color=INK, **dots)
    hover_points(axes, where, gaps, [_gap(test, space) for test in space.tests])
    axes.set_xlabel(with_unit(along.name, along.unit))


def _slices(space: GapSurface, name: str) -> Picture:
    names = space.space.names

    def paint(figure: Figure) -> None:
        grid = panels(figure, len(names), 3)
        for k, (axes, axis) in enumerate(zip(grid, space.space.axes, strict=True)):
            _band(axes, space, k, ms=3, alpha=0.6)
            axes.axvline(space.worst[axis.name], color=BAD, lw=1, ls=(0, (4, 3)))
        for axes in grid[::3]:
            axes.set_ylabel(with_unit("Δρ", space.unit))

    rows = -(-len(names) // 3)
    worst = ", ".join(f"{n} = {v:.4g}" for n, v in space.worst.items())
    alt = f"Δρ along {', '.join(names)}, each through the worst test, {worst}; {len(space.tests)} tests"
    caption = _caption(space, False) + (
        " Each slice goes through the worst test (dashed red). Every slice shows all tests, also those off the slice."
    )
    title = "The gap over the test space: slices through the worst test"
    return pictured(title, caption, alt, name, 2.4 * rows, paint)


def _maps(space: GapSurface, held: Sequence[HeldOut], name: str) -> Picture:
    across, up = space.space.axes
    side = round(len(space.grid) ** 0.5)
    values = space.signed.mean.reshape(side, side).T
    drawn = [*values.ravel(), *(test.gap for test in space.tests)]
    scale = max(map(abs, drawn)) or 1.0
    after = [(test, test.after) for test in held if test.after is not None]

    def paint(figure: Figure) -> None:
        both = figure.subplots(1, 2 if after else 1, sharex=True, sharey=True, squeeze=False)[0]
        extent = (across.low, across.high, up.low, up.high)
        image = paint_map(both[0], values, extent, scale, "bilinear")
        x, y = ([test.params[a.name] for test in space.tests] for a in (across, up))
        both[0].scatter(x, y, s=12, c="black", lw=0)
        hover_points(both[0], x, y, [_gap(test, space) for test in space.tests])
        both[0].plot(
            space.worst[across.name], space.worst[up.name], "v", color=PAPER, mec=INK, ms=10, clip_on=False
        )
        both[0].set_title("before: E Δρ, tests")
        if after:
            x, y = ([test.params[a.name] for test, _ in after] for a in (across, up))
            both[1].scatter(
                x, y, s=90, c=[value for _, value in after], cmap="RdBu", vmin=-scale, vmax=scale,
                edgecolors=INK, linewidths=0.8,
            )  # fmt: skip
            both[1].set_title("after, held-out tests")
            units = space.space.units
            hover_points(both[1], x, y, [_gaps(test, units, space.unit) for test, _ in after])
        for axes in both:
            axes.grid(False)
            axes.set_xlabel(with_unit(across.name, across.unit))
            axes.set_xlim(across.low - across.width / 40, across.high + across.width / 40)
            axes.set_ylim(up.low - up.width / 40, up.high + up.width / 40)
        both[0].set_ylabel(with_unit(up.name, up.unit))
        add_scale(figure, image, both.tolist(), with_unit("Δρ", space.unit))

    alt = (
        f"Map of the expected Δρ over {across.name} and {up.name}, largest gap probably at "
        f"{test_words(space.worst, space.space.units)}"
    )
    if after:
        alt += f"; beside it the gap with the named effects added, at {len(after)} held-out tests"
    caption = (
        _caption(space, False)
        + " The triangle is the most probable worst test"
        + ("; on the right, in the same colours, the gap with the named effects added." if after else ".")
    )
    return pictured("The gap over the test space", caption, alt, name, 3.0, paint)


def _gap(test: RolloutsAtTest, space: GapSurface) -> str:
    """Return a test and its Δρ."""
    return f"{test_words(test.params, space.space.units)}: Δρ {signed_quantity(test.gap, space.unit)}".lstrip(
        ": "
    )


def _gaps(test: HeldOut, units: Mapping[str, str], unit: str) -> str:
    """Return a held-out test and its Δρ before and after."""
    words = f"{test_words(test.params, units)}: Δρ {signed_quantity(test.before, unit)}".lstrip(": ")
    return words if test.after is None else f"{words}, {signed_quantity(test.after, unit)} after"


def _caption(space: GapSurface, held: bool) -> str:
    words = "Δρ is ρ of the real machine minus ρ of the simulator"
    if space.space.dim == 2:
        words += ". Red, below 0: the real machine is worse."
    else:
        words += (
            ": below 0 the real machine is worse. The band holds its expected value with 95 % simultaneously for all "
            "tests."
        )
    if held:
        words += " Rings are gaps at held-out tests; dots are the gaps with the named effects added."
    if space.tolerance and space.space.dim != 2:
        words += " Dashed lines mark twice the gap due to scatter alone."
    return words
