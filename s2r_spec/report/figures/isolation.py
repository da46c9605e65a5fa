"""The isolability matrix as a map: which effects the tests distinguish; confounded pairs are marked."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from s2r_spec.diagnose.isolability import APART, Isolability
from s2r_spec.report.figures.canvas import BAD, INK, RULE, Picture, draw, shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NUMBERS = 12
"""Most effects for which each cell shows its number."""


def order(found: Isolability) -> list[int]:
    """Return the effects in catalogue order, but with confounded ones side by side."""
    placed: list[int] = []
    for k in range(len(found.effects)):
        waiting = [k]
        while waiting:
            one = waiting.pop(0)
            if one not in placed:
                placed.append(one)
                waiting += [found.effects.index(name) for name in found.confounded(found.effects[one])[1:]]
    return placed


def pairs(found: Isolability) -> list[tuple[str, str]]:
    """Return the confounded pairs, nearest first."""
    near = np.minimum(found.sigma, found.sigma.T)
    chosen = [(a, b) for a, b in zip(*np.nonzero(found.alike), strict=True) if a < b]
    return [
        (found.effects[a], found.effects[b]) for a, b in sorted(chosen, key=lambda ab: near[ab[0], ab[1]])
    ]


def isolation(found: Isolability, answer: Collection[str], name: str) -> Picture:
    """Draw the matrix; ``answer`` are the effects that the diagnosis names."""
    placed = order(found)
    count = len(placed)
    sigma = np.minimum(found.sigma, found.sigma.T)[np.ix_(placed, placed)]
    alike = found.alike[np.ix_(placed, placed)]
    names = [found.effects[k] for k in placed]
    most = 4 * APART
    shown = np.clip(sigma, 0.0, most)
    np.fill_diagonal(shown, np.nan)

    def paint(figure: Figure) -> None:
        from matplotlib.patches import Rectangle

        axes = figure.add_subplot()
        axes.set_facecolor(RULE)
        image = axes.imshow(
            shown, cmap="Blues_r", vmin=0.0, vmax=most, interpolation="nearest", aspect="auto"
        )
        for a in range(count):
            for b in range(count):
                if alike[a, b]:
                    axes.add_patch(Rectangle((b - 0.5, a - 0.5), 1, 1, fill=False, ec=BAD, lw=1.6))
                if a != b and count <= _NUMBERS:
                    words = f"{sigma[a, b]:.1f}" if sigma[a, b] < 10 else f"{min(sigma[a, b], 999):.0f}"
                    dark = shown[a, b] < 0.45 * most
                    axes.text(
                        b, a, words, ha="center", va="center", size=8, color="white" if dark else "black"
                    )
        size = 9 if count <= 20 else 7
        many = count > 8
        axes.set_xticks(
            range(count), [shorten(n) for n in names], size=size, rotation=90 if many else 40,
            ha="center" if many else "right", rotation_mode="default" if many else "anchor",
        )  # fmt: skip
        axes.set_yticks(range(count), [shorten(n) for n in names], size=size)
        for label in (*axes.get_xticklabels(), *axes.get_yticklabels()):
            if label.get_text() in answer:
                label.set_fontweight("bold")
        axes.grid(False)
        bar = figure.colorbar(image, ax=axes, extend="max", shrink=0.8, pad=0.02)
        bar.set_label("σ apart")
        bar.ax.axhline(APART, color=INK, lw=1.2)
        if bar.solids is not None:
            bar.solids.set_rasterized(True)

    near = pairs(found)
    words = ", ".join(f"{a} and {b}" for a, b in near[:6]) + (
        f" and {len(near) - 6} more" if len(near) > 6 else ""
    )
    alt = f"Map of the distance of any two of {count} effects at these tests, in standard deviations; " + (
        f"less than {APART:g}, or of one kind: {words}" if near else f"all are {APART:g} or more apart"
    )
    caption = (
        "Before any real test: the distance of each effect, at its typical size, from the closest response of another. "
        + (
            f"Red frames mark pairs less than {APART:g} σ apart, and pairs of one kind, which a model error of a fifth "
            f"can confuse. These tests may not tell them apart: {words}."
            if near
            else f"All pairs are at least {APART:g} σ apart, so these tests can tell all effects apart."
        )
        + (" Bold effects are the answer." if answer else "")
    )
    side = min(1.4 + 0.28 * count, 6.4) if count <= 20 else 7.0
    picture = draw(name, alt, (7.2, side), paint)
    return Picture("Which effects these tests can tell apart", caption, alt, picture)
