"""The real car of the set: other code and other laws than the simulator's, as someone outside wrote them.

Runge-Kutta at 2 ms, tyres that saturate and take a way to build their force up, a rack of second order, noise with
heavy tails and a colour, wind and grip of the day. Shared with the simulator are what the machine is asked to do and
the controller, which are the system under test; both are written anew here, for nothing is imported from the simulator.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.outsiders.cases import Cause, linear
from s2r_spec.trace import Trace

VERSION = "car/1"
"""Of this generator; it goes into every label."""
SPEC = Path(__file__).parent / "car.stl"
TICK, STEPS, N = 0.02, 10, 301
"""Period of the control and of the log [s], steps of the physics in it, samples in a log."""
H = TICK / STEPS
UNITS = {
    "y_ref": "m", "v_ref": "m/s", "y": "m", "y_m": "m", "psi_m": "rad", "v_m": "m/s", "r_m": "rad/s",
    "ay_m": "m/s^2", "steer_cmd": "rad", "steer_m": "rad", "force_cmd": "N",
}  # fmt: skip

KNOWN = (
    linear("front_grip", "factor", 0.2, nominal=1.0, signed=True),
    linear("rear_grip", "factor", 0.2, nominal=1.0, signed=True),
    linear("mass", "extra", 200.0, signed=True),
    linear("steer_delay", "time", 0.06),
    linear("steer_lag", "time", 0.06),
    linear("steer_offset", "angle", 0.01, signed=True),
    linear("drag", "coefficient", 0.6),
    linear("drive_strength", "factor", 0.2, nominal=1.0, signed=True),
    linear("yaw_bias", "rate", 0.02, signed=True),
    linear("position_bias", "distance", 0.16, signed=True),
    linear("side_wind", "force", 500.0, signed=True),
)
UNKNOWN = (
    linear("gust", "force", 4000.0),
    linear("steering_play", "angle", 0.008),
    Cause("steering_rate", "limit", lambda size: 0.12 / size, nominal=float("inf")),
    linear("ice", "part", 0.35),
)
"""A gust for half a second, play in the rack, a rack that is slow [rad/s], grip that is lost for a second."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Nuisance:
    """What differs from run to run.

    Attributes:
        wind: from the side [N].
        grip: (2,) factors of the front and the rear tyres.
        start: (3,) lateral position [m], heading [rad] and speed [m/s] beside what is asked for.
        noise: (samples, 7) of what is measured.
    """

    wind: float
    grip: Array
    start: Array
    noise: Array


def drawn_nuisance(rng: Generator) -> Nuisance:
    """Draw what is not the same in any two runs."""
    wind, grip = 25.0 * rng.normal(), 1.0 + 0.01 * rng.normal(size=2)
    white = rng.standard_t(6, size=(N, 7)) / 1.22
    noise = np.zeros((N, 7))
    for k in range(N):
        noise[k] = 0.4 * noise[k - 1] + np.sqrt(1 - 0.16) * white[k]
    noise *= (0.022, 0.0028, 0.06, 0.0055, 0.13, 0.002, 0.0011)
    return Nuisance(wind, grip, rng.normal(size=3) * (0.025, 0.003, 0.12), noise)


def drive(values: Mapping[str, float], test: Mapping[str, float], nuisance: Nuisance) -> Trace:
    """Run one test on a car with these effects, known and unknown by name; what is not named is as it should be."""
    return conduct(lane_change(test["speed"], test["offset"]), values, nuisance, 1.0)


def conduct(commanded: Array, values: Mapping[str, float], nuisance: Nuisance, gain: float) -> Trace:
    """Drive a command, (samples, 7) as :func:`lane_change` returns it, with a factor on lane keeping."""
    v = {cause.name: cause.nominal for cause in (*KNOWN, *UNKNOWN)} | values
    p = np.array([v[cause.name] for cause in KNOWN])
    p[:2] *= nuisance.grip
    p[10] += nuisance.wind
    odd = np.array([v["gust"], v["steering_play"], v["steering_rate"], v["ice"]])
    rows, spun = ride(commanded, gain, p, nuisance.start, nuisance.noise, odd)
    channels = dict(zip(UNITS, rows.T, strict=True))
    return Trace(TICK * np.arange(len(rows)), channels, UNITS, {"failure": "spun"} if spun else {})


@njit(cache=True)
def reference(t: float, offset: float) -> tuple[float, float, float]:
    """Return lateral position, speed and acceleration asked for: out in 2 s, 0.6 s there, back in 2 s."""
    if 2.5 <= t <= 3.1:
        return offset, 0.0, 0.0
    if 0.5 < t < 2.5:
        sign, s = 1.0, (t - 0.5) / 2.0
    elif 3.1 < t < 5.1:
        sign, s = -1.0, (t - 3.1) / 2.0
    else:
        return 0.0, 0.0, 0.0
    y = s**3 * (10 - 15 * s + 6 * s * s)
    there = y if sign > 0 else 1.0 - y
    return (
        offset * there,
        offset * sign * 30 * s * s * (1 - s) ** 2 / 2.0,
        offset * sign * 60 * s * (1 - s) * (1 - 2 * s) / 4.0,
    )


@njit(cache=True)
def lane_change(speed, offset):
    """Return (samples, 7): y and two derivatives, speed, steering added, whether the force is given, the force."""
    commanded = np.zeros((N, 7))
    for k in range(N):
        commanded[k, 0], commanded[k, 1], commanded[k, 2] = reference(k * TICK, offset)
        commanded[k, 3] = speed + min(max(k * TICK - 1.0, 0.0), 2.0)
    return commanded


@njit(cache=True)
def controller(commanded, gain, y_m, psi_m, v_m, r_m, integral):
    """Return steering angle, drive force, the integral of the speed's error, and what is asked for."""
    y_ref, yd, ydd, v_ref, plus, given, made = commanded
    v = max(v_m, 5.0)
    ay = ydd + 4.0 * gain * (y_ref - y_m) + 3.0 * np.sqrt(gain) * (yd - v * psi_m)
    steer = (2.7 / v**2 + 0.0024) * ay + 0.15 * (ydd / v - r_m) + plus
    steer = min(max(steer, -0.35), 0.35)
    force = made
    if not given:
        error = v_ref - v_m
        integral += TICK * error
        force = min(max(3000.0 * error + 1500.0 * integral, -6000.0), 4000.0)
    return steer, force, integral, y_ref, v_ref


@njit(cache=True)
def tyre(stiffness, slip, load):
    """Return the side force of an axle [N], which its load limits."""
    peak = 1.3 * load
    return peak * np.tanh(stiffness * slip / peak)


@njit(cache=True)
def rates(x, arrived, force, p, push, grip):
    """Return the rates of ``x`` (y, psi, vx, vy, r, rack, its speed, two slips), side acceleration, and wheel."""
    d = np.zeros(9)
    m, iz = 1500.0 + p[2], 2560.0 + 0.4 * p[2]
    vx, vy, r = x[2], x[3], x[4]
    if p[4] > 0.003:  # of second order, critically damped
        w = 2.0 / p[4]
        d[5] = x[6]
        d[6] = w * w * (arrived - x[5]) - 2 * w * x[6]
        wheel = x[5]
    else:
        wheel = arrived
    bent = wheel + p[5]
    d[7] = vx / 0.06 * (bent - np.arctan((vy + 1.2 * r) / vx) - x[7])
    d[8] = vx / 0.06 * (-np.arctan((vy - 1.5 * r) / vx) - x[8])
    ff = grip * tyre(90e3 * p[0], x[7], m * 9.81 * 1.5 / 2.7)
    fr = grip * tyre(110e3 * p[1], x[8], m * 9.81 * 1.2 / 2.7)
    wind = p[10] + push
    d[0] = vx * np.sin(x[1]) + vy * np.cos(x[1])
    d[1] = r
    d[2] = (p[7] * force - (0.4 + p[6]) * vx * vx - 160.0 - ff * np.sin(bent)) / m + vy * r
    d[3] = (ff * np.cos(bent) + fr + wind) / m - vx * r
    d[4] = (1.2 * ff * np.cos(bent) - 1.5 * fr + 0.1 * wind) / iz
    return d, (ff * np.cos(bent) + fr + wind) / m, wheel


@njit(cache=True)
def ride(commanded, gain, p, start, noise, odd):
    """Return (samples, 11) as logged, and whether it spun."""
    gust, play, rate, ice = odd
    ticks = noise.shape[0]
    x = np.zeros(9)
    x[0], x[1], x[2] = start[0], start[1], commanded[0, 3] + start[2]
    out = np.zeros((ticks, 11))
    sent = np.zeros(ticks * STEPS)
    late = int(np.rint(p[3] / H))
    integral, ay, wheel, rack = 0.0, 0.0, 0.0, 0.0
    for k in range(ticks):
        n = noise[k]
        y_m, psi_m, v_m, r_m = x[0] + p[9] + n[0], x[1] + n[1], x[2] + n[2], x[4] + p[8] + n[3]
        steer, force, integral, y_ref, v_ref = controller(commanded[k], gain, y_m, psi_m, v_m, r_m, integral)
        o = out[k]
        o[0], o[1], o[2], o[3], o[4], o[5], o[6] = y_ref, v_ref, x[0] + n[5], y_m, psi_m, v_m, r_m
        o[7], o[8], o[9], o[10] = ay + n[4], steer, wheel + n[6], force
        if abs(x[0]) > 15 or abs(x[3]) > 8:
            return out[: k + 1], True
        push = gust if 130 <= k < 155 else 0.0
        grip = 1.0 - ice if 165 <= k < 215 else 1.0
        for j in range(STEPS):
            i = k * STEPS + j
            sent[i] = steer
            arrived = sent[i - late] if i >= late else 0.0
            if play > 0:
                rack = min(max(rack, arrived - play), arrived + play)
                arrived = rack
            elif rate < 1e9:
                rack += min(max(arrived - rack, -rate * H), rate * H)
                arrived = rack
            a, ay, wheel = rates(x, arrived, force, p, push, grip)
            b, _, _ = rates(x + H / 2 * a, arrived, force, p, push, grip)
            c, _, _ = rates(x + H / 2 * b, arrived, force, p, push, grip)
            d, _, _ = rates(x + H * c, arrived, force, p, push, grip)
            x = x + H / 6 * (a + 2 * b + 2 * c + d)
    return out, False
