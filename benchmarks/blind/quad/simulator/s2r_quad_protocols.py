"""Excitation protocols of the quadrotor: references of its loops, and thrusts added to the rotors' commands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Parameter
from s2r_spec.protocols import Protocol

Array = NDArray[np.float64]

TC = 0.005
"""[s] period of the control, and of a protocol's samples."""
AMPLITUDE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "amplitude, as a share of the full one")
GAIN = Parameter(
    "gain", "", 0.5, 1.5, 1.0, "factor on the stiffness of the pitch loop; damping follows its square root"
)

HOVERS = "It hovers at {} m."
SWEEP = (
    "Its frequency rises evenly from {} to {} Hz in 4 s; its amplitude grows smoothly over the first 0.5 s."
)


def _protocol(name: str, words: str, duration: float, risk: str = "") -> Protocol:
    return Protocol(name, words, "space", duration, 1.5e-3, risk, (AMPLITUDE, GAIN))


PROTOCOLS = (
    _protocol(
        "pitch_chirp",
        f"{HOVERS.format(1)} From 1 s on the rear rotor gets a sine of 1 N more, and the front rotor its opposite. "
        + SWEEP.format(2, 25),
        5.0,
    ),
    _protocol(
        "heave_chirp",
        f"{HOVERS.format(1)} From 0.5 s to 2 s it goes down to 0.35 m as a minimum-jerk step. From 2 s on both "
        f"rotors get a sine of 1 N more. {SWEEP.format(1, 10)}",
        6.0,
        "it flies near the ground",
    ),
    _protocol(
        "rotor_steps",
        f"{HOVERS.format(1)} One rotor gets 3 N more for 0.1 s and then 3 N less for 0.1 s. The front one does so at "
        "1, 2, 3 and 4 s, the rear one at 1.5, 2.5, 3.5 and 4.5 s.",
        5.0,
    ),
    _protocol(
        "coast",
        f"{HOVERS.format(1)} From 0.5 s to 2 s its speed rises to 3 m/s as a minimum-jerk step. Then it holds its "
        "height and a pitch of 0, without position control.",
        3.0,
        "it flies without position control for 1 s",
    ),
)  # fmt: skip


def plan(name: str, amplitude: float) -> Array:
    """Return (ticks, 9): reference position, speed and acceleration, along x and along z; level; added thrusts.

    Where ``level`` is 1 the position loop is off and the reference pitch is 0. The added thrusts [N] are the front
    rotor's and the rear one's.
    """
    duration = next(protocol.duration for protocol in PROTOCOLS if protocol.name == name)
    t = TC * np.arange(round(duration / TC) + 1)
    out = np.zeros((t.size, 9))
    out[:, 3] = 1.0
    if name == "pitch_chirp":
        out[:, 8] = amplitude * _sweep(np.maximum(t - 1.0, 0.0), 2.0, 25.0)
        out[:, 7] = -out[:, 8]
    elif name == "heave_chirp":
        s = np.clip((t - 0.5) / 1.5, 0.0, 1.0)
        out[:, 3] -= 0.65 * s**3 * (10 - 15 * s + 6 * s * s)
        out[:, 4] = -0.65 / 1.5 * 30 * s * s * (1 - s) ** 2
        out[:, 5] = -0.65 / 2.25 * 60 * s * (1 - s) * (1 - 2 * s)
        out[:, 7] = out[:, 8] = amplitude * _sweep(np.maximum(t - 2.0, 0.0), 1.0, 10.0)
    elif name == "rotor_steps":
        number = np.floor(2 * t + 1e-9)
        into = t - 0.5 * number
        size = np.where(into < 0.1 - 1e-9, 3.0, np.where(into < 0.2 - 1e-9, -3.0, 0.0)) * amplitude
        size = np.where((number >= 2) & (number <= 9), size, 0.0)
        out[:, 7] = np.where(number % 2 == 0, size, 0.0)
        out[:, 8] = np.where(number % 2 == 1, size, 0.0)
    else:
        s, top = np.clip((t - 0.5) / 1.5, 0.0, 1.0), 3.0 * amplitude
        out[:, 0] = top * (1.5 * (2.5 * s**4 - 3 * s**5 + s**6) + np.maximum(t - 2.0, 0.0))
        out[:, 1] = top * s**3 * (10 - 15 * s + 6 * s * s)
        out[:, 2] = top / 1.5 * 30 * s * s * (1 - s) ** 2
        out[:, 6] = t > 2.0 - 1e-9
    return out


def _sweep(t: Array, low: float, high: float) -> Array:
    s = np.minimum(t / 0.5, 1.0)
    return s * s * (3 - 2 * s) * np.sin(2 * np.pi * (low * t + (high - low) * t * t / 8.0))
