"""Excitation protocols of the arm: angles that its own controller follows, and when its drives are on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Parameter
from s2r_spec.protocols import Protocol

Array = NDArray[np.float64]

TS = 0.002
"""[s] period of the control, and of a protocol's samples."""
AMPLITUDE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "amplitude, as a share of the full one")
GAIN = Parameter(
    "gain", "", 0.5, 1.5, 1.0, "factor on the joints' stiffness; damping follows its square root"
)
PAYLOAD = Parameter("payload", "kg", 0.0, 2.5, 1.5, "declared mass at the flange")
CHIRP = (
    "From (-0.6, 0.8) rad the {} follows a sine for 5 s and the other joint rests. Its frequency f grows from "
    "0.5 to 12 Hz, by the same factor every second. Its amplitude is {} rad / (1 + (f / 1.5 Hz)^2), and grows "
    "smoothly over the first 0.5 s."
)  # fmt: skip


def _protocol(name: str, words: str, duration: float, risk: str = "") -> Protocol:
    return Protocol(name, words, "space", duration, 1e-3, risk, (AMPLITUDE, GAIN, PAYLOAD))


PROTOCOLS = (
    _protocol("shoulder_chirp", CHIRP.format("shoulder", 0.25), 5.0),
    _protocol("elbow_chirp", CHIRP.format("elbow", 0.3), 5.0),
    _protocol(
        "steps",
        "At (-0.6, 0.8) rad the shoulder jumps by 0.1 rad at 0.3 s and back at 0.8 s. The elbow jumps by 0.1 rad at "
        "1.3 s and back at 1.8 s, both by 0.25 rad at 2.3 s and back at 2.8 s. The reference speed is 0.",
        3.3,
        "the drives reach their limits",
    ),
    _protocol(
        "sweep",
        "After 0.25 s both joints go from (-1.4, 1.2) to (0.4, -0.4) rad in 2.5 s, as a minimum-jerk step. They rest "
        "for 0.5 s and come back in 2.5 s. An amplitude below 1 is about the middle of the way.",
        6.0,
    ),
    _protocol(
        "coast",
        "The arm is held 0.3 rad from where it hangs, (-pi/2, 0), and its elbow 0.2 rad. After 0.5 s the drives "
        "are off.",
        4.0,
        "the arm swings freely",
    ),
)  # fmt: skip


def plan(name: str, amplitude: float) -> tuple[Array, Array]:
    """Return (ticks, 6) reference angles, speeds and accelerations, and (ticks,) 1 where the drives are on, else 0."""
    duration = next(protocol.duration for protocol in PROTOCOLS if protocol.name == name)
    t = TS * np.arange(round(duration / TS) + 1)
    on, still = np.ones(t.size), np.ones(t.size)
    if name == "steps":
        shoulder = 0.1 * _within(t, 0.3, 0.8) + 0.25 * _within(t, 2.3, 2.8)
        elbow = 0.1 * _within(t, 1.3, 1.8) + 0.25 * _within(t, 2.3, 2.8)
        angles = np.column_stack([-0.6 + amplitude * shoulder, 0.8 + amplitude * elbow])
        return np.column_stack([angles, np.zeros((t.size, 4))]), on
    if name == "coast":
        on = (t < 0.5 - 1e-9).astype(float)
        angles = np.column_stack([-np.pi / 2 + 0.3 * amplitude * on, 0.2 * amplitude * on])
        return np.column_stack([angles, np.zeros((t.size, 4))]), on
    if name == "sweep":
        way = _smooth((t - 0.25) / 2.5) - _smooth((t - 3.25) / 2.5) - 0.5
        angles = np.column_stack([-0.5 + 1.8 * amplitude * way, 0.4 - 1.6 * amplitude * way])
    else:
        rate = np.log(24.0) / 5.0
        f = 0.5 * np.exp(rate * t)
        s = np.minimum(t / 0.5, 1.0)
        wave = amplitude * s * s * (3 - 2 * s) / (1 + (f / 1.5) ** 2) * np.sin(2 * np.pi / rate * (f - 0.5))
        sizes = (0.25, 0.0) if name == "shoulder_chirp" else (0.0, 0.3)
        angles = np.column_stack([-0.6 * still + sizes[0] * wave, 0.8 * still + sizes[1] * wave])
    speeds = np.gradient(angles, TS, axis=0)
    return np.column_stack([angles, speeds, np.gradient(speeds, TS, axis=0)]), on


def _within(t: Array, begin: float, end: float) -> Array:
    return ((t > begin - 1e-9) & (t < end - 1e-9)).astype(float)


def _smooth(s: Array) -> Array:
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s * s)
