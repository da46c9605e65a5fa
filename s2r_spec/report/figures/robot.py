"""The parts of the machine that shift: on a top view of a quadruped, and as rows over time for any machine."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from s2r_spec.base.quantity import quantity, signed_quantity
from s2r_spec.diagnose.residuals.shifts import Body, BodyPart, Shift
from s2r_spec.report.figures.canvas import BAND, INK, MUTED, RULE, Picture, hover, pictured, shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEGS = ("FL", "FR", "RL", "RR")
JOINTS = ("hip", "thigh", "calf")
_MOST_ROWS = 12
_TRUNK = ("base", "trunk", "torso", "body")


def is_quadruped(body: Body) -> bool:
    """Return whether the parts belong to four legs with three joints each."""
    names = {part.name for part in body.parts}
    return all(f"{leg} {joint}" in names for leg in LEGS for joint in JOINTS)


def robot(body: Body, name: str) -> Picture:
    """Draw the parts."""
    rows = [(part, shift) for part in body.shifted for shift in part.shifts[:1]][:_MOST_ROWS]
    largest = {part.name: max((shift.sigma for shift in part.shifts), default=0.0) for part in body.parts}
    top = max(largest.values(), default=0.0)
    # The strength of a part's colour, on a logarithmic scale of its largest shift.
    strong = {
        name: 0.0 if sigma <= 0 else max(0.15, 1.0 - math.log2(top / sigma) / 6.0)
        for name, sigma in largest.items()
    }
    legs = is_quadruped(body)
    height = 0.9 + 0.32 * max(len(rows), 2)

    def paint(figure: Figure) -> None:
        if legs:
            top, bottom = figure.subplots(2, 1, height_ratios=[3.4, height])
            _quadruped(top, strong)
        else:
            bottom = figure.add_subplot()
        _timeline(bottom, rows, strong, body.duration)

    many = f"{len(body.shifted)} of {len(body.parts)} parts"
    words = "; ".join(f"{body.place(part, shift)}: {amount(shift)}" for part, shift in rows[:4])
    alt = f"{many} have residuals that the model does not explain" + (f": {words}" if words else "")
    caption = (
        "Residuals are the part of a recorded motion that the simulator's equations do not explain. They are "
        "compared with the residuals of nominal rollouts at the same tests. Darker colours are larger, relative to the "
        f"scatter between runs. The picture shows the shifts that are significant at a false-discovery rate of "
        f"{100 * body.level:g} %, out of {body.asked} comparisons (residuals times time windows)."
    )
    left = sum(bool(part.shifts) for part in body.parts) - len(rows)
    if left > 0:
        caption += f" {left} more parts are in the JSON."
    tall = height + (3.0 if legs else 0.0)
    return pictured("Which part of the machine", caption, alt, name, tall, paint)


def amount(shift: Shift) -> str:
    """Return the residual and the size of a shift: "force −19.9 N"."""
    steady = abs(shift.mean) > 0.5 * shift.size
    size = signed_quantity(shift.mean, shift.unit) if steady else f"±{quantity(shift.size, shift.unit)}"
    return f"{shift.channel}{' (rms)' if shift.kind == 'rms' else ''} {size}"


def _timeline(
    axes: Axes, rows: list[tuple[BodyPart, Shift]], strong: Mapping[str, float], duration: float
) -> None:
    places = range(len(rows) - 1, -1, -1)
    for place, (part, shift) in zip(places, rows, strict=True):
        bar = axes.broken_barh(
            [(shift.begin, shift.end - shift.begin)], (place - 0.36, 0.72),
            facecolor=BAND, alpha=0.15 + 0.6 * strong[part.name], edgecolor="none",
        )  # fmt: skip
        hover(
            bar, f"{part.name}, {shift.begin:.3g} to {shift.end:.3g} s: {amount(shift)}, {shift.sigma:.3g} σ"
        )
        times = f"{shift.sigma:.0f} σ" if shift.sigma >= 10 else f"{shift.sigma:.2g} σ"
        late = shift.begin > 0.55 * duration
        axes.text(
            min(shift.end, duration) - 0.01 * duration if late else shift.begin + 0.01 * duration, place,
            f"{shorten(amount(shift))} ({times})", va="center", ha="right" if late else "left", color=INK,
        )  # fmt: skip
    axes.set_yticks(list(places), [shorten(part.name) for part, _ in rows])
    axes.set_ylim(-0.7, max(len(rows), 1) - 0.3)
    axes.set_xlim(0, duration)
    axes.set_xlabel("time [s]")
    axes.grid(axis="y", visible=False)
    if not rows:
        axes.text(duration / 2, 0, "no part shifts", ha="center", va="center", color=MUTED)


def _quadruped(axes: Axes, strong: Mapping[str, float]) -> None:
    """Draw a top view, the front to the right: each leg's joints from the trunk outwards, then its foot."""
    from matplotlib.patches import Circle, FancyBboxPatch

    def fill(shape: Callable[..., Any], part: str, deepest: float = 0.7, edge: str = MUTED) -> None:
        axes.add_patch(shape(facecolor="none", edgecolor=edge, lw=1.0))
        if strength := strong.get(part, 0.0):
            axes.add_patch(shape(facecolor=BAND, edgecolor="none", alpha=0.1 + deepest * strength))

    def box(x: float, y: float, width: float, height: float, part: str, label: str) -> None:
        rounded = "round,pad=0,rounding_size=0.12"
        fill(partial(FancyBboxPatch, (x, y), width, height, boxstyle=rounded), part)
        axes.text(x + width / 2, y + height / 2, label, ha="center", va="center", color=INK)

    box(-2.2, -0.7, 4.4, 1.4, next((name for name in _TRUNK if name in strong), ""), "trunk")
    axes.plot([2.2, 2.6, 2.2], [0.35, 0.0, -0.35], color=MUTED, lw=1)
    axes.text(2.8, 0.0, "front", va="center", color=MUTED)
    drawn = set(_TRUNK)
    for leg in LEGS:
        side = 1.0 if leg.endswith("L") else -1.0
        x = 1.0 if leg.startswith("F") else -2.2
        axes.text(x - 0.12, side * 1.05, leg, ha="right", va="center", color=INK, fontweight="bold")
        for k, joint in enumerate(JOINTS):
            y = 0.82 + 0.6 * k if side > 0 else -0.82 - 0.6 * k - 0.5
            part, sensor = f"{leg} {joint}", f"{leg} {joint} encoder"
            box(x, y, 1.2, 0.5, part, joint)
            fill(partial(Circle, (x + 1.4, y + 0.25), 0.11), sensor, 0.8, RULE)
            drawn |= {part, sensor}
        y = side * (0.82 + 0.6 * 3 + 0.22)
        fill(partial(Circle, (x + 0.6, y), 0.22), f"{leg} foot")
        drawn.add(f"{leg} foot")
        axes.text(x + 0.9, y, "foot", va="center", color=MUTED)
    others = [name for name in strong if name not in drawn and strong[name] > 0]
    axes.text(
        3.3, -2.6, "small rings: encoders" + (f"\nalso: {', '.join(others[:3])}" if others else ""),
        color=MUTED, va="bottom",
    )  # fmt: skip
    axes.set_xlim(-5.2, 5.6)
    axes.set_ylim(-3.1, 3.1)
    axes.set_aspect("equal")
    axes.axis("off")
