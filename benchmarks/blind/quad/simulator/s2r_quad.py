"""A planar quadrotor (x, z, pitch) with a cascaded PID, released in the wind of a fan and sent sideways, then up.

Someone outside wrote it, with its catalogue, to be diagnosed; the machine next door is theirs, too.
It has no residuals and no variants: all that a diagnosis has are whole flights.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from s2r_quad_protocols import PROTOCOLS, plan

from s2r_spec import Trace
from s2r_spec.backend import Channel, Effect, EffectParameter, Parameter
from s2r_spec.effects import Choice, Values, as_values, choose, read_word, settings, words
from s2r_spec.errors import UsageError
from s2r_spec.protocols import PROTOCOL, Protocol, named

Array = NDArray[np.float64]

TC, SUB, PRE, DUR = 0.005, 2, 0.0, 5.0  # control period, physics steps per period, time before log, log
EVERY = 4  # control periods from one sample of the log to the next
NPRE, NLOG = round(PRE / TC), round(DUR / TC)
N = NPRE + NLOG + 1

CHANNELS = (
    Channel("x", "m", "measured position"),
    Channel("z", "m", "measured height"),
    Channel("vx", "m/s", "estimated velocity"),
    Channel("vz", "m/s", "estimated climb rate"),
    Channel("pitch", "rad", "measured pitch, nose towards +x"),
    Channel("rate", "rad/s", "pitch rate by gyro"),
    Channel("pitch_ref", "rad", "pitch that the position loop asks for"),
    Channel("u_front", "N", "thrust asked of the front rotor"),
    Channel("u_rear", "N", "thrust asked of the rear rotor"),
    Channel("x_ref", "m", "position asked for"),
    Channel("z_ref", "m", "height asked for"),
)
PARAMETERS = (
    Parameter("dx", "m", -2.0, 2.0, 1.0, "how far it is sent sideways"),
    Parameter("height", "m", 0.4, 1.5, 1.0, "height over ground at the start"),
    Parameter("fan", "m/s", 0.0, 3.0, 0.0, "wind that the fan is set to, towards +x"),
)


def _effect(
    name: str,
    family: str,
    physics: str,
    parameter: str,
    unit: str,
    low: float,
    high: float,
    nominal: float,
    prior: str,
    *more: EffectParameter,
) -> Effect:
    return Effect(name, family, physics, (EffectParameter(parameter, unit, low, high, nominal, prior), *more))


CATALOGUE = (
    _effect(
        "thrust_loss", "actuation", "Both rotors make this part of the thrust that is asked for.",
        "factor", "", 0.75, 1.15, 1.0, "normal around 1, standard deviation 0.05",
    ),
    _effect(
        "rotor_lag", "actuation",
        "Thrust follows the command slower by this time constant. A part of it may be dead time, as of a lag of "
        "several stages.",
        "time", "s", 0.0, 0.07, 0.0, "half-normal, 0.015 s",
        EffectParameter("dead", "", 0.0, 0.8, 0.0, "half-normal, 0.25"),
    ),
    _effect(
        "payload", "inertia", "Mass that the controller does not know of, at the centre.",
        "mass", "kg", 0.0, 0.4, 0.0, "half-normal, 0.08 kg",
    ),
    _effect(
        "com_offset", "inertia", "The centre of mass is this much ahead of the rotors' middle.",
        "ahead", "m", -0.03, 0.03, 0.0, "normal, 0.006 m",
    ),
    _effect(
        "drag", "aerodynamics",
        "More drag, in proportion to airspeed; at power = 1 to its square, with the same drag at 2 m/s.",
        "rate", "kg/s", 0.0, 0.8, 0.0, "half-normal, 0.15 kg/s",
        EffectParameter("power", "", 0.0, 1.0, 0.0, "uniform"),
    ),
    _effect(
        "ground_effect", "aerodynamics", "Near the ground rotors push harder, by this share at the ground.",
        "share", "", 0.0, 0.6, 0.0, "half-normal, 0.12",
    ),
    _effect(
        "wind", "environment", "A steady horizontal wind besides the fan's.",
        "speed", "m/s", -4.0, 4.0, 0.0, "normal, 0.8 m/s",
    ),
    _effect(
        "pitch_bias", "sensing", "The attitude estimate is this much too high.",
        "angle", "rad", -0.1, 0.1, 0.0, "normal, 0.02 rad",
    ),
    _effect(
        "command_delay", "timing", "Commands reach the rotors this much later.",
        "time", "s", 0.0, 0.04, 0.0, "half-normal, 0.008 s",
    ),
    _effect(
        "battery_sag", "actuation", "Thrust falls by this share per second of the flight, from its start.",
        "rate", "1/s", 0.0, 0.1, 0.0, "half-normal, 0.015 1/s",
    ),
)  # fmt: skip
ORDER = tuple((e.name, p.name, p.nominal) for e in CATALOGUE for p in e.parameters)


@njit(cache=True)
def _minjerk(s):
    """Return a smooth step from 0 to 1 and its two derivatives."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s * s), 30 * s * s * (1 - s) ** 2, 60 * s - 180 * s * s + 120 * s**3


@njit(cache=True)
def _plan(dx, height):
    """Return (N, 9) of a test, as :func:`s2r_quad_protocols.plan` has them of a protocol."""
    out = np.zeros((N, 9))
    for k in range(N):
        t = (k - NPRE) * TC
        a, av, aa = _minjerk((t - 0.2) / 1.6)
        b, bv, ba = _minjerk((t - 2.4) / 1.0)
        out[k, 0], out[k, 1], out[k, 2] = dx * a, dx * av / 1.6, dx * aa / 2.56
        out[k, 3], out[k, 4], out[k, 5] = height + 0.3 * b, 0.3 * bv, 0.3 * ba
    return out


def _fly(dx, height, fan, eff, meas, gust, once):
    """Return (samples, 11) of a test in the order of CHANNELS, and whether it crashed; see :func:`_flight`."""
    return _flight(_plan(dx, height), fan, eff, meas, gust, once, 1.0, EVERY)


@njit(cache=True)
def _flight(plan, fan, eff, meas, gust, once, gain, every):
    """Return (samples, 11) in the order of CHANNELS, and whether it crashed.

    ``eff`` is in the order of ORDER, ``gain`` a factor on the pitch loop's stiffness, ``every`` periods are a sample.
    """
    factor, tlag, dead, mass, ahead, drag, power, ground, wind, bias, delay, sag = eff
    M0, IY, ARM, G, UMAX = 1.2, 0.012, 0.12, 9.81, 11.0
    h = TC / SUB
    m = M0 + mass
    keep = np.exp(-h / (0.03 + (1.0 - dead) * tlag))
    delay += dead * tlag
    n = plan.shape[0]
    kp, kd, ki = 100.0 * gain, 16.0 * np.sqrt(gain), 80.0 * gain
    x, z, th, vx, vz, q = 0.02 * once[0], plan[0, 3] + 0.02 * once[1], 0.0, 0.0, 0.0, 0.0
    hover = 0.5 * M0 * G
    tf = tr = hover
    ix = iz = ia = 0.0
    wx = wz = 0.0
    front, rear = np.empty(n), np.empty(n)
    out = np.empty(((n - 1) // every + 1, 11))
    rows = 0
    fell = 0
    for k in range(n):
        t = (k - NPRE) * TC
        xr, vxr, axr, zr, vzr, azr, level, more_front, more_rear = plan[k]
        # what is measured
        mx, mz = x + 0.005 * meas[k, 0], z + 0.005 * meas[k, 1]
        mvx, mvz = vx + 0.02 * meas[k, 2], vz + 0.02 * meas[k, 3]
        mth, mq = th + bias + 0.001 * once[2] + 0.003 * meas[k, 4], q + 0.02 * meas[k, 5]
        # cascade
        ex, ez = xr - mx, zr - mz
        ix += TC * ex
        iz += TC * ez
        ax = axr + 5.0 * ex + 4.0 * (vxr - mvx) + 2.5 * ix
        az = azr + 9.0 * ez + 5.0 * (vzr - mvz) + 5.0 * iz
        thr = 0.0 if level else min(max(np.arctan2(ax, G), -0.6), 0.6)
        ea = thr - mth
        ia = min(max(ia + TC * ea, -0.3), 0.3)
        total = M0 * (G + az) / max(np.cos(mth), 0.5)
        tau = IY * (kp * ea - kd * mq + ki * ia)
        uf = min(max(0.5 * total - 0.5 * tau / ARM + more_front, 0.0), UMAX)
        ur = min(max(0.5 * total + 0.5 * tau / ARM + more_rear, 0.0), UMAX)
        front[k], rear[k] = uf, ur
        if k >= NPRE and (k - NPRE) % every == 0:
            r = out[rows]
            r[0], r[1], r[2], r[3], r[4], r[5] = mx, mz, mvx, mvz, mth, mq
            r[6], r[7], r[8], r[9], r[10] = thr, uf, ur, xr, zr
            rows += 1
        # gusts
        wx += -wx * TC / 0.8 + 0.3 * np.sqrt(2 * TC / 0.8) * gust[k, 0]
        wz += -wz * TC / 0.5 + 0.15 * np.sqrt(2 * TC / 0.5) * gust[k, 1]
        # plant
        back = delay / TC
        whole = int(back)
        part = back - whole
        i0, i1 = k - whole, k - whole - 1
        # Until the first command arrives the rotors hover on.
        f0, f1 = front[i0] if i0 >= 0 else hover, front[i1] if i1 >= 0 else hover
        r0, r1 = rear[i0] if i0 >= 0 else hover, rear[i1] if i1 >= 0 else hover
        cf = f0 + part * (f1 - f0)
        cr = r0 + part * (r1 - r0)
        fade = factor * (1.0 - sag * max(t, 0.0)) * (1 + 0.005 * once[3])
        for _ in range(SUB):
            tf = cf + keep * (tf - cf)
            tr = cr + keep * (tr - cr)
            lift = fade * (1.0 + ground * np.exp(-max(z, 0.0) / 0.3))
            pf, pr = lift * tf, lift * tr
            vair, wair = vx - (fan + wind + 0.1 * once[4] + wx), vz - wz
            more = drag * (0.5 * np.hypot(vair, wair)) ** power
            fx = -(0.12 * vair + 0.05 * abs(vair) * vair) - more * vair
            fz = -0.25 * wair - more * wair
            T = pf + pr
            vx += h * (T * np.sin(th) + fx) / m
            vz += h * ((T * np.cos(th) + fz) / m - G)
            q += h * (ARM * (pr - pf) + ahead * T) / IY
            x += h * vx
            z += h * vz
            th += h * q
        if z < 0.0 or abs(th) > 1.3 or abs(x) > 6.0 or z > 8.0:
            fell = 1
            break
    return out[: max(rows, 1)], fell


@dataclass(frozen=True)
class Quad:
    """A quadrotor in a plane, sent sideways and up by a cascade of position and attitude loops."""

    added: Choice = ()
    deterministic = True
    duration = DUR
    cost = 1.5e-3
    channels = CHANNELS
    parameters = PARAMETERS

    @property
    def name(self) -> str:
        return ":".join(filter(None, ("quad", ",".join(words(self.added)))))

    @property
    def model_hash(self) -> str:
        source = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("s2r_quad*.py")))
        return hashlib.sha256(repr(self.added).encode() + source).hexdigest()

    def effects(self) -> tuple[Effect, ...]:
        return CATALOGUE

    def with_effects(self, values: Values) -> Quad:
        return replace(self, added=choose("quad", CATALOGUE, self.added, values))

    def chosen(self) -> dict[str, dict[str, float]]:
        return as_values(self.added)

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        dx, height, fan = (p.check(params.get(p.name, p.default)) for p in PARAMETERS)
        rng = np.random.default_rng(seed)
        once, gust, meas = rng.normal(size=5), rng.normal(size=(N, 2)), rng.normal(size=(N, 6))
        return self._trace(*_fly(dx, height, fan, self._effects, meas, gust, once), TC * EVERY)

    def protocols(self) -> tuple[Protocol, ...]:
        return PROTOCOLS

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        values = named(PROTOCOLS, protocol, self.name).values(params)
        planned, rng = plan(protocol, values["amplitude"]), np.random.default_rng(seed)
        once, gust = rng.normal(size=5), rng.normal(size=(len(planned), 2))
        meas = rng.normal(size=(len(planned), 6))
        found = _flight(planned, 0.0, self._effects, meas, gust, once, values["gain"], 1)
        return self._trace(*found, TC, {PROTOCOL: protocol, "params": values, "seed": seed})

    @property
    def _effects(self) -> tuple[float, ...]:
        chosen = settings(CATALOGUE, self.added)
        return tuple(float(chosen.get(e, {}).get(p, v)) for e, p, v in ORDER)

    def _trace(self, out: Array, fell: int, period: float, meta: Mapping[str, Any] | None = None) -> Trace:
        units = {c.name: c.unit for c in CHANNELS}
        channels = dict(zip(units, out.T.copy(), strict=True))
        failure = {"failure": "crashed"} if fell else {}
        return Trace(period * np.arange(len(out)), channels, units, {**(meta or {}), **failure})


def quad(options: str = "") -> Quad:
    """Return the quadrotor with the effects that ``options`` say: words ``effect.parameter=value``."""
    backend = Quad()
    for word in filter(None, options.split(",")):
        values = read_word(word)
        if values is None:
            raise UsageError(f"quad has no option {word!r}")
        backend = backend.with_effects(values)
    return backend
