"""Δρ of one pair of rollouts over time: both traces, the values allowed, and each sample's part of Δρ."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from s2r_spec.attribution.attribute import Attribution, label_components
from s2r_spec.base.errors import S2RError
from s2r_spec.base.quantity import signed_quantity
from s2r_spec.diagnose.gap.where import Where
from s2r_spec.report.check import test_words
from s2r_spec.report.figures.canvas import BAD, GOOD, INK, Picture, hover, pictured, with_unit
from s2r_spec.report.figures.tolerance import Component, Margins
from s2r_spec.report.figures.traces import Panel, legend_lines, limits, paint_panel
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_PANELS = 4
_BARS = 48
VISIBLE = 0.1
"""Traces closer than this part of a signal's range are drawn as their difference."""


def blame(where: Where, spec: Spec, name: str) -> Picture:
    """Draw the worst test that was run: its signals, and the part of the gap at each time."""
    pair = where.pair
    panels = _panels(where, spec)
    edges = np.linspace(pair.times[0], pair.times[-1], _BARS + 1)
    place = np.clip(np.searchsorted(edges, pair.times, side="right") - 1, 0, _BARS - 1)
    amount = np.bincount(place, weights=pair.over_time, minlength=_BARS)

    def paint(figure: Figure) -> None:
        ratios = [2.0] * len(panels) + [1.5]
        rows = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
        for axes, panel in zip(rows, panels, strict=False):
            paint_panel(axes, panel, None, ("real", "simulated"))
        last = rows[-1]
        colours = [BAD if value < 0 else GOOD for value in amount]
        bars = last.bar(edges[:-1], amount, np.diff(edges), align="edge", color=colours, alpha=0.8, lw=0)
        for bar, begin, end, value in zip(bars, edges[:-1], edges[1:], amount, strict=True):
            hover(bar, f"{begin:.3g} to {end:.3g} s: {signed_quantity(value, pair.unit)} of Δρ")
        last.axhline(0, color=INK, lw=0.8)
        last.set_ylabel(with_unit("part of Δρ", pair.unit))
        last.set_xlabel("time [s]")
        lines = legend_lines(rows[0], "real", "simulated")
        figure.legend(handles=lines, loc="outside upper left", ncols=2)
        figure.align_ylabels()

    test = test_words(where.test, spec.space.units)
    at, within = (f" at {test}", f" ({test})") if test else ("", "")
    alt = (
        f"A real and a simulated rollout{at}, Δρ = {pair.delta:+.4g} {pair.unit}, "
        "and the contribution of each instant"
    )
    caption = (
        f"The worst of the tests that were run{within}: Δρ = {pair.delta:+.3g} {pair.unit}. The "
        "requirement forbids the red area. Bars below are the contributions of the samples at that time to Δρ, and "
        "their sum is Δρ (red: the real machine is worse)."
    ).replace("  ", " ")
    if any("−" in panel.label for panel in panels):
        caption += " Where the two traces lie close together, their difference is drawn."
    if pair.ended:
        caption += (
            f" {pair.ended:+.3g} {pair.unit} is not in the samples: {pair.reason or 'the end of a trace'}."
        )
    height = 1.9 + 1.4 * len(panels)
    return pictured("When and where in the trace", caption, alt, name, height, paint)


def _panels(where: Where, spec: Spec) -> list[Panel]:
    """Return one panel for each of the channels that contribute most."""
    pair = where.pair
    real, simulated = label_components(pair.real), label_components(pair.simulated)
    # A channel that is equal in both rollouts comes last: it contributes nothing to Δρ.
    size = {name: float(np.abs(values).sum()) for name, values in pair.credit.items()}
    chosen = sorted(size, key=lambda name: -size[name])[:_MOST_PANELS]
    chosen = [name for name in chosen if size[name] > 0] or chosen[:1]
    trace = _trace(pair, spec)
    panels = []
    for label in chosen:
        component, name, around = Component.of_label(label), label, None
        own, other = real[label].astype(float), simulated[label].astype(float)
        difference = float(np.abs(own - other).max())
        if 0 < difference < VISIBLE * float(np.ptp(own)):
            name, around, own, other = f"{label} − simulated", other, own - other, np.zeros(other.size)
        allowed: tuple[Margins, ...] = ()
        if trace is not None:
            with suppress(S2RError):  # a predicate that has no value there: the picture is drawn without it
                allowed = limits(spec, pair.requirement, trace, where.test, component, around, difference)
        axis = with_unit(name, spec.signals[component.channel].unit)
        panels.append(Panel(axis, pair.times, own, (), ((pair.times, other),), allowed))
    return panels


def _trace(pair: Attribution, spec: Spec) -> Trace | None:
    """Return the real rollout in the spec's units, up to the end of the shorter trace."""
    channels = {
        name: (rows[0] if len(rows) == 1 else rows.T).astype(float) for name, rows in pair.real.items()
    }
    try:
        return Trace(pair.times, channels, {name: spec.signals[name].unit for name in channels})
    except S2RError:
        return None
