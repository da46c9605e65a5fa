"""Can a cause be seen at all in a machine's logs? By its generator, which can run the machine without it.

Data: y[c, r], for each feature, of R runs at each of C commands, of the machine with the cause and of the same machine
without it, with other noise and other starts. Features are mean and standard deviation over time of each measured
column that the robot logs, and the number of samples.

Unknown: whether the cause changes any feature. Statistic of a feature: the difference between the machine with the
cause and that without, averaged over commands, by the scatter within commands and machines,

    F = (Σ_c ȳ_with[c] − ȳ_without[c])²  /  Σ_c Σ_r (y_with[c, r] − ȳ_with[c])² + (y_without[c, r] − ȳ_without[c])²

and of all features, the largest F. If the cause changes nothing, the 2R runs of a command are exchangeable, so every
choice of R of them at each command is as likely as the true one. Model: no other. p is the share of these choices whose
largest F is at least that of the true one. A cause is *visible* if p is below :data:`LEVEL`; the level holds for all
features together. Source: Westfall and Young, *Resampling-Based Multiple Testing* (1993), max T.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from benchmarks.robots.go1 import Array
from s2r_spec.trace import Trace

LEVEL = 0.01
"""Level: probability that a cause without any trace in the logs is called visible."""


def features(log: Trace) -> Array:
    """Return (F,) features of a log."""
    measured = [name for name in sorted(log.channels) if not name.endswith("_cmd")]
    columns = np.column_stack([np.asarray(log[name]) for name in measured])
    return np.concatenate([columns.mean(axis=0), columns.std(axis=0), [len(columns)]])


def chance(present: Sequence[Sequence[Trace]], absent: Sequence[Sequence[Trace]]) -> float:
    """Return p of no change.

    Args:
        present: (C, R) logs of the machine with the cause.
        absent: (C, R) logs of the same machine without it, at the same commands.
    """
    each = [[[features(log) for log in runs] for runs in logs] for logs in (present, absent)]
    return exchanged(np.concatenate(each, axis=1))


def exchanged(y: Array) -> float:
    """Return p of (C, 2R, F) features, of which the first R runs of each command have the cause."""
    _, runs, count = y.shape
    difference, within = np.zeros((1, count)), np.zeros((1, count))
    for own in y:  # the true choice comes first
        parts = [
            (own[[*some]], np.delete(own, some, axis=0)) for some in combinations(range(runs), runs // 2)
        ]
        means = np.array([one.mean(axis=0) - other.mean(axis=0) for one, other in parts])
        sums = np.array([_within(one) + _within(other) for one, other in parts])
        difference = (difference[:, None] + means).reshape(-1, count)
        within = (within[:, None] + sums).reshape(-1, count)
    with np.errstate(divide="ignore", invalid="ignore"):
        largest = np.where(difference != 0.0, difference**2 / within, 0.0).max(axis=1)
    return float(np.mean(largest >= largest[0] * (1.0 - 1e-9)))


def _within(y: Array) -> Array:
    """Return (F,) sums of squares about the mean of (R, F) features."""
    return np.asarray(((y - y.mean(axis=0)) ** 2).sum(axis=0))
