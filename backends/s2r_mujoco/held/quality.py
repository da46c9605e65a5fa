"""What a log of joints is good for: its rate, its clock, how late its positions are, and which joints it excites.

How late: the shift of the logged velocities at which they fit best those of the nominal simulator under the same
targets, by the sum of the joints' cross-correlations. What is later than any delay of the catalogue is no physics of a
joint: the log joins two clocks, or a network held it up.

Units: s, rad, m.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.effects.catalogue import LARGEST
from s2r_mujoco.held.player import Player
from s2r_mujoco.held.residuals import SLOWEST
from s2r_spec.backend import LOG, Finding
from s2r_spec.errors import TraceError
from s2r_spec.trace import Trace
from s2r_spec.trace.samples import period_of

MISSING = 3.0
"""Definition: periods without a sample from which on samples are missing."""
UNEVEN = 0.2
"""Tolerance: standard deviation of the time between samples, as a part of the period."""
STILL = 0.01
"""Definition: a joint that moves by less shows no friction and no inertia [rad or m]."""
BETTER = 0.2
"""Level: part of the motion that a shift must explain beside none for a log to be late: a difference of squared
correlations."""
SETTLED = 0.3
"""Budget: time for which a simulator keeps the state of the log, from which it begins [s]."""
LATEST = 1.0
"""Budget: largest shift that is tried [s]."""


def log_findings(player: Player, trace: Trace) -> Iterator[Finding]:
    """Yield what is wrong with a log of joints, and what it cannot show."""
    period = period_of(trace.times)
    if not period * SLOWEST <= 1.0:
        words = (
            f"the log has {1.0 / period:.3g} samples a second, and accelerations of joints need {SLOWEST:g}"
        )
        yield Finding(LOG, words, "wrong", certain=True)
        return
    yield from _clock(trace, period)
    try:
        states = player.states(trace)
        late = lag(player, trace) if "target" in trace.channels else 0.0
    except TraceError as error:
        yield Finding(LOG, str(error), "note")
        return
    if "target" not in trace.channels:
        words = (
            "the log has no targets: its torques drive the joints, each until the next sample; where the motors hold "
            "positions, log 'target', else effects may be named that are none"
        )
        yield Finding(LOG, words, "note")
    most = LARGEST * player.robot.plan.step
    if late > most:
        behind, limit = (f"{1e3 * seconds:.0f} ms" for seconds in (late, most))
        words = f"the joints follow their targets {behind} late, and no delay of a motor is above {limit}"
        yield Finding(LOG, words, "wrong", certain=True)
    still = [
        name
        for joints, q, _ in states
        for name, moved in zip(joints.names, np.ptp(q, axis=0).tolist(), strict=True)
        if moved < STILL
    ]
    if still:
        yield Finding(
            LOG,
            f"these joints do not move, so their friction and inertia are hidden: {', '.join(still)}",
            "note",
        )


def _clock(trace: Trace, period: float) -> Iterator[Finding]:
    steps = np.diff(trace.times)
    if (longest := float(steps.max(initial=0.0))) > MISSING * period:
        yield Finding(
            LOG,
            f"the log has no sample for {1e3 * longest:.3g} ms, and its period is {1e3 * period:.3g} ms",
            "note",
        )
    elif steps.size and float(steps.std()) > UNEVEN * period:
        yield Finding(LOG, f"the time between samples scatters by {1e3 * float(steps.std()):.3g} ms", "note")


def lag(player: Player, trace: Trace) -> float:
    """Return how late the logged motion is after the nominal simulator's under the same targets [s]; 0 if not clearly.

    Raises:
        TraceError: the log has no targets, or no positions.
    """
    played = player.robot.trace(player.replay(trace, 0, (), ""), {})
    period, real, modelled = player.robot.plan.step, [], []
    times = np.minimum(played.times, trace.duration)
    for (_, q, _), (_, simulated, _) in zip(player.states(trace), player.states(played), strict=True):
        real += [_speed(np.interp(times, trace.times - trace.times[0], one)) for one in q.T]
        modelled += [_speed(one) for one in simulated.T]
    first = round(SETTLED / period)
    a, b = np.array(real)[:, first:], np.array(modelled)[:, first:]
    shifts = range(min(a.shape[1] // 2, round(LATEST / period)) + 1)
    correlation = np.array([_correlation(a, b, shift) for shift in shifts])
    best = int(correlation.argmax())
    explained = np.square(np.maximum(correlation, 0.0))
    return best * period if explained[best] > explained[0] + BETTER else 0.0


def _correlation(real: FloatArray, modelled: FloatArray, shift: int) -> float:
    """Return the correlation of (k, n) velocities with others that are this many samples earlier."""
    a, b = real[:, shift:], modelled[:, : modelled.shape[1] - shift]
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0.0 else 0.0


def _speed(values: FloatArray) -> FloatArray:
    return np.diff(values) - np.diff(values).mean()
