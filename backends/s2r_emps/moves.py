"""The built-in test: a move out, a pause, and a move back, with smooth ramps of speed."""

from __future__ import annotations

from collections.abc import Mapping
from math import copysign, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_emps.noise import FloatArray
from s2r_emps.physics import MIDDLE, STEP
from s2r_spec import backend
from s2r_spec.backend import Parameter

PARAMETERS = (
    Parameter(
        "stroke", "m", -0.2, 0.2, 0.15, "stroke of the move, centred on the axis; negative: backwards first"
    ),
    Parameter("speed", "m/s", 0.01, 0.3, 0.2, "largest speed, if the move is long enough to reach it"),
    Parameter("accel", "m/s^2", 0.2, 3.0, 1.5, "largest acceleration of the reference"),
    Parameter("payload", "kg", 0.0, 60.0, 0.0, "mass clamped to the carriage"),
    Parameter("pause", "s", 0.0, 2.0, 0.3, "rest at the far end"),
    Parameter("coast", "s", 0.0, 0.3, 0.0, "time with the drive off, half-way out"),
)

WAIT = 0.1
"""Rest before the move [s]."""


class Test(NamedTuple):
    """One point of the test space; fields as in ``PARAMETERS``."""

    stroke: float
    speed: float
    accel: float
    payload: float
    pause: float
    coast: float


def read_test(params: Mapping[str, float], known: tuple[Parameter, ...] = PARAMETERS) -> dict[str, float]:
    """Return the value of every parameter; a missing one takes its default.

    Raises:
        UsageError: a name is unknown or a value is out of range.
    """
    return backend.read_test("emps", known, params)


def move(test: Test, ticks: int) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (ticks,) reference positions [m], and (ticks,) whether the drive is on."""
    times = STEP * np.arange(ticks, dtype=np.float64) - WAIT
    way = abs(test.stroke)
    speed = min(test.speed, sqrt(2 * test.accel * way / pi))
    length = one_way(way, speed, test.accel)
    out = _travel(times, way, speed, test.accel)
    back = _travel(times - length - test.pause, way, speed, test.accel)
    half = times - length / 2
    on = ~((half >= 0) & (half < test.coast - 1e-9))
    return MIDDLE + copysign(1.0, test.stroke) * (out - back - way / 2), on


def one_way(way: float, speed: float, accel: float) -> float:
    """Return the duration [s] of a move over ``way`` [m]; 0 for no move."""
    return way / speed + pi * speed / (2 * accel) if way else 0.0


def _travel(times: FloatArray, way: float, speed: float, accel: float) -> FloatArray:
    """Return (n,) travel [m]; the speed rises and falls as half a cosine, whose steepest slope is ``accel``."""
    if not way:
        return np.zeros_like(times)
    ramp = pi * speed / (2 * accel)
    length = one_way(way, speed, accel)

    def ramped(t: FloatArray) -> FloatArray:
        t = np.clip(t, 0.0, ramp)
        return speed * (t - ramp / pi * np.sin(pi * t / ramp)) / 2

    cruise = np.clip(times - ramp, 0.0, length - 2 * ramp)
    rest = np.clip(times - (length - ramp), 0.0, ramp)
    return ramped(times) + speed * cruise + (speed * rest - ramped(rest))
