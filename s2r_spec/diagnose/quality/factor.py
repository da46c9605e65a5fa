"""A channel that is a factor of the simulator's: of another unit, in all rollouts or in one, or of the other sign."""

from __future__ import annotations

import numpy as np

from s2r_spec.backend import Channel
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import Recordings, called, correlation, rms

UNITS = {
    "1000 times": 1e3,
    "a thousandth of": 1e-3,
    "100 times": 1e2,
    "a hundredth of": 1e-2,
    "57 times": 180.0 / np.pi,
    "a 57th of": np.pi / 180.0,
}
"""Definition: factors by which a channel is off whose unit was forgotten: milli and kilo, centi, degrees."""
NEAR, FAR = 1.2, 1.6
"""Tolerance: a factor is one of these if it is this many times as much at most; the second where the channel goes as
the simulator's, for what a machine lacks moves its commands, too. Doubled, factors of physics are units."""
ALIKE = 0.8
"""Level: correlation from which on a channel goes as the simulator's. At twice the distance from 1, more factors are
units."""
OPPOSITE, LOUD = -0.9, 5.0
"""Level: correlation below which a channel of at most so many times the simulator's size has the other sign. At twice
the distance from −1, motion of another phase has it; a size twice as far takes another channel for it."""
OTHERWISE = 15.0
"""Tolerance: times that a channel is larger or smaller in one rollout than in most, from which on the simulator is
asked why. Twice as much misses factors of degrees."""


def opposite(channel: Channel, of: Recordings) -> Finding | None:
    """Find a channel that goes the other way."""
    name, times = channel.name, of.factors(channel.name)
    if not times.size or not 1.0 / LOUD < np.median(times) < LOUD:
        return None
    if max(correlation(pair, name) for pair in of.pairs) >= OPPOSITE:
        return None
    text = f"{name} of the real rollouts has the opposite sign of the simulator's. Do both use one sign convention?"
    return Finding("sign", name, text, "the opposite sign")


def unit(channel: Channel, of: Recordings) -> Finding | None:
    """Find a channel in another unit."""
    name, times = channel.name, of.factors(channel.name)
    # One that is next to nothing in either is no matter of units.
    if not times.size or not channel.unit or times.max() > NEAR**2 * times.min():
        return None
    alike = float(np.median([correlation(pair, name) for pair in of.pairs]))
    words = _times(float(np.median(times)), FAR if abs(alike) > ALIKE else NEAR)
    text = (
        f"{name} of the real rollouts is about {words} the simulator's. Is it in {channel.unit}? If not, write its "
        f"unit in the recording"
    )
    return Finding("unit", name, text, "another unit") if words else None


def unit_of_one(channel: Channel, of: Recordings) -> Finding | None:
    """Find the first rollout in which a channel is another size by one of the factors, and the simulator's is not."""
    name = channel.name
    sizes = np.array([rms(trace.channels.get(name, np.zeros(0))) for _, trace in of.rollouts])
    if not channel.unit or np.count_nonzero(sizes) <= len(sizes) / 2:
        return None
    times = sizes / np.median(sizes[sizes > 0.0])
    odd = np.flatnonzero((sizes > 0.0) & ((times > OTHERWISE) | (times < 1.0 / OTHERWISE)))
    if not len(odd):
        return None
    number = int(odd[0])
    test = of.rollouts[number][0]
    size = rms(of.simulated(test).channels.get(name, np.zeros(0)))
    words = _times(float(sizes[number]) / size, FAR) if size else ""
    text = (
        f"{name} of {called(number, test)} is about {words} the simulator's, and in no other rollout. Is it in "
        f"{channel.unit} there? If not, convert it, or leave the rollout out"
    )
    return Finding("unit of one", name, text) if words else None


def _times(much: float, reach: float) -> str:
    """Return which of the factors of a forgotten unit this is, to within ``reach`` times; "" for none."""
    words, factor = min(UNITS.items(), key=lambda item: abs(np.log(much / item[1])))
    return words if 1.0 / reach < much / factor < reach else ""
