"""How the certified interval closed: its two ends against the rollouts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from s2r_spec.certify import outward
from s2r_spec.certify.certificate import Label
from s2r_spec.report.figures.canvas import BAND, INK, Picture, draw, shade_violation, with_unit
from s2r_spec.report.recompute import Recomputed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Before data the interval is [−B, B]; drawn to scale it would flatten all that comes after.
_MARGIN = 2.5


def interval(run: Recomputed, name: str) -> Picture:
    """Draw the interval of the worst expected ρ after each batch."""
    result, certificate = run.result, run.result.certificate
    rollouts = [entry.rollouts for entry in run.history]
    lower = [-entry.upper for entry in run.history]
    upper = [-entry.lower for entry in run.history]

    def paint(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.fill_between(rollouts, lower, upper, step="post", color=BAND, alpha=0.25, lw=0)
        axes.step(rollouts, lower, where="post", color=BAND, lw=2)
        axes.step(rollouts, upper, where="post", color=BAND, lw=1)
        axes.plot(rollouts[-1:], [result.lower], "o", color=INK, ms=5)
        axes.annotate(
            outward.down(result.lower), (rollouts[-1], result.lower), (6, -4), textcoords="offset points"
        )
        room = _MARGIN * max(certificate.epsilon, 1e-12)
        axes.set_ylim(min(result.lower - room / 3, -room / 6), max(result.upper + room, room / 6))
        axes.set_xlim(rollouts[0], rollouts[-1] * 1.12)
        axes.set_xlabel("rollouts")
        axes.set_ylabel(with_unit("worst expected ρ", result.unit))
        shade_violation(axes)

    alt = (
        f"The interval of the worst expected robustness against rollouts: after {rollouts[-1]} rollouts it is "
        f"{outward.between(result.lower, result.upper)} {result.unit}".rstrip()
    )
    valid = "" if certificate.label is Label.REFUSED else ", valid at every moment"
    return Picture(
        "How the interval closed",
        f"Lower and upper end after each batch{valid}; it ended {outward.wide(certificate.epsilon)} wide, "
        f"{certificate.target:g} was asked for.",
        alt,
        draw(name, alt, (7.2, 2.6), paint),
    )
