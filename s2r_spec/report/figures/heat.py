"""The band over two test parameters: one map of its lower bound, one of its upper bound."""

from __future__ import annotations

from typing import TYPE_CHECKING

from s2r_spec.report.figures.canvas import INK, PAPER, Picture, draw, with_unit
from s2r_spec.report.figures.field import Field

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SIDE = 61


def heat(field: Field, name: str) -> Picture:
    """Draw both bounds on one colour scale, white at 0."""
    across, up = field.space.axes
    lower, upper = field.bounds(field.space.grid((_SIDE, _SIDE)))
    maps = {
        f"at least (lower bound of E {field.symbol})": lower.reshape(_SIDE, _SIDE).T,
        f"at most (upper bound of E {field.symbol})": upper.reshape(_SIDE, _SIDE).T,
    }
    tests, mark = field.tests, field.mark
    # Far from any test the bounds are about ±B, so the colour scale comes from the tests.
    scale = max(abs(field.lower), abs(field.upper), *(abs(test.mean) for test in tests)) or 1.0
    pixel = across.width / (_SIDE - 1) / 2, up.width / (_SIDE - 1) / 2
    extent = (across.low - pixel[0], across.high + pixel[0], up.low - pixel[1], up.high + pixel[1])

    def paint(figure: Figure) -> None:
        both = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, (title, values) in zip(both, maps.items(), strict=True):
            image = axes.imshow(
                values,
                origin="lower",
                extent=extent,
                aspect="auto",
                cmap="RdBu",
                vmin=-scale,
                vmax=scale,
                interpolation="nearest",
            )
            if values.min() < 0 < values.max():
                axes.contour(values, [0.0], colors=["black"], linewidths=1.2, extent=extent, origin="lower")
            _mark_tests(axes, field)
            axes.grid(False)
            axes.set_title(title)
            axes.set_xlabel(with_unit(across.name, across.unit))
        both[0].set_ylabel(with_unit(up.name, up.unit))
        bar = figure.colorbar(image, ax=both.tolist(), extend="both", pad=0.01)
        bar.set_label(with_unit(field.symbol, field.unit))
        if bar.solids is not None:
            bar.solids.set_rasterized(True)  # 256 little paths otherwise

    alt = (
        f"Two maps over {across.name} and {up.name}: lower and upper bound of the {field.name}, with "
        f"{len(tests)} tests; the {field.pointed} is at {across.name} = {mark[across.name]:.4g} {across.unit}, "
        f"{up.name} = {mark[up.name]:.4g} {up.unit}"
    )
    caption = (
        f"{field.name.capitalize()} {field.symbol} lies between the two maps simultaneously for all tests. Blue is "
        f"above 0, red below, the black line is 0. Dots are tests, the triangle is the {field.pointed}. {field.remark}"
    ).strip()
    return Picture(field.title, caption, alt, draw(name, alt, (7.2, 3.4), paint))


def _mark_tests(axes: Axes, field: Field) -> None:
    """Draw the tests, and the one to which the picture points."""
    across, up = (axis.name for axis in field.space.axes)
    tests, mark = field.tests, field.mark
    axes.scatter(
        [test.params[across] for test in tests], [test.params[up] for test in tests], s=7, c="black", lw=0
    )
    axes.plot(mark[across], mark[up], "v", color=PAPER, mec=INK, ms=9, clip_on=False)
