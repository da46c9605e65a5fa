"""How much of each effect the machine stands: the size that was found, and where ρ changes sign beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from s2r_spec.base.quantity import quantity
from s2r_spec.diagnose.gap.breaking import Breaking, BreakingSize
from s2r_spec.report.figures.canvas import BAD, GOOD, INK, MUTED, Picture, hover, pictured, shorten
from s2r_spec.report.gap_words import breaking_cell

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_ROWS = 14


def breaking_picture(breaking: Breaking, name: str) -> Picture:
    """Draw a row for each parameter, nearest crossing first."""
    rows = breaking.sizes[:_MOST_ROWS]

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        for place, one in zip(range(len(rows) - 1, -1, -1), rows, strict=True):
            _row(axes, place, one, breaking.holds)
        axes.axvline(0, color=MUTED, lw=0.8)
        axes.set_yticks(range(len(rows) - 1, -1, -1), [shorten(one.name) for one in rows])
        axes.set_ylim(-0.6, len(rows) - 0.4)
        axes.set_xlabel("size in typical sizes, from nominal")
        axes.grid(axis="y", visible=False)

    does = "breaks the requirement" if breaking.holds else "restores the requirement"
    alt = f"The sizes at which a single effect {does}: " + "; ".join(
        f"{one.name} {breaking_cell(one)}" for one in breaking.crossed
    )
    colours = ("Green", "red", "broken") if breaking.holds else ("Red", "green", "met")
    caption = (
        f"Each row is one parameter, all others as they were found. The dot is its size on this machine. {colours[0]} "
        f"is where ρ keeps its sign at every recorded test. From the line on, {colours[1]}, the requirement is "
        f"{colours[2]}; the pale part lies between two simulated sizes. A row ends where no size was simulated."
    )
    if left := len(breaking.sizes) - len(rows):
        caption += f" {left} more parameters are in the table."
    title = (
        "How much of each effect the machine stands"
        if breaking.holds
        else "What would restore the requirement"
    )
    return pictured(title, caption, alt, name, 0.9 + 0.3 * max(len(rows), 2), paint)


def _row(axes: Axes, place: float, one: BreakingSize, holds: bool) -> None:
    own, other = (GOOD, BAD) if holds else (BAD, GOOD)
    low, high = one.reach

    def bar(begin: float, end: float, colour: str, alpha: float) -> None:
        axes.broken_barh(
            [(min(begin, end), abs(end - begin))], (place - 0.3, 0.6), facecolor=colour, alpha=alpha, lw=0
        )

    for side, end in ((one.below, low), (one.above, high)):
        bar(one.found, end if side is None else side.before, own, 0.35)
        if side is not None:
            bar(side.before, side.after, other, 0.2)
            bar(side.after, end, other, 0.6)
            if side.at is not None:
                axes.plot([side.at] * 2, [place - 0.3, place + 0.3], color=INK, lw=1.6)
    axes.plot([one.found], [place], "o", color=INK, ms=6)
    now = quantity(one.estimate, one.axis.unit)
    words = f"{one.name}: now {now}, {'breaks' if holds else 'holds again'} {breaking_cell(one)}"
    (target,) = axes.plot(
        [low, high], [place] * 2, color=INK, alpha=0, lw=16, solid_capstyle="butt", zorder=9
    )
    hover(target, words)
