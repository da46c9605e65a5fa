"""A command that no effect changes and that comes at another time: the recordings begin too early or too late."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import Pair, Recordings
from s2r_spec.errors import BackendError

SAME, BETTER = 0.999, 0.1
"""Level: a command is the simulator's at another time if it is correlated with it there by the first at least, and
what that leaves is the second part, at most, of what it leaves at the same time. Nearer to 1 and 0 they miss noise."""
ROUNDED = 1e-5
"""Tolerance: what a command leaves at the same time is rounding up to this. Twice as much misses slower commands."""
LATEST = 0.25
"""Definition: part of a rollout by which a command is looked for earlier and later."""


def begin(of: Recordings, lines: Sequence[Line]) -> list[Finding]:
    """Find the commands that come at another time in all pairs."""
    found = []
    for name in commands(of, lines):
        by = np.array([_later(pair, name) for pair in of.pairs])
        if not by.all() or np.ptp(by) > 0.2 * abs(by[0]):
            continue
        when = float(np.median(by))
        text = (
            f"{name} of the real rollouts is {abs(when):.3g} s {'later' if when > 0.0 else 'earlier'} than the "
            f"simulator's, and no effect changes it. Do the recordings begin {abs(when):.3g} s too "
            f"{'early' if when > 0.0 else 'late'}?"
        )
        found.append(Finding("begin", name, text, "a recording that begins at another time"))
    return found


def commands(of: Recordings, lines: Sequence[Line]) -> list[str]:
    """Return the channels of one number that are the same in the simulator, whatever is added to it and drawn."""
    much: dict[str, dict[str, float]] = {}
    for line in lines:
        half = line.value(0.5 if line.high > line.nominal else -0.5)
        much.setdefault(line.effect, {}).update(line.at(half)[line.effect])
    plain, (test, _) = of.pairs[0][0], next(one for one in of.rollouts if one[1].failure is None)
    try:
        other = of.bench.run(much, test, 1) if much else None
    except BackendError:
        other = None  # all of them at once, at half of what is typical, is more than anybody promised
    if other is None or (n := min(len(plain), len(other))) < 0.5 * len(plain):
        return []
    return [
        name
        for name, values in plain.channels.items()
        if values.ndim == 1 and name in other.channels and np.array_equal(values[:n], other[name][:n])
    ]


def _later(pair: Pair, name: str) -> float:
    """Return by how much a command comes later than the simulator's [s]; 0 where it does not, or is another."""
    simulated, real = pair
    values = real.channels.get(name, np.full(1, np.nan))
    if values.ndim != 1 or not np.isfinite(values).all():
        return 0.0
    times, own = simulated.times - simulated.times[0], real.times - real.times[0]
    step = float(np.median(np.diff(times)))

    def alike(lag: int) -> float:
        at = times + lag * step
        common = (at >= 0.0) & (at <= own[-1])
        here, there = simulated[name][common], np.interp(at[common], own, values)
        if common.sum() < 0.5 * len(times) or not (here.std() and there.std()):
            return -1.0
        return float(np.corrcoef(here, there)[0, 1])

    most = int(LATEST * len(times))
    left = 1.0 - alike(0)
    if left < ROUNDED or left == 2.0:
        return 0.0
    best = max(sorted(range(-most, most + 1), key=abs), key=alike)
    # Nobody reads two clocks better than to a step.
    sure = abs(best) > 1 and 1.0 - alike(best) <= min(1.0 - SAME, BETTER * left)
    return best * step if sure else 0.0
