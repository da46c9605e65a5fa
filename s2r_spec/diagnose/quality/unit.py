"""A channel in another unit than the simulator's: in all rollouts, or in one of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_spec.backend import Channel
from s2r_spec.diagnose.quality.comparison import Rollout
from s2r_spec.diagnose.quality.pairs import Pair, called, correlation, factors, rms
from s2r_spec.diagnose.simulate import Bench, blamed

UNITS = {
    "1000 times": 1e3,
    "a thousandth of": 1e-3,
    "100 times": 1e2,
    "a hundredth of": 1e-2,
    "57 times": 180.0 / np.pi,
    "a 57th of": np.pi / 180.0,
}
"""Factors by which a channel is off whose unit was forgotten: milli and kilo, centi, degrees."""
NEAR = 1.2
"""A factor is one of these if it is this many times as much at most."""
FAR, ALIKE = 1.6, 0.8
"""Or, where a channel is correlated with the simulator's by the second at least, this many times: what a machine
lacks moves its commands, too."""
OTHERWISE = 15.0
"""Times that a channel is larger or smaller in one rollout than in most, from which on the simulator is asked why."""


def other_unit(channel: Channel, pairs: Sequence[Pair]) -> str:
    """Return what to say of a channel in another unit; "" for nothing."""
    name, times = channel.name, factors(channel.name, pairs)
    # One that is next to nothing in either is no matter of units.
    if not times or not channel.unit or max(times) > NEAR**2 * min(times):
        return ""
    alike = float(np.median([correlation(simulated, real, name) for simulated, real in pairs]))
    words = _times(float(np.median(times)), FAR if abs(alike) > ALIKE else NEAR)
    if not words:
        return ""
    return (
        f"{name} of the real rollouts is about {words} the simulator's. Is it in {channel.unit}? If not, write its "
        f"unit in the recording"
    )


def other_unit_of_one(bench: Bench, channel: Channel, rollouts: Sequence[Rollout]) -> str:
    """Say of the first rollout in which a channel is another size by one of the factors, and the simulator's is not."""
    name = channel.name
    sizes = np.array([rms(trace[name]) if name in trace.channels else 0.0 for _, trace in rollouts])
    if not channel.unit or np.count_nonzero(sizes) <= len(sizes) / 2:
        return ""
    times = sizes / np.median(sizes[sizes > 0.0])
    odd = np.flatnonzero((sizes > 0.0) & ((times > OTHERWISE) | (times < 1.0 / OTHERWISE)))
    if not len(odd):
        return ""
    number = int(odd[0])
    test, trace = rollouts[number]
    with blamed(bench, {}, test, 0):
        simulated = bench.run({}, test, 0)
    of_one = factors(name, [(simulated, trace)])
    words = _times(of_one[0], FAR) if of_one else ""
    if not words:
        return ""
    return (
        f"{name} of {called(number, test)} is about {words} the simulator's, and in no other rollout. Is it in "
        f"{channel.unit} there? If not, convert it, or leave the rollout out"
    )


def _times(much: float, reach: float) -> str:
    """Return which of the factors of a forgotten unit this is, to within ``reach`` times; "" for none."""
    words, factor = min(UNITS.items(), key=lambda item: abs(np.log(much / item[1])))
    return words if 1.0 / reach < much / factor < reach else ""
