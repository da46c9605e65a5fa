"""The band over the test space: where E ρ lies, at all tests at once, and the rollouts that say so."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from s2r_spec.certify.check import Tested, tested
from s2r_spec.certify.outward import down, up
from s2r_spec.report.figures.canvas import (
    BAND,
    INK,
    MUTED,
    Picture,
    draw,
    shade_violation,
    with_unit,
)
from s2r_spec.report.figures.heat import heat
from s2r_spec.report.recompute import Recomputed
from s2r_spec.space import Axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

_POINTS = 301
_MOST_SLICES = 6


@dataclass(frozen=True)
class Slice:
    """The band along one axis, the other parameters as they are at the worst test."""

    axis: Axis
    at: FloatArray
    lower: FloatArray
    upper: FloatArray


def band(run: Recomputed, name: str) -> Picture:
    """Draw the band: along the one parameter, as two maps over two, as slices through the worst test over more."""
    match run.spec.space.dim:
        case 1:
            return _along(run, name)
        case 2:
            return heat(run, name)
        case _:
            return _slices(run, name)


def slice_through(run: Recomputed, axis: Axis) -> Slice:
    """Return the band along an axis through the worst test."""
    space = run.spec.space
    at = np.linspace(axis.low, axis.high, _POINTS)
    points = np.repeat(space.vector(run.result.worst.params)[np.newaxis], _POINTS, axis=0)
    points[:, space.names.index(axis.name)] = at
    lower, upper = run.search.band(points)  # of −ρ
    return Slice(axis, at, -upper, -lower)


def _along(run: Recomputed, name: str) -> Picture:
    tests, cut = tested(run.records), slice_through(run, run.spec.space.axes[0])

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        _paint_slice(axes, run, cut, tests)
        axes.legend(loc="upper left", ncols=3, borderaxespad=0, bbox_to_anchor=(0, 1.14))

    low, high = float(cut.lower.min()), float(cut.upper.max())
    alt = (
        f"Expected robustness over {cut.axis.name} from {cut.axis.low:g} to {cut.axis.high:g} {cut.axis.unit}: "
        f"a band between {down(low)} and {up(high)} {run.result.unit}, with the means of {len(tests)} tests; "
        f"the worst is at {run.result.worst.params[cut.axis.name]:.4g} {cut.axis.unit}"
    )
    caption = (
        "Expected ρ lies in the band at every test at once. Dots are means over a test's rollouts, larger for "
        "more; bars reach from its lowest to its highest rollout. Where ρ is clearly not at its worst, "
        "the search saved its rollouts and the band stays wide."
    )
    return Picture("Where it is tight over the test space", caption, alt, draw(name, alt, (7.2, 3.6), paint))


def _slices(run: Recomputed, name: str) -> Picture:
    shown = run.spec.space.axes[:_MOST_SLICES]
    cuts = [slice_through(run, axis) for axis in shown]

    def paint(figure: Figure) -> None:
        columns = min(2, len(cuts))
        grid = figure.subplots(-(-len(cuts) // columns), columns, squeeze=False, sharey=True)
        for axes, cut in zip(grid.flat, cuts, strict=False):
            _paint_slice(axes, run, cut, [run.result.worst])
        for axes in grid.flat[len(cuts) :]:
            axes.set_visible(False)

    names = ", ".join(axis.name for axis in shown)
    alt = f"The band of expected robustness along {names}, each through the worst test"
    left_out = len(run.spec.space.axes) - len(shown)
    caption = (
        "The band along each parameter, the others held at the worst test (the dot). "
        + ("Expected ρ lies in it at every test at once." if not left_out else "")
        + (f" {left_out} more parameters are not drawn." if left_out else "")
    )
    rows = -(-len(cuts) // 2)
    return Picture("Slices through the worst test", caption, alt, draw(name, alt, (7.2, 2.4 * rows), paint))


def _paint_slice(axes: Axes, run: Recomputed, cut: Slice, tests: list[Tested]) -> None:
    where = [test.params[cut.axis.name] for test in tests]
    means = [test.mean for test in tests]
    axes.fill_between(cut.at, cut.lower, cut.upper, color=BAND, alpha=0.22, lw=0, label="E ρ is in here")
    axes.plot(cut.at, cut.lower, color=BAND, lw=2)
    axes.vlines(
        where,
        [test.lowest for test in tests],
        [test.highest for test in tests],
        color=MUTED,
        lw=0.8,
        alpha=0.7,
    )
    sizes = 9 + 60 * np.array([test.rollouts for test in tests]) / max(test.rollouts for test in tests)
    axes.scatter(where, means, s=sizes.tolist(), color=INK, lw=0, zorder=3, label="mean of a test")
    worst = run.result.worst
    axes.plot(
        worst.params[cut.axis.name],
        worst.mean,
        "v",
        color="none",
        mec=INK,
        ms=13,
        zorder=4,
        label="worst test",
    )
    _fit(axes, cut, tests)
    axes.set_xlim(cut.axis.low - cut.axis.width / 50, cut.axis.high + cut.axis.width / 50)
    axes.set_xlabel(with_unit(cut.axis.name, cut.axis.unit))
    axes.set_ylabel(with_unit("ρ", run.result.unit))
    shade_violation(axes)


def _fit(axes: Axes, cut: Slice, tests: list[Tested]) -> None:
    """Show 0, every rollout and the whole lower bound; a wide upper bound may run out of the picture."""
    bottom = min(0.0, float(cut.lower.min()), *(test.lowest for test in tests))
    top = max(0.0, float(cut.lower.max()), float(cut.upper.min()), *(test.highest for test in tests))
    room = 0.08 * (top - bottom or 1.0)
    axes.set_ylim(bottom - room, top + 2 * room)
