"""The real balancing robot of the set: other code and other laws than the simulator's, as someone outside wrote them.

Runge-Kutta at 0.5 ms, friction that rises near rest, a battery with a time constant of its own, a motor whose dead zone
is round, noise of other kinds and colours, a load beside its place. Shared with the simulator are what the machine is
asked to do and the controller with its gains, which are the system under test; both are written anew here, for nothing
is imported from the simulator.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are

from benchmarks.blind.outsiders.cases import linear
from s2r_spec.trace import Trace

VERSION = "segway/1"
"""Of this generator; it goes into every label."""
SPEC = Path(__file__).parent / "segway.stl"
TS, H, SUB, N = 0.01, 0.0005, 20, 801
"""Period of the control and of the log [s], step of the physics [s], steps in a period, samples in a log."""
UNITS = {
    "u": "N*m", "wheel_speed": "rad/s", "tilt_rate": "rad/s", "tilt_est": "rad", "speed": "m/s", "tilt": "rad",
    "acc": "m/s^2", "v_ref": "m/s", "x_err": "m",
}  # fmt: skip

KNOWN = (
    linear("rolling_friction", "force", 5.0),
    linear("viscous_friction", "coefficient", 7.0),
    linear("motor_strength", "factor", 0.2, nominal=1.0, signed=True),
    linear("battery_sag", "drop", 0.4),
    linear("latency", "delay", 0.012),
    linear("dead_zone", "torque", 0.3),
    linear("extra_mass", "mass", 2.0, signed=True),
    linear("com_height", "shift", 0.04, signed=True),
    linear("slope", "angle", 2.0, signed=True),
    linear("gyro_bias", "rate", 0.03, signed=True),
    linear("accelerometer_offset", "offset", 0.4, signed=True),
    linear("wheel_radius", "factor", 0.06, nominal=1.0, signed=True),
)
UNKNOWN = (
    linear("torque_ripple", "force", 6.0),
    linear("tether", "stiffness", 5.0),
    linear("square_drag", "coefficient", 8.0),
    linear("load_forward", "moment", 0.25),
)
"""A ripple with the wheels' turning, a tether that pulls from 1.2 m on, air, a load that sits ahead of the axle."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Nuisance:
    """What differs from run to run.

    Attributes:
        wobble: (7,) standard normal: cargo, wheels, two frictions, motors, battery, dead zone of the day.
        bias: (2,) of gyro [rad/s] and accelerometer [m/s²].
        jitter: (samples,) from −1 to 1, of the latency.
        tilt: at the begin [rad].
        noise: (samples, 5) of what is measured.
        sway: (samples,) of the floor [N].
    """

    wobble: Array
    bias: Array
    jitter: Array
    tilt: float
    noise: Array
    sway: Array


def drawn_nuisance(rng: Generator, ticks: int = N) -> Nuisance:
    """Draw what is not the same in any two runs."""
    noise = np.zeros((ticks, 5))
    noise[:, 0] = 0.007 * rng.standard_t(4, ticks)
    noise[:, 1] = 0.2 * rng.uniform(-1.5, 1.5, ticks)
    noise[:, 2] = 0.06 * rng.uniform(-1.7, 1.7, ticks)
    white, sway = rng.normal(size=(ticks, 3)), np.zeros(ticks)
    for i in range(1, ticks):
        noise[i, 3:] = 0.6 * noise[i - 1, 3:] + 0.8 * white[i, :2] * (0.009, 0.0018)
        sway[i] = 0.9 * sway[i - 1] + 0.3 * white[i, 2]
    return Nuisance(
        rng.normal(size=7),
        rng.normal(size=2) * (0.0005, 0.01),
        rng.uniform(-1, 1, ticks),
        0.012 * float(rng.normal()),
        noise,
        sway,
    )


def drive(values: Mapping[str, float], test: Mapping[str, float], nuisance: Nuisance) -> Trace:
    """Run one test on a robot with these effects, known and unknown by name; what is not named is as it should be."""
    commanded = np.zeros((N, 4))
    commanded[:, :3] = np.column_stack(profile(test["cruise"], test["accel"]))
    return conduct(commanded, test["cargo"], values, nuisance)


def conduct(
    commanded: Array,
    load: float,
    values: Mapping[str, float],
    nuisance: Nuisance,
    held: bool = False,
    rolls: float = 0.0,
) -> Trace:
    """Run a command.

    Args:
        commanded: (samples, 4): reference acceleration, speed and place, and a torque beside the controller's.
        load: load [kg].
        values: the effects.
        nuisance: of as many samples.
        held: whether the body is held upright and the torque is the motors' alone.
        rolls: speed at the begin [m/s].
    """
    v = {cause.name: cause.nominal for cause in (*KNOWN, *UNKNOWN)} | values
    day = 1.0 + nuisance.wobble * (0.005, 0.001, 0.1, 0.1, 0.01, 0.05, 0.05)
    body, height, cargo = 12.0 + v["extra_mass"], 0.25 + v["com_height"], load * day[0]
    # The extra mass sits in a box of its own, a little above the centre.
    moment = body * height + cargo * 0.4 + 0.02 * v["extra_mass"]
    inertia = 0.3 + body * height**2 + cargo * 0.16 + 0.05**2 * 12 + 0.005 * cargo
    p = np.array(
        [
            v["rolling_friction"] * day[2],
            v["viscous_friction"] * day[3],
            v["motor_strength"] * day[4],
            v["battery_sag"] * day[5],
            v["dead_zone"] * day[6],
            body + cargo,
            moment,
            inertia,
            np.deg2rad(v["slope"]),
            v["gyro_bias"] + nuisance.bias[0],
            v["accelerometer_offset"] + nuisance.bias[1],
            0.1 * v["wheel_radius"] * day[1],
            v["torque_ripple"],
            v["tether"],
            v["square_drag"],
            v["load_forward"],
        ]
    )
    late = np.abs(v["latency"] * (1 + 0.2 * nuisance.jitter))
    tilt = 0.0 if held else nuisance.tilt
    rows, fallen = ride(p, gains(), commanded, held, rolls, tilt, nuisance.noise, nuisance.sway, late)
    channels = dict(zip(UNITS, rows.T, strict=True))
    return Trace(TS * np.arange(len(rows)), channels, UNITS, {"failure": "fall"} if fallen else {})


@lru_cache(maxsize=1)
def gains() -> Array:
    """Return the controller's: a linear-quadratic regulator of place, speed, tilt and its rate, at its period."""
    m, ml, j = 12.0, 12.0 * 0.25, 0.30 + 12.0 * 0.25**2
    inverse = np.linalg.inv(np.array([[m + 2.0 + 0.012 / 0.01, ml], [ml, j]]))
    a, b = np.zeros((4, 4)), np.zeros((4, 1))
    a[0, 1] = a[2, 3] = 1.0
    a[1, 2], a[3, 2] = inverse @ np.array([0.0, ml * 9.81])
    b[1, 0], b[3, 0] = inverse @ np.array([10.0, -1.0])
    both = expm(np.block([[a, b], [np.zeros((1, 5))]]) * TS)
    ad, bd = both[:4, :4], both[:4, 4:]
    r = np.array([[0.4]])
    cost = solve_discrete_are(ad, bd, np.diag([4.0, 4.0, 30.0, 1.0]), r)
    return np.asarray(np.linalg.solve(r + bd.T @ cost @ bd, bd.T @ cost @ ad)[0])


@lru_cache(maxsize=512)
def profile(cruise: float, accel: float) -> tuple[Array, Array, Array]:
    """Return (samples,) acceleration, speed and place asked for: up from 0.5 s on, 1.5 s of cruise, and down again."""
    t, rise = TS * np.arange(N), cruise / accel
    up = (t >= 0.5) & (t < 0.5 + rise)
    down = (t >= 2.0 + rise) & (t < 2.0 + 2 * rise)
    steps = accel * (up.astype(float) - down)
    v = np.concatenate([[0.0], np.cumsum(steps[:-1]) * TS])
    n = 30  # samples over which the acceleration is smoothed
    v = np.convolve(np.concatenate([np.zeros(n), v]), np.ones(n) / n, "full")[n : n + N]
    return np.ascontiguousarray(np.gradient(v, TS)), v, np.cumsum(v) * TS


@njit(cache=True)
def rates(v, th, om, x, tau, p, push, upright):
    """Return the accelerations of wheels and tilt."""
    force, viscous, m, ml, j, slope, r = p[0], p[1], p[5], p[6], p[7], p[8], p[11]
    ripple, tether, square, ahead = p[12], p[13], p[14], p[15]
    stick = 2 / np.pi * np.arctan(v / 0.01) * (1 + 0.25 * np.exp(-((v / 0.08) ** 2)))
    friction = force * stick + viscous * np.sign(v) * abs(v) ** 0.9 + square * v * abs(v)
    held = tether * max(x - 1.2, 0.0) + ripple * np.sin(x / r)
    here = slope * (1 + 0.1 * np.sin(x))
    si, co = np.sin(th + here), np.cos(th + here)
    a = m + 2.05 + 0.0125 / (r * r)
    b = ml * co - ahead * si
    along = tau / r - friction - held - (m + 2.05) * 9.81 * np.sin(here) + (ml * si + ahead * co) * om * om
    about = 9.81 * (ml * np.sin(th) + ahead * np.cos(th)) - tau - 0.02 * om
    det = a * j - b * b
    if upright:
        return along / a + push / 16, 0.0
    return (j * along - b * about) / det + push / 16, (a * about - b * along) / det


@njit(cache=True)
def ride(p, k, commanded, held, rolls, tilt, noise, sway, late):
    """Return (samples, 9) as logged, and whether it fell."""
    gain, sag, dead, slope, bias, off, r = p[2], p[3], p[4], p[8], p[9], p[10], p[11]
    n = noise.shape[0]
    out, sent = np.zeros((n, 9)), np.zeros(n)
    x, v, th, om, place, guess = 0.0, rolls, tilt, 0.0, 0.0, tilt
    a, turn, volt = 0.0, 0.0, 1.0
    for i in range(n):
        a_ref, v_ref, x_ref, plus = commanded[i]
        gyro = om * 1.004 + bias * (1 + 0.1 * np.sin(i * 0.005)) + noise[i, 0]
        felt = a * np.cos(th + slope) + 0.1 * turn - 9.81 * np.sin(th) + off + noise[i, 1]
        wheel = v / r - om + noise[i, 2]
        guess = guess + 0.01 * gyro + 0.005 * (-(felt - a_ref) / 9.81 - guess)
        rolled = 0.1 * (wheel + gyro)
        place += 0.01 * rolled
        ahead = 1.52 * a_ref
        lean = (3.0 * a_ref + ahead) / 29.43
        u = ahead - k[0] * (place - x_ref) - k[1] * (rolled - v_ref) - k[2] * (guess - lean) - k[3] * gyro
        u = min(max(plus if held else u + plus, -8.0), 8.0)
        sent[i] = u
        o = out[i]
        o[0], o[1], o[2], o[3], o[4] = u, wheel, gyro, guess, v + noise[i, 3]
        o[5], o[6], o[7], o[8] = th + noise[i, 4], felt, v_ref, place - x_ref
        if abs(th) > 0.8:
            return out[: i + 1], True
        for s in range(SUB):
            there = int(np.floor((i * TS + s * H - late[i]) / TS + 1e-9))
            asked = sent[there] if there >= 0 else 0.0
            volt += H / 0.03 * ((1.0 - sag * min(abs(asked) / 8.0, 1.0)) - volt)
            size = np.sqrt(asked * asked + 0.0009)
            made = max(size - dead * np.tanh(size / (dead + 1e-6) * 1.5), 0.0)
            tau = gain * volt * asked / size * made
            a1, t1 = rates(v, th, om, x, tau, p, sway[i], held)
            a2, t2 = rates(
                v + H / 2 * a1, th + H / 2 * om, om + H / 2 * t1, x + H / 2 * v, tau, p, sway[i], held
            )
            a3, t3 = rates(
                v + H / 2 * a2, th + H / 2 * (om + H / 2 * t1), om + H / 2 * t2, x + H / 2 * (v + H / 2 * a1), tau, p,
                sway[i], held,
            )  # fmt: skip
            a4, t4 = rates(
                v + H * a3,
                th + H * (om + H / 2 * t2),
                om + H * t3,
                x + H * (v + H / 2 * a2),
                tau,
                p,
                sway[i],
                held,
            )
            x += H * v + H * H / 6 * (a1 + a2 + a3)
            th += H * om + H * H / 6 * (t1 + t2 + t3)
            v += H / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            om += H / 6 * (t1 + 2 * t2 + 2 * t3 + t4)
            a, turn = a1, t1
    return out, False
