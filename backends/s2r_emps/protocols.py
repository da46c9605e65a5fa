"""Excitation protocols of the axis, and their references: a pure function of name and amplitude.

The axis's own controller follows them. Every reference begins at rest.
"""

from __future__ import annotations

from math import log, pi

import numpy as np
from numpy.typing import NDArray

from s2r_emps.noise import FloatArray
from s2r_emps.physics import MIDDLE, RATE
from s2r_spec.backend import Parameter
from s2r_spec.protocols import Protocol

AMPLITUDE = Parameter("amplitude", "", 0.25, 1.0, 1.0, "amplitude, as a share of the full one")
GAIN = Parameter(
    "gain", "", 0.5, 1.5, 1.0, "factor on the stiffness of the controller; damping follows its square root"
)
PAYLOAD = Parameter("payload", "kg", 5.0, 60.0, 30.0, "known mass clamped to the carriage")

_COST = 0.00025
"""[s] time of one core per simulated second, measured on a 2-core cloud machine."""
_SWEEP = (
    "The carriage follows a sine about the middle of the axis. In 6 s its frequency f grows from 0.5 to 50 Hz, "
    "by the same factor every second. Its amplitude is 30 mm / (1 + (f / 1.1 Hz)^2), and grows smoothly over "
    "the first 0.5 s."
)


def _protocol(name: str, words: str, duration: float, *more: Parameter, risk: str = "") -> Protocol:
    return Protocol(name, words, "ground", duration, _COST * duration, risk, (AMPLITUDE, GAIN, *more))


PROTOCOLS = (
    _protocol(
        "coast_down",
        "From rest at 0.03 m the carriage speeds up after 0.1 s, with half a cosine of 0.1 s to 0.2 m/s. After "
        "0.1 s at that speed the drive is off for 0.7 s.",
        1.0,
        risk="without friction the carriage still moves at the end, 0.05 m before its end stop",
    ),
    _protocol("chirp", _SWEEP, 6.0),
    _protocol(
        "steps",
        "From 0.1 s on, the reference jumps every 0.25 s: 0.1 mm forwards and back, then 0.3 mm, then 1 mm.",
        1.6,
    ),
    _protocol("loaded", f"A known mass is clamped to the carriage. {_SWEEP}", 6.0, PAYLOAD),
)
"""Every protocol, in the order of a campaign."""


def reference(name: str, amplitude: float = 1.0) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (ticks,) reference positions [m], and (ticks,) whether the drive is on."""
    duration = next(protocol.duration for protocol in PROTOCOLS if protocol.name == name)
    times = np.arange(round(duration * RATE) + 1) / RATE
    on = np.ones(times.size, dtype=np.bool_)
    if name == "coast_down":
        on[times > 0.3 - 1e-9] = False
        ramp = np.clip(times - 0.1, 0.0, 0.1)
        travel = (ramp - 0.1 / pi * np.sin(pi * ramp / 0.1)) / 2 + np.maximum(times - 0.2, 0.0)
        return 0.03 + 0.2 * amplitude * travel, on
    if name == "steps":
        sizes = np.array([0.0, 1e-4, 0.0, 3e-4, 0.0, 1e-3, 0.0])
        number = np.clip(np.floor((times - 0.1) / 0.25 + 1e-9) + 1, 0, 6).astype(np.intp)
        return MIDDLE + amplitude * sizes[number], on
    return MIDDLE + amplitude * _sweep(times), on


def _sweep(times: FloatArray) -> FloatArray:
    """Return (n,) position [m] of the sweep from 0.5 to 50 Hz in 6 s."""
    rate = log(100.0) / 6.0
    frequency = 0.5 * np.exp(rate * times)
    share = np.minimum(times / 0.5, 1.0)
    grown = share * share * (3.0 - 2.0 * share)
    return np.asarray(
        grown * 0.03 / (1.0 + (frequency / 1.1) ** 2) * np.sin(2 * pi / rate * (frequency - 0.5))
    )
