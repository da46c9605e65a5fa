"""The two ends of the certified interval against the number of rollouts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from s2r_spec.certify.bound.certificate import Certificate
from s2r_spec.certify.bound.rounding import down, interval_text, width_text
from s2r_spec.report.figures.canvas import BAND, INK, Picture, draw, shade_violation, with_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Before data the interval is [−B, B]. Drawn to scale, it would flatten the rest of the picture.
_MARGIN = 2.5


def interval(
    history: Sequence[Certificate], what: str, unit: str, title: str, name: str, counted: str = "rollouts"
) -> Picture:
    """Draw an interval after each batch.

    Args:
        history: certificates of a search that maximises the negative, the last one as it ended.
        what: the quantity, "worst expected ρ".
        unit: the unit of the interval.
        title: the title of the picture.
        name: the name of the figure in the page.
        counted: label of the horizontal axis.
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
    return Picture(title, caption, alt, draw(name, alt, (7.2, 2.6), paint))
