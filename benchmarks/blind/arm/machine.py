"""The real arm of the set: other code and other laws than the simulator's, as someone outside wrote them.

Absolute angles, two masses a joint behind a gear that stiffens, Runge-Kutta at 0.25 ms, friction that rises near
rest and thins with speed, drives that saturate roundly, encoders that count, pushes of two colours. Shared with
the simulator are what the machine is asked to do and the controller with its own model, which are the system
under test; both are written anew here, for nothing is imported from the simulator.
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

from benchmarks.blind.outsiders.cases import linear
from s2r_spec.trace import Trace

VERSION = "arm/2"
"""Of this generator; it goes into every label."""
SPEC = Path(__file__).parent / "arm.stl"
TS, H, SUB, N = 0.002, 0.00025, 8, 1501
"""Period of the control and of the log [s], step of the physics [s], steps in a period, samples in a log."""
UNITS = {"q_ref": "rad", "q": "rad", "v": "rad/s", "u": "N*m"}
RIGID = 6e-6
"""[rad/(N·m)] Gears always wind up by this much."""

KNOWN = (
    linear("viscous", "coefficient", 0.5),
    linear("coulomb", "torque", 1.0),
    linear("torque_constant", "factor", 0.08, nominal=1.0, signed=True),
    linear("torque_limit", "factor", -0.3, nominal=1.0),
    linear("rotor_inertia", "factor", 0.2, nominal=1.0, signed=True),
    linear("forearm_mass", "extra", 0.24, signed=True),
    linear("payload_offset", "out", 0.04, signed=True),
    linear("delay", "time", 0.003),
    linear("speed_filter", "time", 0.004),
    linear("encoder_offset", "angle", 0.024, signed=True),
    linear("base_tilt", "angle", 0.02, signed=True),
    linear("compliance", "per_torque", 3e-4),
)
UNKNOWN = (
    linear("cogging", "part", 1.0),
    linear("hose_spring", "stiffness", 4.0),
    linear("floor_vibration", "torque", 1.5),
    linear("damping_gain", "factor", -0.4, nominal=1.0),
)
"""Magnets that pull the rotors, a hose across the elbow, a floor that shakes at 7 Hz, a controller set too soft."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Nuisance:
    """What differs from run to run.

    Attributes:
        payload: how much heavier the payload is than the controller is told [kg].
        start: of the joints [rad].
        gain: of both drives.
        encoder: noise of every sample [rad].
        push: on the joints, over time [N·m].
        phase: of a floor that shakes.
    """

    payload: float
    start: Array
    gain: float
    encoder: Array
    push: Array
    phase: float


def drawn_nuisance(rng: Generator, ticks: int = N) -> Nuisance:
    """Draw what is not the same in any two runs."""
    payload = 0.012 * rng.normal()
    start = rng.normal(size=2) * 0.0035
    gain = 1 + 0.0025 * rng.standard_t(6) / 1.2
    encoder = 2.2e-5 * rng.normal(size=(ticks, 2))
    push = two_ou(rng.normal(size=(ticks, 4))) * np.array([0.05, 0.018])
    return Nuisance(payload, start, gain, encoder, push, rng.uniform(0, 6.28))


def drive(values: Mapping[str, float], test: Mapping[str, float], nuisance: Nuisance) -> Trace:
    """Run one test on an arm with these effects, known and unknown by name; what is not named is as it should be."""
    ref = reference(test["amplitude"], test["frequency"])
    return conduct(ref, np.ones(N), test["payload"], values, nuisance, 1.0)


def conduct(
    ref: Array, on: Array, declared: float, values: Mapping[str, float], nuisance: Nuisance, stiff: float
) -> Trace:
    """Run a command.

    Args:
        ref: (samples, 6) as :func:`reference` returns it.
        on: (samples,) 1 where the drives are on, else 0.
        declared: declared payload [kg].
        values: the effects.
        nuisance: of as many samples.
        stiff: factor on the joints' stiffness.
    """
    v = {cause.name: cause.nominal for cause in (*KNOWN, *UNKNOWN)} | values
    links = (
        v["viscous"],
        v["coulomb"],
        v["rotor_inertia"],
        v["forearm_mass"],
        v["payload_offset"],
        v["base_tilt"],
        max(v["compliance"], RIGID),
    )
    rec, ran = machine(
        ref,
        declared,
        max(0.0, declared + nuisance.payload),
        nuisance.start,
        nuisance.push,
        nuisance.encoder,
        nuisance.gain,
        v["torque_constant"],
        v["torque_limit"],
        v["delay"],
        v["speed_filter"],
        v["encoder_offset"],
        links,
        v["hose_spring"],
        v["cogging"],
        v["floor_vibration"],
        nuisance.phase,
        v["damping_gain"],
        on,
        stiff,
    )
    channels = {
        "q_ref": ref[:ran, :2],
        "q": rec[:ran, :2],
        "v": rec[:ran, 2:4],
        "u": np.round(rec[:ran, 4:], 3),
    }
    return Trace(TS * np.arange(ran), channels, UNITS, {"failure": "tripped"} if ran < len(ref) else {})


@lru_cache(maxsize=64)
def reference(amplitude: float, frequency: float) -> Array:
    """Return (samples, 6): two angles, speeds and accelerations asked for, faded in over 0.6 s about a posture."""
    t = TS * np.arange(N)
    s = np.clip(t / 0.6, 0.0, 1.0)
    r = s**3 * (10 - 15 * s + 6 * s * s)
    r1 = 30 * s * s * (1 - s) ** 2 / 0.6
    r2 = 60 * s * (1 - s) * (1 - 2 * s) / 0.36
    out = np.empty((N, 6))
    sines = ((-0.6, amplitude, 2 * np.pi * frequency), (0.8, 0.7 * amplitude, 3 * np.pi * frequency))
    for j, (centre, a, w) in enumerate(sines):
        y, y1, y2 = np.sin(w * t), w * np.cos(w * t), -w * w * np.sin(w * t)
        out[:, j] = centre + a * r * y
        out[:, 2 + j] = a * (r1 * y + r * y1)
        out[:, 4 + j] = a * (r2 * y + 2 * r1 * y1 + r * y2)
    return out


@njit(cache=True)
def rates(y, tau, push, e, mp, hose, cog):
    """Return the rates of ``y``: two absolute angles of links, two of rotors (relative), and their speeds."""
    viscous, coulomb, rot, extra, out, tilt, comp = e
    p1, p2, t1, t2, w1, w2, r1, r2 = y
    m2 = 2.0 + extra
    reach = 0.35 + out
    A = 0.05 + 3.0 * 0.04 + (m2 + mp) * 0.16
    B = 0.025 * m2 / 2.0 + m2 * 0.0289 + mp * (reach * reach + 0.002)
    K = m2 * 0.17 + mp * reach
    C = 0.4 * K
    d = p2 - p1
    k1, k2 = 1.0 / comp, 0.5 / comp
    e1, e2 = t1 - p1, t2 - d
    T1 = k1 * e1 * (1.0 + 2e3 * e1 * e1) + 0.0015 * k1 * (r1 - w1)
    T2 = k2 * e2 * (1.0 + 2e3 * e2 * e2) + 0.0015 * k2 * (r2 - (w2 - w1))
    T2l = T2 + push[1] - hose * (d - 0.8)
    T1l = T1 + push[0]
    Q1 = T1l - T2l + C * np.sin(d) * w2 * w2 - (0.6 + (m2 + mp) * 0.4) * 9.81 * np.cos(p1 + tilt)
    Q2 = T2l - C * np.sin(d) * w1 * w1 - K * 9.81 * np.cos(p2 + tilt)
    c = C * np.cos(d)
    det = A * B - c * c
    rise1, rise2 = 1 + 0.15 * np.exp(-((r1 / 0.05) ** 2)), 1 + 0.15 * np.exp(-((r2 / 0.05) ** 2))
    f1 = viscous * 1.1 * r1 / (1 + 0.1 * abs(r1)) + coulomb * np.tanh(r1 / 0.01) * rise1
    f2 = 0.4 * (viscous * 1.1 * r2 / (1 + 0.1 * abs(r2)) + coulomb * np.tanh(r2 / 0.01) * rise2)
    out8 = np.empty(8)
    out8[0], out8[1], out8[2], out8[3] = w1, w2, r1, r2
    out8[4] = (B * Q1 - c * Q2) / det
    out8[5] = (A * Q2 - c * Q1) / det
    out8[6] = (tau[0] + cog * 1.2 * np.sin(30 * t1 + 0.7) - f1 - T1) / (0.2 * rot)
    out8[7] = (tau[1] + cog * 0.5 * np.sin(30 * t2) - f2 - T2) / (0.05 * rot)
    return out8


@njit(cache=True)
def machine(
    ref,
    mp_told,
    mp,
    start,
    push,
    enc,
    gain,
    kt,
    limit,
    delay,
    filt,
    off,
    e,
    hose,
    cog,
    shake,
    phase,
    kd,
    on,
    stiff,
):
    """Return (samples, 6) of q, v, u as logged, and how many samples there are before it tripped."""
    n = ref.shape[0]
    rec = np.zeros((n, 6))
    lims = np.array([80.0, 30.0])
    y = np.zeros(8)
    y[0] = ref[0, 0] + start[0]
    y[1] = y[0] + ref[0, 1] + start[1] - off
    K = 2.0 * 0.17 + mp * 0.35
    g2 = K * 9.81 * np.cos(y[1])
    g1 = g2 + (0.6 + (2 + mp) * 0.4) * 9.81 * np.cos(y[0])
    y[2] = y[0]
    y[3] = y[1] - y[0]
    y[0] -= e[6] * g1
    y[1] = y[0] + y[3] - 2 * e[6] * g2
    hist = np.zeros((n * SUB, 2))
    # Until the first command arrives the drives hold the arm where it was set.
    lower = (0.34 + mp_told * 0.35) * 9.81 * np.cos(ref[0, 0] + ref[0, 1])
    hold = np.array([lower + (0.6 + (2 + mp_told) * 0.4) * 9.81 * np.cos(ref[0, 0]), lower]) * gain * kt
    lagged = hold.copy()
    tau = np.zeros(2)
    u = np.zeros(2)
    s1, s2, before = np.zeros(2), np.zeros(2), np.zeros(2)
    back = 0.8 * delay / H
    whole = int(back)
    part = back - whole
    lag = np.exp(-H / (0.2 * delay)) if delay > 0 else 0.0
    keep = np.exp(-TS / (0.5 * filt)) if filt > 0 else 0.0
    p = np.zeros(2)
    for i in range(n):
        # the controller's own model, in relative angles
        a2 = 0.025 + 2.0 * 0.0289 + mp_told * 0.35 * 0.35
        k = 0.34 + mp_told * 0.35
        q1, q2, v1, v2, a, b = ref[i]
        c2, s = np.cos(q2), np.sin(q2)
        m12 = a2 + 0.4 * k * c2
        m11 = 0.17 + (2.0 + mp_told) * 0.16 + a2 + 0.8 * k * c2
        gg = k * 9.81 * np.cos(q1 + q2)
        upper = (0.6 + (2 + mp_told) * 0.4) * 9.81 * np.cos(q1)
        ff = (
            (m11 + 0.2) * a + m12 * b - 0.4 * k * s * (2 * v1 * v2 + v2 * v2) + gg + upper,
            m12 * a + (a2 + 0.05) * b + 0.4 * k * s * v1 * v1 + gg,
        )
        for j in range(2):
            seen = np.round((y[2 + j] + enc[i, j] + (off if j == 1 else 0.0)) / 2e-5) * 2e-5
            raw = (seen - before[j]) / TS if i else 0.0
            s1[j] = raw + keep * (s1[j] - raw)
            s2[j] = s1[j] + keep * (s2[j] - s1[j])
            before[j] = seen
            kp = stiff * (400.0 if j == 0 else 150.0)
            kv = np.sqrt(stiff) * kd * (30.0 if j == 0 else 8.0)
            c = ff[j] + kp * (ref[i, j] - seen) + kv * (ref[i, 2 + j] - s2[j])
            u[j] = on[i] * min(max(c, -lims[j]), lims[j])
            rec[i, j], rec[i, 2 + j], rec[i, 4 + j] = seen, s2[j], u[j]
            if abs(ref[i, j] - seen) > 0.6:
                return rec, i + 1
        for m in range(SUB):
            now = i * SUB + m
            for j in range(2):
                x = gain * kt * u[j]
                hist[now, j] = x
                x0 = hist[now - whole, j] if now >= whole else hold[j]
                x1 = hist[now - whole - 1, j] if now > whole else hold[j]
                x = x0 + part * (x1 - x0)
                lagged[j] = x + lag * (lagged[j] - x)
                L = limit * lims[j]
                z = lagged[j] * (1 - 0.01 * (lagged[j] / lims[j]) ** 2)
                tau[j] = z / (1 + (abs(z) / L) ** 12) ** (1 / 12)
                p[j] = push[i, j]
            p[0] += shake * np.sin(2 * np.pi * 7.0 * now * H + phase)
            k1 = rates(y, tau, p, e, mp, hose, cog)
            k2 = rates(y + 0.5 * H * k1, tau, p, e, mp, hose, cog)
            k3 = rates(y + 0.5 * H * k2, tau, p, e, mp, hose, cog)
            k4 = rates(y + H * k3, tau, p, e, mp, hose, cog)
            y = y + H / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return rec, n


@njit(cache=True)
def two_ou(z):
    """Return pushes of two colours, 0.2 s and 0.05 s, on either joint, of white noise."""
    out = np.zeros((z.shape[0], 2))
    ka, kb = np.exp(-TS / 0.2), np.exp(-TS / 0.05)
    a, b = np.zeros(2), np.zeros(2)
    for i in range(z.shape[0]):
        for j in range(2):
            a[j] = ka * a[j] + np.sqrt(1 - ka * ka) * z[i, j]
            b[j] = kb * b[j] + np.sqrt(1 - kb * kb) * z[i, 2 + j]
            out[i, j] = a[j] + b[j]
    return out
