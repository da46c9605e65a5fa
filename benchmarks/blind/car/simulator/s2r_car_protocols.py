"""Excitation protocols of the car: what is added to its steering, and the drive force without its speed loop."""

import numpy as np

from s2r_spec.backend import Parameter
from s2r_spec.protocols import Protocol

TICK = 0.02
"""[s] period of the control, and of a protocol's samples."""
AMPLITUDE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "amplitude, as a share of the full one")
GAIN = Parameter(
    "gain", "", 0.5, 1.5, 1.0, "factor on the stiffness of lane keeping; damping follows its square root"
)
SPEED = Parameter("speed", "m/s", 12.0, 25.0, 22.0, "at the begin")
LANE = "It keeps its lane at {}."


def _protocol(name, words, *parameters):
    return Protocol(name, words, "space", 6.0, 1e-3, "", parameters)


PROTOCOLS = (
    _protocol(
        "steer_chirp",
        f"{LANE.format('18 m/s')} From 0.5 s to the end a sine of 0.04 rad is added to the steering. Its frequency "
        "rises evenly from 0.3 to 6 Hz; its amplitude grows smoothly over the first 0.5 s.",
        AMPLITUDE,
        GAIN,
    ),
    _protocol(
        "steer_reversal",
        f"{LANE.format('18 m/s')} From 0.5 s on a triangle of 0.04 rad and 1 s is added to the steering, to the "
        "left first.",
        AMPLITUDE,
        GAIN,
    ),
    _protocol("coast_down", f"{LANE.format('a speed')} From 0.5 s on the drive is off.", SPEED, GAIN),
    _protocol(
        "force_steps",
        f"{LANE.format('15 m/s')} From 0.5 s on the drive makes 3000 N, from 2 s -3000 N, from 3.5 s 1500 N, and "
        "from 5 s -1500 N.",
        AMPLITUDE,
        GAIN,
    ),
)  # fmt: skip


def plan(name, amplitude=1.0, speed=SPEED.default):
    """Return (ticks, 7): place, its speed and acceleration, speed, added steering, whether force is given, force."""
    t = TICK * np.arange(301)
    out = np.zeros((t.size, 7))
    out[:, 3] = {"coast_down": speed, "force_steps": 15.0}.get(name, 18.0)
    since = np.maximum(t - 0.5, 0.0)
    if name == "steer_chirp":
        s = np.minimum(since / 0.5, 1.0)
        phase = 2 * np.pi * (0.3 * since + 5.7 * since**2 / 11.0)
        out[:, 4] = 0.04 * amplitude * s * s * (3 - 2 * s) * np.sin(phase)
    elif name == "steer_reversal":
        part = (since + 0.25) % 1.0  # 0.25 is the triangle's zero on the way up
        out[:, 4] = 0.04 * amplitude * (1.0 - 4.0 * np.abs(part - 0.5))
    else:
        out[:, 5] = t > 0.5 - 1e-9
    if name == "force_steps":
        steps = np.array([0.0, 3000.0, -3000.0, 1500.0, -1500.0])
        out[:, 6] = amplitude * steps[np.searchsorted([0.5, 2.0, 3.5, 5.0], t + 1e-9, side="right")]
    return out
