"""The band over the test space: simultaneous bounds of an expected value, with the rollouts behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from s2r_spec.certify.bound.rounding import down, up
from s2r_spec.certify.result.check_result import Tested
from s2r_spec.report.figures.canvas import (
    BAND,
    INK,
    MUTED,
    Picture,
    draw,
    shade_violation,
    with_unit,
)
from s2r_spec.report.figures.field import Field
from s2r_spec.report.figures.heat import heat
from s2r_spec.space import Axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

_POINTS = 301
_MOST_SLICES = 6


@dataclass(frozen=True)
class Slice:
    """The band along one axis; the other parameters have their values at the mark."""

    axis: Axis
    at: FloatArray
    lower: FloatArray
    upper: FloatArray


def band(field: Field, name: str) -> Picture:
    """Draw the band: a curve over one parameter, two maps over two, slices through the mark over more."""
    match field.space.dim:
        case 1:
            return _along(field, name)
        case 2:
            return heat(field, name)
        case _:
            return _slices(field, name)


def slice_through(field: Field, axis: Axis) -> Slice:
    """Return the band along an axis through the mark."""
    at = np.linspace(axis.low, axis.high, _POINTS)
    points = np.repeat(field.space.vector(field.mark)[np.newaxis], _POINTS, axis=0)
    points[:, field.space.names.index(axis.name)] = at
    return Slice(axis, at, *field.bounds(points))


def _along(field: Field, name: str) -> Picture:
    cut = slice_through(field, field.space.axes[0])

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        _paint_slice(axes, field, cut, field.tests)
        axes.legend(loc="upper left", ncols=3, borderaxespad=0, bbox_to_anchor=(0, 1.14))

    low, high = float(cut.lower.min()), float(cut.upper.max())
    alt = (
        f"{field.name.capitalize()} over {cut.axis.name} from {cut.axis.low:g} to {cut.axis.high:g} "
        f"{cut.axis.unit}: a band between {down(low)} and {up(high)} {field.unit}, with means of "
        f"{len(field.tests)} tests. The {field.pointed} is at {field.mark[cut.axis.name]:.4g} {cut.axis.unit}"
    )
    caption = (
        f"{field.name.capitalize()} {field.symbol} lies in the band simultaneously for all tests. Dots are "
        f"{field.dots}, larger for more; bars reach from the lowest to the highest. {field.remark}"
    ).strip()
    return Picture(field.title, caption, alt, draw(name, alt, (7.2, 3.6), paint))


def _slices(field: Field, name: str) -> Picture:
    shown = field.space.axes[:_MOST_SLICES]
    cuts = [slice_through(field, axis) for axis in shown]

    def paint(figure: Figure) -> None:
        columns = min(2, len(cuts))
        grid = figure.subplots(-(-len(cuts) // columns), columns, squeeze=False, sharey=True)
        for axes, cut in zip(grid.flat, cuts, strict=False):
            _paint_slice(axes, field, cut, [])
        for axes in grid.flat[len(cuts) :]:
            axes.set_visible(False)

    names = ", ".join(axis.name for axis in shown)
    alt = f"The band of the {field.name} along {names}, each through the {field.pointed}"
    left_out = len(field.space.axes) - len(shown)
    inside = f"{field.symbol} lies in it simultaneously for all tests."
    caption = f"The band along each parameter, the others held at the {field.pointed} (the triangle). " + (
        f"{left_out} more parameters are not drawn." if left_out else inside
    )
    rows = -(-len(cuts) // 2)
    title = f"{field.title}: slices through the {field.pointed}"
    return Picture(title, caption, alt, draw(name, alt, (7.2, 2.4 * rows), paint))


def _paint_slice(axes: Axes, field: Field, cut: Slice, tests: Sequence[Tested]) -> None:
    label = f"E {field.symbol} is in here"
    axes.fill_between(cut.at, cut.lower, cut.upper, color=BAND, alpha=0.22, lw=0, label=label)
    axes.plot(cut.at, cut.lower, color=BAND, lw=2)
    if tests:
        where = [test.params[cut.axis.name] for test in tests]
        lowest, highest = [test.lowest for test in tests], [test.highest for test in tests]
        axes.vlines(where, lowest, highest, color=MUTED, lw=0.8, alpha=0.7)
        most = max(test.rollouts for test in tests)
        sizes = [9 + 60 * test.rollouts / most for test in tests]
        means = [test.mean for test in tests]
        axes.scatter(where, means, s=sizes, color=INK, lw=0, zorder=3, label="mean of a test")
    mark = field.mark[cut.axis.name]
    axes.plot(mark, field.height, "v", color="none", mec=INK, ms=13, zorder=4, label=field.pointed)
    _fit(axes, field, cut, tests)
    axes.set_xlim(cut.axis.low - cut.axis.width / 50, cut.axis.high + cut.axis.width / 50)
    axes.set_xlabel(with_unit(cut.axis.name, cut.axis.unit))
    axes.set_ylabel(with_unit(field.symbol, field.unit))
    shade_violation(axes)


def _fit(axes: Axes, field: Field, cut: Slice, tests: Sequence[Tested]) -> None:
    """Set limits that show 0, every rollout and the whole lower bound; a wide upper bound may be cut off."""
    bottom = min(0.0, field.height, float(cut.lower.min()), *(test.lowest for test in tests))
    top = max(
        0.0,
        field.height,
        float(cut.lower.max()),
        float(cut.upper.min()),
        *(test.highest for test in tests),
    )
    room = 0.08 * (top - bottom or 1.0)
    axes.set_ylim(bottom - room, top + 2 * room)
