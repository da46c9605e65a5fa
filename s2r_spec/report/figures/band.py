"""Pictures of a bound: its band over the test space with the rollouts behind it, and its interval after each batch.

Bounds are of ρ in simulation, of the gap, or of ρ on the machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.quantity import signed_quantity
from s2r_spec.certify.bound.certificate import Certificate
from s2r_spec.certify.bound.rounding import down, interval_text, up, width_text
from s2r_spec.certify.result.check_result import Tested
from s2r_spec.certify.search.search import Search
from s2r_spec.report.check import test_words
from s2r_spec.report.figures.canvas import (
    BAND,
    INK,
    MUTED,
    PAPER,
    Picture,
    add_scale,
    hover_points,
    hover_strips,
    paint_map,
    panels,
    pictured,
    shade_violation,
    with_unit,
)
from s2r_spec.space import Axis, Space

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_POINTS = 301
_MOST_SLICES = 6
_SIDE = 61
# Before data the interval is [−B, B]. Drawn to scale, it would flatten the rest of the picture.
_MARGIN = 2.5


@dataclass(frozen=True)
class Field:
    """An expected value over the test space.

    Attributes:
        searches: of the negatives of its terms, one or two; their bands hold at all points at once.
        mark: the test to mark; slices go through it.
        height: value at the mark [unit].
        pointed: name of the mark, "worst test".
        lower: lower bound of the worst expected value [unit].
        upper: upper bound of the same [unit].
        symbol: "ρ" or "Δ".
        name: "expected robustness".
        dots: the meaning of a dot: "means over a test's rollouts".
        remark: one more sentence under the picture, or "".
    """

    space: Space
    searches: tuple[Search, ...]
    tests: tuple[Tested, ...]
    mark: Mapping[str, float]
    height: float
    pointed: str
    lower: float
    upper: float
    symbol: str
    name: str
    unit: str
    title: str
    dots: str
    remark: str

    def bounds(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (n,) lower and upper bounds at (n, dim) points."""
        lower, upper = (sum(ends) for ends in zip(*(one.band(points) for one in self.searches), strict=True))
        return -upper, -lower


def band(field: Field, name: str) -> Picture:
    """Draw the band: a curve over one parameter, two maps over two, slices through the mark over more."""
    match field.space.dim:
        case 1:
            return _along(field, name)
        case 2:
            return _maps(field, name)
        case _:
            return _slices(field, name)


def _slice(field: Field, axis: Axis) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values of one parameter, the others being at the mark, and the band's lower and upper bounds there."""
    at = np.linspace(axis.low, axis.high, _POINTS)
    points = np.repeat(field.space.vector(field.mark)[np.newaxis], _POINTS, axis=0)
    points[:, field.space.names.index(axis.name)] = at
    return at, *field.bounds(points)


def _along(field: Field, name: str) -> Picture:
    axis = field.space.axes[0]
    _, lower, upper = _slice(field, axis)

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        _paint_slice(axes, field, axis, field.tests)
        axes.legend(loc="upper left", ncols=3, borderaxespad=0, bbox_to_anchor=(0, 1.14))

    alt = (
        f"{field.name.capitalize()} over {axis.name} from {axis.low:g} to {axis.high:g} {axis.unit}: a band between "
        f"{down(float(lower.min()))} and {up(float(upper.max()))} {field.unit}, with means of {len(field.tests)} "
        f"tests. The {field.pointed} is at {field.mark[axis.name]:.4g} {axis.unit}"
    )
    caption = (
        f"{field.name.capitalize()} {field.symbol} lies in the band simultaneously for all tests. Dots are "
        f"{field.dots}, larger for more; bars reach from the lowest to the highest. {field.remark}"
    ).strip()
    return pictured(field.title, caption, alt, name, 3.4, paint)


def _slices(field: Field, name: str) -> Picture:
    shown = field.space.axes[:_MOST_SLICES]

    def paint(figure: Figure) -> None:
        for axes, axis in zip(panels(figure, len(shown), 2), shown, strict=True):
            _paint_slice(axes, field, axis, [])

    names = ", ".join(axis.name for axis in shown)
    alt = f"The band of the {field.name} along {names}, each through the {field.pointed}"
    left_out = len(field.space.axes) - len(shown)
    inside = f"{field.symbol} lies in it simultaneously for all tests."
    caption = f"The band along each parameter, the others held at the {field.pointed} (the triangle). " + (
        f"{left_out} more parameters are not drawn." if left_out else inside
    )
    rows = -(-len(shown) // 2)
    title = f"{field.title}: slices through the {field.pointed}"
    return pictured(title, caption, alt, name, 2.1 * rows, paint)


def _paint_slice(axes: Axes, field: Field, axis: Axis, tests: Sequence[Tested]) -> None:
    at, lower, upper = _slice(field, axis)
    label = f"E {field.symbol} is in here"
    axes.fill_between(at, lower, upper, color=BAND, alpha=0.22, lw=0, label=label)
    axes.plot(at, lower, color=BAND, lw=2)
    if tests:
        where = [test.params[axis.name] for test in tests]
        lowest, highest = [test.lowest for test in tests], [test.highest for test in tests]
        axes.vlines(where, lowest, highest, color=MUTED, lw=0.8, alpha=0.7)
        most = max(test.rollouts for test in tests)
        sizes = [9 + 60 * test.rollouts / most for test in tests]
        means = [test.mean for test in tests]
        axes.scatter(where, means, s=sizes, color=INK, lw=0, zorder=3, label="mean of a test")
        hover_points(axes, where, means, [_mean(test, field) for test in tests])
    mark = field.mark[axis.name]
    axes.plot(mark, field.height, "v", color="none", mec=INK, ms=13, zorder=4, label=field.pointed)
    # 0, every rollout and the whole lower bound are shown; a wide upper bound may be cut off.
    bottom = min(0.0, field.height, float(lower.min()), *(test.lowest for test in tests))
    ends = float(lower.max()), float(upper.min())
    top = max(0.0, field.height, *ends, *(test.highest for test in tests))
    room = 0.08 * (top - bottom or 1.0)
    axes.set_ylim(bottom - room, top + 2 * room)
    axes.set_xlim(axis.low - axis.width / 50, axis.high + axis.width / 50)
    axes.set_xlabel(with_unit(axis.name, axis.unit))
    axes.set_ylabel(with_unit(field.symbol, field.unit))
    shade_violation(axes)


def _maps(field: Field, name: str) -> Picture:
    """Draw both bounds on one colour scale, white at 0."""
    across, along = field.space.axes
    lower, upper = field.bounds(field.space.grid((_SIDE, _SIDE)))
    maps = {
        "lower bound": lower.reshape(_SIDE, _SIDE).T,
        "upper bound": upper.reshape(_SIDE, _SIDE).T,
    }
    tests, mark = field.tests, field.mark
    # Far from any test the bounds are about ±B, so the colour scale comes from the tests.
    scale = max(abs(field.lower), abs(field.upper), *(abs(test.mean) for test in tests)) or 1.0
    pixel = across.width / (_SIDE - 1) / 2, along.width / (_SIDE - 1) / 2
    extent = (across.low - pixel[0], across.high + pixel[0], along.low - pixel[1], along.high + pixel[1])

    def paint(figure: Figure) -> None:
        both = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, (title, values) in zip(both, maps.items(), strict=True):
            image = paint_map(axes, values, extent, scale, "nearest")
            if values.min() < 0 < values.max():
                axes.contour(values, [0.0], colors=["black"], linewidths=1.2, extent=extent, origin="lower")
            x, y = ([test.params[axis.name] for test in tests] for axis in (across, along))
            axes.scatter(x, y, s=7, c="black", lw=0)
            hover_points(axes, x, y, [_mean(test, field) for test in tests])
            axes.plot(mark[across.name], mark[along.name], "v", color=PAPER, mec=INK, ms=9, clip_on=False)
            axes.grid(False)
            axes.set_title(title)
            axes.set_xlabel(with_unit(across.name, across.unit))
        both[0].set_ylabel(with_unit(along.name, along.unit))
        add_scale(figure, image, both.tolist(), with_unit(field.symbol, field.unit), extend="both")

    alt = (
        f"Two maps over {across.name} and {along.name}: lower and upper bound of the {field.name}, with "
        f"{len(tests)} tests; the {field.pointed} is at {across.name} = {mark[across.name]:.4g} {across.unit}, "
        f"{along.name} = {mark[along.name]:.4g} {along.unit}"
    )
    caption = (
        f"{field.name.capitalize()} {field.symbol} lies between the two maps simultaneously for all tests. Blue is "
        f"above 0, red below, the black line is 0. Dots are tests, the triangle is the {field.pointed}. {field.remark}"
    ).strip()
    return pictured(field.title, caption, alt, name, 3.0, paint)


def _mean(test: Tested, field: Field) -> str:
    """Return a test, its mean and the number of its rollouts."""
    words = test_words(test.params, field.space.units)
    return f"{words}: {field.symbol} {signed_quantity(test.mean, field.unit)}, {test.rollouts} rollouts"


def interval(
    history: Sequence[Certificate], what: str, unit: str, title: str, name: str, counted: str = "rollouts"
) -> Picture:
    """Draw an interval after each batch.

    ``history`` has the certificates of a search that maximises the negative of ``what``, "worst expected ρ"; the last
    one is as it ended.
    """
    last = history[-1]
    rollouts = [entry.rollouts for entry in history]
    lower = [-entry.upper for entry in history]
    upper = [-entry.lower for entry in history]

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.fill_between(rollouts, lower, upper, step="post", color=BAND, alpha=0.25, lw=0)
        axes.step(rollouts, lower, where="post", color=BAND, lw=2)
        axes.step(rollouts, upper, where="post", color=BAND, lw=1)
        axes.plot(rollouts[-1:], lower[-1:], "o", color=INK, ms=5)
        axes.annotate(down(lower[-1]), (rollouts[-1], lower[-1]), (6, -4), textcoords="offset points")
        room = _MARGIN * max(last.epsilon, 1e-12)
        axes.set_ylim(min(lower[-1] - room / 3, -room / 6), max(upper[-1] + room, room / 6))
        axes.set_xlim(rollouts[0], rollouts[-1] * 1.12)
        ends = [
            f"after {n} {counted}: {interval_text(*one)} {unit}".rstrip()
            for n, *one in zip(rollouts, lower, upper, strict=True)
        ]
        hover_strips(axes, [*rollouts, rollouts[-1] * 1.12], ends)
        axes.set_xlabel(counted)
        axes.set_ylabel(with_unit(what, unit))
        shade_violation(axes)

    alt = (
        f"The interval of the {what} against {counted}: after {rollouts[-1]} it is "
        f"{interval_text(lower[-1], upper[-1])} {unit}".rstrip()
    )
    valid = ", valid at any time" if last.label.bounds else ""
    caption = (
        f"Lower and upper end after each batch{valid}. The final width is {width_text(last.epsilon)}; "
        f"the target was {last.target:g}."
    )
    return pictured(title, caption, alt, name, 2.4, paint)
