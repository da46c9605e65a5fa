"""Excitation protocols of the balancing robot: what its controller follows, and torques beside it."""

import numpy as np

from s2r_spec.backend import Parameter
from s2r_spec.protocols import Protocol

DT = 0.01
"""[s] period of the control, and of a protocol's samples."""
AMPLITUDE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "amplitude, as a share of the full one")
CARGO = Parameter("cargo", "kg", 0.0, 3.0, 1.0, "declared load, 0.4 m above the axle")
HELD = "Its body is held upright, and its wheels are on the floor."


def _protocol(name, words, duration, risk=""):
    return Protocol(name, words, "ground", duration, 2e-3, risk, (AMPLITUDE, CARGO))


PROTOCOLS = (
    _protocol(
        "chirp",
        "It balances. The reference acceleration is a cosine of 0.8 m/s^2. Its frequency rises evenly from 0.3 "
        "to 4 Hz in 6 s; its amplitude grows smoothly over the first 1 s. Speed and place are its sums over the "
        "periods.",
        6.0,
    ),
    _protocol(
        "torque_steps",
        "It balances. A torque is added to the motors' for 0.1 s, and then its opposite for 0.1 s. It is 0.5 N*m at "
        "1 s, 1 N*m at 2.5 s, 2 N*m at 4 s, and 3 N*m at 5.5 s.",
        7.0,
        "it leans",
    ),
    _protocol(
        "held_steps",
        f"{HELD} From 0.4 s on the motors make 0.2, -0.2, 0.5, -0.5, 1.5, -1.5, 4 and -4 N*m, for 0.4 s each, and "
        "then none.",
        4.0,
    ),
    _protocol("held_coast", f"{HELD} It rolls at 1 m/s, and its motors make no torque.", 5.0, "it rolls up to 5 m"),
)  # fmt: skip


def plan(name, amplitude):
    """Return (ticks, 4): reference acceleration, speed and place, and a torque; of a held robot, its whole torque."""
    duration = next(protocol.duration for protocol in PROTOCOLS if protocol.name == name)
    t = DT * np.arange(round(duration / DT) + 1)
    out = np.zeros((t.size, 4))
    if name == "chirp":
        s = np.minimum(t, 1.0)
        phase = 2 * np.pi * (0.3 * t + 3.7 * t * t / 12.0)
        out[:, 0] = 0.8 * amplitude * s * s * (3 - 2 * s) * np.cos(phase)
        out[:, 1] = np.cumsum(out[:, 0]) * DT
        out[:, 2] = np.cumsum(out[:, 1]) * DT
    elif name == "torque_steps":
        for begin, size in ((1.0, 0.5), (2.5, 1.0), (4.0, 2.0), (5.5, 3.0)):
            since = t - begin + 1e-9
            shape = np.where(since < 0.1, 1.0, -1.0) * ((since >= 0.0) & (since < 0.2))
            out[:, 3] += size * amplitude * shape
    elif name == "held_steps":
        torques = np.array([0.0, 0.2, -0.2, 0.5, -0.5, 1.5, -1.5, 4.0, -4.0, 0.0])
        number = np.clip(np.floor(t / 0.4 + 1e-9), 0, 9).astype(int)
        out[:, 3] = amplitude * torques[number]
    return out
