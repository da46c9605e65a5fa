"""Columns of one unit that stand under each other's name: undone by the assignment that is nearest to the simulator."""

from __future__ import annotations

import numpy as np

from s2r_spec.diagnose.quality.comparison import Comparison
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.suspects import Suspect, listed


def exchanged(c: Comparison) -> list[Suspect]:
    """Return the assignment of recorded to simulated columns, if it is not the identity."""
    from scipy.optimize import linear_sum_assignment

    order = np.arange(len(c.columns))
    for unit in {column.unit for column in c.columns}:
        mine = np.array([k for k, column in enumerate(c.columns) if column.unit == unit])
        apart = c.recorded[..., mine, None] - c.nominal[..., None, mine]
        costs = ((apart / c.floor[mine]) ** 2).mean(axis=(0, 1))
        rows, names = linear_sum_assignment(costs)
        order[mine[names]] = mine[rows]
    moved = [k for k in range(len(order)) if order[k] != k]
    if not moved:
        return []
    words = listed([c.columns[k].name for k in moved])
    under = ", ".join(f"{c.columns[k].name} is named {c.columns[order[k]].name}" for k in moved[:4])
    text = f"{words} of the real rollouts seem exchanged: {under}. If so, correct the names in the recordings"
    return [Suspect(Finding("exchanged", words, text, "an exchange of channels"), c.recorded[..., order])]
