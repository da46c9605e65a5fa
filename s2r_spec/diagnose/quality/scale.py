"""Channels of one unit that are too long by one factor, about their first sample or about zero."""

from __future__ import annotations

import numpy as np

from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.suspects import Group, Suspect, by_unit, mask, named, search, undo

FACTORS = [*np.geomspace(0.5, 0.98, 12).tolist(), *np.geomspace(1.02, 2.0, 12).tolist()]
"""Definition: factors that are tried before the best is refined; larger ones are of a forgotten unit."""


def scale(c: Comparison) -> list[Suspect]:
    """Return, for each unit, the factor and the channels that explain most."""

    def price(factor: float, group: Group) -> float:
        return max(2.0 * float(np.log(factor) * mask(c, group).mean()), 0.0)

    found = []
    for unit, among in by_unit(c).items():
        options = []
        for begin, about in ((c.read(stretch=0.0), "its first sample"), (np.zeros(1), "zero")):

            def undone(factor: float, begin: np.ndarray = begin) -> np.ndarray:
                return np.asarray(begin + (c.recorded - begin) / factor)

            factor, group, q = search(c, FACTORS, undone, among, price)
            options.append((q, factor, group, about, undo(c, undone(factor), group)))
        _, factor, group, about, values = min(options, key=lambda one: one[0])
        text = (
            f"{named(c, group)} of the real rollouts {'is' if len(group) == 1 else 'are'} "
            f"{100.0 * abs(factor - 1.0):.2g} % too {'large' if factor > 1.0 else 'small'}, measured from {about} and "
            f"judged by other channels. Check the scale{f', or the unit {unit},' if unit else ''} in the recordings"
        )
        said = Finding("scale", named(c, group), text, "a wrong scale")
        found.append(Suspect(said, values, volume=price(factor, group)))
    return found
