"""The real quadrotor of the set: other code and other laws than the simulator's, as someone outside wrote them.

Runge-Kutta at 1.25 ms, rotors of a higher order whose loss grows with thrust, a battery that sags with the load
and flattens, the ground by Cheeseman and Bennett, drag by a power and by the square, wind that grows with height,
gusts of another colour, commands that are held and whose delay jitters, a payload that hangs. Shared with the
simulator are what the machine is asked to do and the controller, which are the system under test; both are
written anew here, for nothing is imported from the simulator.
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

VERSION = "quad/2"
"""Of this generator; it goes into every label."""
SPEC = Path(__file__).parent / "quad.stl"
TC, N, EVERY = 0.005, 1001, 4
"""Period of the control [s], periods in a flight, periods from one sample of the log to the next."""
UNITS = {
    "x": "m",
    "z": "m",
    "vx": "m/s",
    "vz": "m/s",
    "pitch": "rad",
    "rate": "rad/s",
    "pitch_ref": "rad",
    "u_front": "N",
    "u_rear": "N",
    "x_ref": "m",
    "z_ref": "m",
}
G, IY, ARM, MASS = 9.81, 0.012, 0.12, 1.2
PEAK = 8.2
"""[N] No rotor is asked for more than this in a flight as it should be: a ceiling above it is none."""

KNOWN = (
    linear("thrust_loss", "factor", -0.10, nominal=1.0, signed=True),
    linear("rotor_lag", "time", 0.03),
    linear("payload", "mass", 0.16),
    linear("com_offset", "ahead", 0.012, signed=True),
    linear("drag", "rate", 0.30),
    linear("ground_effect", "share", 0.24),
    linear("wind", "speed", 1.6, signed=True),
    linear("pitch_bias", "angle", 0.04, signed=True),
    linear("command_delay", "time", 0.016),
    linear("battery_sag", "rate", 0.03),
)
UNKNOWN = (
    linear("late_position", "time", 0.1),
    linear("gyro_filter", "time", 0.04),
    Cause("thrust_ceiling", "thrust", lambda size: PEAK - 0.6 * size, nominal=99.0),
    linear("weak_rear_rotor", "factor", -0.07, nominal=1.0),
)
"""A position sensor that is late, a filter on the gyro, rotors that make no more than so much, one that is weak."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Nuisance:
    """What differs from flight to flight.

    Attributes:
        once: where it starts, how far the attitude is off, of the thrust and of the wind.
        noise: of the six things that are measured, every period.
        gusts: of either direction, every period.
        jitter: of the commands' delay, every period.
    """

    once: Array
    noise: Array
    gusts: Array
    jitter: Array


def drawn_nuisance(rng: Generator, ticks: int = N) -> Nuisance:
    """Draw what is not the same in any two flights."""
    return Nuisance(
        rng.normal(size=5),
        rng.normal(size=(ticks, 6)),
        rng.normal(size=(ticks, 2)),
        rng.uniform(-1, 1, size=ticks),
    )


def drive(values: Mapping[str, float], test: Mapping[str, float], nuisance: Nuisance) -> Trace:
    """Fly one test with these effects, known and unknown by name; what is not named is as it should be."""
    return conduct(flight(test["dx"], test["height"]), values, nuisance, test["fan"], 1.0, EVERY)


def conduct(
    commanded: Array, values: Mapping[str, float], nuisance: Nuisance, fan: float, gain: float, every: int
) -> Trace:
    """Fly a command.

    Args:
        commanded: (periods, 9) as :func:`flight` returns it.
        values: the effects.
        nuisance: of as many periods.
        fan: its wind [m/s].
        gain: factor on the stiffness of the pitch loop.
        every: periods from one sample of the log to the next.
    """
    v = {cause.name: cause.nominal for cause in (*KNOWN, *UNKNOWN)} | values
    once = nuisance.once
    plant = np.array(
        [
            v["thrust_loss"],
            v["rotor_lag"],
            v["payload"],
            v["com_offset"],
            v["drag"],
            v["ground_effect"],
            v["wind"] + 0.11 * once[4],
            v["battery_sag"],
            1 + 0.006 * once[3],
            fan,
            v["thrust_ceiling"],
            v["weak_rear_rotor"],
        ]
    )
    out, fell = fly(
        commanded,
        plant,
        v["pitch_bias"],
        v["command_delay"],
        v["late_position"],
        v["gyro_filter"],
        nuisance.noise,
        nuisance.gusts,
        once,
        nuisance.jitter,
        gain,
        every,
    )
    channels = dict(zip(UNITS, out.T.copy(), strict=True))
    return Trace(TC * every * np.arange(len(out)), channels, UNITS, {"failure": "crashed"} if fell else {})


@njit(cache=True)
def deriv(s, c1, c2, P, wx, wz, t):
    """Return the rates of ``s``: x z th vx vz q, two rotors' thrust as nominal, then two as lagging (with rates)."""
    _, z, th, vx, vz, q, f0, r0, fy, fd, ry, rd = s
    loss, lag, mass, com, drag, ground, wind, sag, one, fan, ceil_, weak = P
    a = max(0.5 * lag, 5e-4)
    f, r = (fy, ry) if lag > 0 else (f0, r0)
    # battery: open-circuit drop that flattens, plus sag in proportion to load; the same at 5 s and at hover load
    v = 1.0 - sag * 5.0 * (1 - np.exp(-max(t, 0.0) / 5.0)) / (1 - np.exp(-1.0)) * (
        0.6 + 0.4 * (f + r) / (MASS * G)
    )
    h = max(z, 0.05)
    # Cheeseman-Bennett, R_eff so that 1/(1-(R/4h)^2)-1 = share*exp(-0.6/0.3) at 0.6 m
    g6 = ground * np.exp(-2.0)
    rr = 0.36 * g6 / (1 + g6)
    ge = 1.0 / (1.0 - min(rr / (h * h), 0.5))
    # thrust curve, bent by 1 % and exact at hover; a loss is larger at high thrust
    lf = 1 - (1 - loss) * (max(f, 0.1) / 5.9) ** 0.3
    lr = 1 - (1 - loss) * (max(r, 0.1) / 5.9) ** 0.3
    tf = min(f * (1 + 0.01 * (f / 5.9 - 1.0)) * lf * v * ge * one, ceil_)
    tr = min(r * (1 + 0.01 * (r / 5.9 - 1.0)) * lr * v * ge * one, ceil_) * weak
    m = MASS + mass
    iy = IY + mass * 0.03**2  # hung 3 cm below
    w = wind * (max(z, 0.1) / 1.0) ** 0.14
    va, wa = vx - fan - w - wx, vz - wz
    sp = np.sqrt(va * va + wa * wa)
    # nominal drag as a power law near the simulator's, extra drag quadratic, equal at 2 m/s
    fx = -0.17 * abs(va) ** 0.4 * va * 1.0 - 0.5 * drag * sp * va
    fz = -0.25 * wa - 0.5 * drag * sp * wa
    T = tf + tr
    d = np.empty(12)
    d[0], d[1], d[2] = vx, vz, q
    d[3] = (T * np.sin(th) + fx) / m
    d[4] = (T * np.cos(th) + fz) / m - G
    d[5] = (ARM * (tr - tf) + com * T) / iy
    d[6], d[7] = (c1 - f0) / 0.03, (c2 - r0) / 0.03
    d[8], d[9] = fd, (f0 - fy) / (a * a) - 2 * fd / a
    d[10], d[11] = rd, (r0 - ry) / (a * a) - 2 * rd / a
    return d


@njit(cache=True)
def mj(s):
    """Return a smooth step from 0 to 1 and its two derivatives."""
    if s <= 0.0:
        return 0.0, 0.0, 0.0
    if s >= 1.0:
        return 1.0, 0.0, 0.0
    return (
        10 * s**3 - 15 * s**4 + 6 * s**5,
        30 * s**2 - 60 * s**3 + 30 * s**4,
        60 * s - 180 * s**2 + 120 * s**3,
    )


@njit(cache=True)
def flight(dx, height):
    """Return (periods, 9) of a test: x, z with two derivatives each, whether level, thrusts added front and rear."""
    commanded = np.zeros((N, 9))
    for k in range(N):
        t = k * TC
        a, a1, a2 = mj((t - 0.2) / 1.6)
        b, b1, b2 = mj(t - 2.4)
        commanded[k, 0], commanded[k, 1], commanded[k, 2] = dx * a, dx * a1 / 1.6, dx * a2 / 2.56
        commanded[k, 3], commanded[k, 4], commanded[k, 5] = height + 0.3 * b, 0.3 * b1, 0.3 * b2
    return commanded


@njit(cache=True)
def fly(commanded, P, bias, delay, gps, gyro, nz, gu, once, jit, gain, every):
    """Return (samples, 11) as logged, and whether it crashed."""
    n = commanded.shape[0]
    stiff, damp = gain, np.sqrt(gain)
    s = np.zeros(12)
    s[0], s[1] = 0.02 * once[0], commanded[0, 3] + 0.02 * once[1]
    s[6] = s[7] = s[8] = s[10] = 0.5 * MASS * G
    cf, cr = np.empty(n), np.empty(n)
    px, pv = np.empty(n), np.empty(n)
    samples = (n - 1) // every + 1
    out = np.empty((samples, 11))
    rows = 0
    ix, iz, ia, wx, wz, qf, wa = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        t = k * TC
        xr, vxr, axr, zr, vzr, azr, level, plus_front, plus_rear = commanded[k]
        px[k], pv[k] = s[0], s[3]
        old = max(0, k - round(gps / TC))
        mx, mz = px[old] + 0.0055 * nz[k, 0], s[1] + 0.0055 * nz[k, 1]
        mvx, mvz = pv[old] + 0.022 * nz[k, 2], s[4] + 0.022 * nz[k, 3]
        qf = s[5] if gyro == 0.0 or k == 0 else qf + (1 - np.exp(-TC / gyro)) * (s[5] - qf)
        mth = s[2] + bias * (1 + 0.1 * np.sin(1.3 * t + once[2])) + 0.001 * once[2] + 0.0032 * nz[k, 4]
        mq = qf + 0.022 * nz[k, 5]
        ex, ez = xr - mx, zr - mz
        ix += TC * ex
        iz += TC * ez
        ax = axr + 5.0 * ex + 4.0 * (vxr - mvx) + 2.5 * ix
        az = azr + 9.0 * ez + 5.0 * (vzr - mvz) + 5.0 * iz
        thr = min(max(np.arctan2(ax, G), -0.6), 0.6) * (1.0 - level)
        e = thr - mth
        ia = min(max(ia + TC * e, -0.3), 0.3)
        tot = MASS * (G + az) / max(np.cos(mth), 0.5)
        tau = IY * (100 * stiff * e - 16 * damp * mq + 80 * stiff * ia)
        cf[k] = min(max(0.5 * tot - 0.5 * tau / ARM + plus_front, 0.0), 11.0)
        cr[k] = min(max(0.5 * tot + 0.5 * tau / ARM + plus_rear, 0.0), 11.0)
        if k % every == 0:
            r = out[rows]
            r[0], r[1], r[2], r[3], r[4], r[5] = mx, mz, mvx, mvz, mth, mq
            r[6], r[7], r[8], r[9], r[10] = thr, cf[k], cr[k], xr, zr
            rows += 1
        wa += (
            -wa * TC / 0.3 + 0.32 * np.sqrt(2 * TC / 0.3) * gu[k, 0]
        )  # second-order gust: filtered once more
        wx += (wa * 1.35 - wx) * TC / 0.4
        wz += -wz * TC / 0.4 + 0.16 * np.sqrt(2 * TC / 0.4) * gu[k, 1]
        for j in range(4):
            h = TC / 4
            tt = t + j * h - delay * (1 + 0.2 * jit[k])  # zero-order hold, a delay that jitters
            i = min(k, int(np.floor(tt / TC + 1e-9)))
            # Until the first command arrives the rotors hover on.
            c1, c2 = (cf[i], cr[i]) if i >= 0 else (0.5 * MASS * G, 0.5 * MASS * G)
            k1 = deriv(s, c1, c2, P, wx, wz, t + j * h)
            k2 = deriv(s + 0.5 * h * k1, c1, c2, P, wx, wz, t + j * h)
            k3 = deriv(s + 0.5 * h * k2, c1, c2, P, wx, wz, t + j * h)
            k4 = deriv(s + h * k3, c1, c2, P, wx, wz, t + j * h)
            s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if s[1] < 0 or abs(s[2]) > 1.3 or abs(s[0]) > 6:
            break
    return out[:rows], rows < samples
