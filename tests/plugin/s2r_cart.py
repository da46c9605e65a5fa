"""A cart on a rail with a DC motor: a backend with effects that takes a millisecond a rollout.

:class:`Cart` is the simulator, with its catalogue. :func:`real` is the machine:
another integrator at a quarter of the step, other laws for the same effects,
five percent of all the others, and effects that the catalogue does not have.
Both loops are compiled: half the time of every test of a diagnosis was theirs.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field, replace

import numpy as np

from s2r_spec.backend import Channel, Effect, EffectParameter, Parameter
from s2r_spec.compiled import compiled
from s2r_spec.trace import Trace

MASS, DAMPING, FORCE = 2.0, 1.0, 1.0  # kg, N s/m, N/V
GAIN, STEP, DURATION = 12.0, 0.01, 2.0  # V s/m, s, s
VOLTAGE = 12.0  # V

SPEC = """
param  vd {m/s} in [0.2, 1]
param  acc {m/s^2} in [1, 4]
signal v {m/s}
signal v_ref {m/s}

let tracks := abs(v - v_ref) <= 0.25 {m/s}
require tracking: always[0, 1.99 s] (tracks)
certify tracking: delta = 0.1, epsilon = 0.05, B = 1, R = 0.05, kernel = rbf(0.5), fall = -1
"""

NAMES = {
    "viscous": ("actuation", "coefficient", "N*s/m", 0.0, 4.0, 0.0, "half-normal, 1 N*s/m"),
    "coulomb": ("actuation", "force", "N", 0.0, 3.0, 0.0, "half-normal, 0.7 N"),
    "payload": ("inertia", "mass", "kg", 0.0, 3.0, 0.0, "half-normal, 0.7 kg"),
    "motor": ("actuation", "factor", "", 0.5, 1.5, 1.0, "normal around 1, standard deviation 0.15"),
    "tilt": ("terrain", "force", "N", -4.0, 4.0, 0.0, "normal, 1 N"),
    "delay": ("timing", "delay", "s", 0.0, 0.08, 0.0, "half-normal, 0.02 s"),
    "speed_scale": ("sensing", "factor", "", 0.7, 1.3, 1.0, "normal around 1, standard deviation 0.1"),
}
EFFECTS = tuple(
    Effect(name, family, f"{name}.", (EffectParameter(p, unit, low, high, nominal, prior),))
    for name, (family, p, unit, low, high, nominal, prior) in NAMES.items()
)
NOMINAL = {name: row[5] for name, row in NAMES.items()}


@compiled
def reference(vd: float, acc: float, t: float) -> float:
    """Up to vd, hold, and back through zero to −vd."""
    return max(min(vd, acc * t), -vd) if t < 1.0 else max(vd - acc * (t - 1.0), -vd)


@compiled
def simulated(vd, acc, v, noise, effects, limit):
    """Return (ticks, 4) of v, v_ref, v_meas and u from a first v and noise (2, ticks) of the meter and the force.

    ``effects`` are the values of ``NAMES``, in this order.
    """
    viscous, coulomb, payload, motor, tilt, delay, speed_scale = effects
    ticks = noise.shape[1]
    late = round(delay / STEP)
    mass = MASS + payload
    rows, sent = np.zeros((ticks, 4)), np.zeros(ticks)
    for k in range(ticks):
        ref = reference(vd, acc, k * STEP)
        measured = speed_scale * v + 0.005 * noise[0, k]
        u = GAIN * (ref - measured) + DAMPING * ref
        u = max(-limit, min(limit, u))
        rows[k] = v, ref, measured, u
        sent[k] = u
        acting = sent[k - late] if k >= late else 0.0
        force = motor * FORCE * acting + tilt + 0.1 * noise[1, k]
        v += STEP / mass * (force - (DAMPING + viscous) * v)
        stop = STEP / mass * coulomb
        v = math.copysign(max(abs(v) - stop, 0.0), v)
    return rows


@compiled
def recorded(vd, acc, v, noise, effects, mass, limit, extra, start):
    """Return (ticks, 4) of what the machine does. ``noise``: (3, ticks) of the meter, the delay and the force."""
    viscous, coulomb, _, motor, tilt, delay, speed_scale = effects
    ticks, sub, h = noise.shape[1], 4, STEP / 4
    x, y, w, acting = 0.0, 0.0, 0.0, 0.0
    rows, due = np.zeros((ticks, 4)), np.zeros(ticks)
    for k in range(ticks):
        t = k * STEP
        ref = reference(vd, acc, t)
        measured = speed_scale * v + 0.005 * noise[0, k]
        u = max(-limit, min(limit, GAIN * (ref - measured) + DAMPING * ref))
        rows[k] = v, ref, measured, u
        due[k] = t + delay * (1 + 0.2 * noise[1, k]) if delay > 0 else t
        kick = 0.1 * noise[2, k]
        for i in range(sub):
            now = t + i * h
            acting = 0.0
            for j in range(k, max(k - 40, 0) - 1, -1):  # the last 40 commands wait, and this one
                if due[j] <= now + 1e-9:
                    acting = rows[j, 3]
                    break
            force = motor * FORCE * acting + tilt + kick
            force -= (DAMPING + viscous * (0.9 + 0.2 * abs(v))) * v
            force -= coulomb * math.tanh(v / 0.02)
            if extra == "bump":
                force -= 25.0 * math.exp(-(((x - 0.25) / 0.04) ** 2)) * math.tanh(v / 0.02)
            if extra == "gust" and start < now < start + 0.3:
                force += 6.0
            if extra == "flexible":
                pull = 60.0 * (y - x) + 0.5 * (w - v)
                w -= h / 1.5 * pull
                y += h * w
                force += pull
            v += h / mass * force
            x += h * v
    return rows


def cart(options: str = ""):
    """Return the cart, or with ``cart:real.coulomb=1.5`` the machine with that effect."""
    if options.startswith("real"):
        words = dict(word.split("=") for word in options.removeprefix("real").strip(".").split(",") if word)
        return Machine(tuple((name, float(value)) for name, value in words.items()))
    return Cart()


@dataclass(frozen=True)
class Cart:
    added: tuple[tuple[str, float], ...] = ()
    limit: float = VOLTAGE
    duration: float = DURATION
    deterministic: bool = True
    cost: float = 1e-3
    channels: tuple[Channel, ...] = field(
        default=(
            Channel("v", "m/s", "speed"),
            Channel("v_ref", "m/s", "wanted"),
            Channel("v_meas", "m/s", "measured"),
            Channel("u", "V", "motor voltage"),
        ),
        repr=False,
    )
    parameters: tuple[Parameter, ...] = field(
        default=(
            Parameter("vd", "m/s", 0.0, 1.5, 0.5, "speed"),
            Parameter("acc", "m/s^2", 0.5, 6.0, 2.0, "acceleration"),
        ),
        repr=False,
    )

    @property
    def name(self) -> str:
        return "cart" + (":" + ",".join(f"{n}={v!r}" for n, v in self.added) if self.added else "")

    @property
    def model_hash(self) -> str:
        return hashlib.sha256(repr(self.added).encode()).hexdigest()

    def effects(self):
        return EFFECTS

    def chosen(self):
        names = {e.name: e.parameters[0].name for e in EFFECTS}
        return {name: {names[name]: value} for name, value in self.added}

    def with_effects(self, values):
        merged = dict(self.added) | {name: next(iter(of.values())) for name, of in values.items()}
        return replace(self, added=tuple(sorted((n, v) for n, v in merged.items() if v != NOMINAL[n])))

    def rollout(self, params, seed):
        e = NOMINAL | dict(self.added)
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=(2, round(self.duration / STEP)))
        v = 0.02 * float(rng.normal())
        values = tuple(float(e[name]) for name in NAMES)
        rows = simulated(float(params["vd"]), float(params["acc"]), v, noise, values, float(self.limit))
        return Trace(
            STEP * np.arange(len(rows)),
            dict(zip(("v", "v_ref", "v_meas", "u"), rows.T.copy(), strict=True)),
            {c.name: c.unit for c in self.channels},
        )


@dataclass(frozen=True)
class Machine(Cart):
    """The machine as a backend, with the effects that it has."""

    truth: tuple[tuple[str, float], ...] = ()

    def __init__(self, truth=()) -> None:
        super().__init__()
        object.__setattr__(self, "truth", truth)

    @property
    def name(self) -> str:
        return "cart:real." + ",".join(f"{n}={v!r}" for n, v in self.truth)

    def rollout(self, params, seed):
        return real(params, seed % 2**32, dict(self.truth))


def real(params, seed, effects, background=0.05, extra=None, limit=VOLTAGE):
    """Return what the machine records. ``effects``: name → value, as in the catalogue.

    ``extra`` is an effect that the catalogue lacks: "bump" (a place where it
    sticks), "flexible" (a load on a spring), "gust".
    """
    rng = np.random.default_rng(seed)
    e = dict(NOMINAL)
    nuisance = np.random.default_rng(seed // 1000)  # the same for all rollouts of a case
    for name, row in NAMES.items():
        e[name] += (
            background * 0.4 * (row[4] - row[5]) * float(nuisance.uniform(0 if row[3] == row[5] else -1, 1))
        )
    e |= effects
    ticks = round(DURATION / STEP)
    v = 0.02 * float(rng.normal())
    mass = (MASS + e["payload"]) * (1 + 0.01 * float(nuisance.normal()))
    start = 0.4 + 0.6 * rng.random()
    late = e["delay"] > 0
    drawn = rng.normal(size=(ticks, 2 + late)).T  # a tick after the other
    noise = np.array([drawn[0], drawn[1] if late else np.zeros(ticks), drawn[-1]])
    values = tuple(float(e[name]) for name in NAMES)
    vd, acc = float(params["vd"]), float(params["acc"])
    rows = recorded(vd, acc, v, noise, values, mass, float(limit), extra or "", start)
    return Trace(
        STEP * np.arange(ticks),
        dict(zip(("v", "v_ref", "v_meas", "u"), rows.T.copy(), strict=True)),
        {"v": "m/s", "v_ref": "m/s", "v_meas": "m/s", "u": "V"},
    )
