"""A command that no effect changes and that comes at another time: the recordings begin too early or too late."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.quality.pairs import Pair
from s2r_spec.diagnose.simulate import Bench, blamed
from s2r_spec.errors import BackendError
from s2r_spec.trace import Trace

SAME, BETTER = 0.999, 0.1
"""A command is the simulator's at another time if it is correlated with it there by the first at least, and what that
leaves is the second part, at most, of what it leaves at the same time."""
ROUNDED, STEPS = 1e-5, 1.5
"""What it leaves at the same time is more than the first, which is rounding, and the other time further away than so
many steps of the simulator: nobody reads two clocks better."""
LATEST = 0.25
"""Part of a rollout by which it is looked for earlier and later."""


def other_begin(name: str, pairs: Sequence[Pair]) -> str:
    """Return what to say of a command that comes at another time; "" for nothing."""
    if not all(name in real.channels for _, real in pairs):
        return ""
    by = [seconds for pair in pairs if (seconds := _later(*pair, name)) is not None]
    if len(by) < len(pairs) or np.ptp(by) > 0.2 * abs(by[0]):
        return ""
    when = float(np.median(by))
    return (
        f"{name} of the real rollouts is {abs(when):.3g} s {'later' if when > 0.0 else 'earlier'} than the "
        f"simulator's, and no effect changes it. Do the recordings begin {abs(when):.3g} s too "
        f"{'early' if when > 0.0 else 'late'}?"
    )


def commands(bench: Bench, lines: Sequence[Line], test: Mapping[str, float], plain: Trace) -> list[str]:
    """Return the channels of one number that are as in ``plain``, whatever is added to the simulator and drawn."""
    much: dict[str, dict[str, float]] = {}
    for line in lines:
        half = line.value(0.5 if line.values[-1] > line.nominal else -0.5)
        much.setdefault(line.effect, {}).update(line.at(half)[line.effect])
    if not much:
        return []
    try:
        with blamed(bench, much, test, 1):
            other = bench.run(much, test, 1)
    except BackendError:
        return []  # all of them at once, at half of what is typical, is more than anybody promised
    n = min(len(plain), len(other))
    if n < 0.5 * len(plain):
        return []
    return [
        name
        for name, values in plain.channels.items()
        if values.ndim == 1 and name in other.channels and np.array_equal(values[:n], other[name][:n])
    ]


def _later(simulated: Trace, real: Trace, name: str) -> float | None:
    """Return by how much a command comes later than the simulator's [s]; None where it does not, or is another."""
    times, own = simulated.times - simulated.times[0], real.times - real.times[0]
    step, values = float(np.median(np.diff(times))), real[name]
    if values.ndim != 1 or not np.isfinite(values).all():
        return None

    def alike(lag: int) -> float:
        at = times + lag * step
        common = (at >= 0.0) & (at <= own[-1])
        here, there = simulated[name][common], np.interp(at[common], own, values)
        if common.sum() < 0.5 * len(times) or not (here.std() and there.std()):
            return -1.0
        return float(np.corrcoef(here, there)[0, 1])

    most = int(LATEST * len(times))
    at_once = alike(0)
    if 1.0 - at_once < ROUNDED or at_once == -1.0:
        return None
    lags = sorted(range(-most, most + 1), key=abs)
    best = max(lags, key=alike)
    there = alike(best)
    if abs(best) < STEPS or there < SAME or 1.0 - there > BETTER * (1.0 - at_once):
        return None
    return best * step
