"""A car that makes a double lane change: dynamic bicycle, linear tyres."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numba
import numpy as np
from s2r_car_protocols import PROTOCOLS, plan

from s2r_spec import Trace
from s2r_spec.backend import Channel, Effect, EffectParameter, Parameter
from s2r_spec.effects import Choice, as_values, choose, settings
from s2r_spec.protocols import PROTOCOL, named

P = EffectParameter
CATALOGUE = (
    Effect("front_grip", "tyres", "The front tyres have this part of their cornering stiffness.", (
        P("factor", "", low=0.5, high=1.6, nominal=1.0, prior="normal around 1, standard deviation 0.1"),)),
    Effect("rear_grip", "tyres", "The rear tyres have this part of their cornering stiffness.", (
        P("factor", "", low=0.5, high=1.6, nominal=1.0, prior="normal around 1, standard deviation 0.1"),)),
    Effect("mass", "inertia", "The car is heavier than the papers say.", (
        P("extra", "kg", low=-300.0, high=600.0, nominal=0.0, prior="normal, 100 kg"),)),
    Effect("steer_delay", "timing", "The steering command arrives this much later.", (
        P("time", "s", low=0.0, high=0.15, nominal=0.0, prior="half-normal, 0.03 s"),)),
    Effect("steer_lag", "actuation", "The steering motor follows its command with this time constant. A part of it may "
        "be dead time, as of a lag of several stages.", (
        P("time", "s", low=0.0, high=0.2, nominal=0.0, prior="half-normal, 0.03 s"),
        P("dead", "", low=0.0, high=0.8, nominal=0.0, prior="half-normal, 0.25"),)),
    Effect("steer_offset", "actuation", "The wheels point this much to the left when straight is asked for.", (
        P("angle", "rad", low=-0.05, high=0.05, nominal=0.0, prior="normal, 0.005 rad"),)),
    Effect("drag", "friction", "Air holds the car back more than the drawing says.", (
        P("coefficient", "N*s^2/m^2", low=0.0, high=3.0, nominal=0.0, prior="half-normal, 0.3 N*s^2/m^2"),)),
    Effect("drive_strength", "actuation", "The drive makes this part of the force that is asked for.", (
        P("factor", "", low=0.5, high=1.3, nominal=1.0, prior="normal around 1, standard deviation 0.1"),)),
    Effect("yaw_bias", "sensing", "The yaw-rate gyro is off by this much.", (
        P("rate", "rad/s", low=-0.1, high=0.1, nominal=0.0, prior="normal, 0.01 rad/s"),)),
    Effect("position_bias", "sensing", "The lateral position fed back is off by this much.", (
        P("distance", "m", low=-0.6, high=0.6, nominal=0.0, prior="normal, 0.08 m"),)),
    Effect("side_wind", "load", "Wind pushes from the right.", (
        P("force", "N", low=-2000.0, high=2000.0, nominal=0.0, prior="normal, 250 N"),)),
)  # fmt: skip

DURATION, TICK = 6.0, 0.02
COLUMNS = ("y_ref", "v_ref", "y", "y_m", "psi_m", "v_m", "r_m", "ay_m", "steer_cmd", "steer_m", "force_cmd")
UNITS = ("m", "m/s", "m", "m", "rad", "m/s", "rad/s", "m/s^2", "rad", "rad", "N")
TOLD = (
    "lateral position asked for", "speed asked for", "lateral position by motion capture",
    "lateral position fed back", "heading fed back", "speed fed back", "yaw rate by the gyro",
    "lateral acceleration by the IMU", "steering angle that the controller asks for",
    "steering angle measured at the rack", "drive force that the controller asks for",
)  # fmt: skip


@numba.njit(cache=True)
def reference(t, offset):
    """Lateral position, speed and acceleration asked for: out in 2 s, 0.6 s there, back in 2 s."""
    sign, s = 0.0, 0.0
    if 0.5 < t < 2.5:
        sign, s = 1.0, (t - 0.5) / 2.0
    elif 2.5 <= t <= 3.1:
        return offset, 0.0, 0.0
    elif 3.1 < t < 5.1:
        sign, s = -1.0, (t - 3.1) / 2.0
    y = s**3 * (10 - 15 * s + 6 * s * s)
    yd = 30 * s * s * (1 - s) ** 2 / 2.0
    ydd = 60 * s * (1 - s) * (1 - 2 * s) / 4.0
    if sign < 0:
        y = 1.0 - y
    return offset * y if sign != 0 else 0.0, offset * sign * yd, offset * sign * ydd


@numba.njit(cache=True)
def lane_change(speed, offset):
    """What a test asks for, as `s2r_car_protocols.plan` has it of a protocol."""
    commanded = np.zeros((round(DURATION / TICK) + 1, 7))
    for k in range(commanded.shape[0]):
        t = k * TICK
        commanded[k, 0], commanded[k, 1], commanded[k, 2] = reference(t, offset)
        commanded[k, 3] = speed + min(max(t - 1.0, 0.0), 2.0)
    return commanded


@numba.njit(cache=True)
def controller(commanded, gain, y_m, psi_m, v_m, r_m, integral):
    """Steering angle, drive force, and the new integral of the speed error."""
    y_ref, yd, ydd, v_ref, added, given, made = commanded
    v = max(v_m, 5.0)
    per_ay = 2.7 / v**2 + 0.0024
    ay = ydd + gain * 4.0 * (y_ref - y_m) + np.sqrt(gain) * 3.0 * (yd - v * psi_m)
    steer = per_ay * ay + 0.15 * (ydd / v - r_m) + added
    steer = min(max(steer, -0.35), 0.35)
    if given:
        return steer, made, integral, y_ref, v_ref
    error = v_ref - v_m
    integral += TICK * error
    force = min(max(3000.0 * error + 1500.0 * integral, -6000.0), 4000.0)
    return steer, force, integral, y_ref, v_ref


@numba.njit(cache=True)
def simulate(commanded, gain, payload, start, noise, e, per_tick):
    """Rows of a log, and whether the car spun; `commanded` is a test's or a protocol's, `gain` that of lane keeping."""
    front, rear, mass_extra, delay, lag, dead, bend, drag, strength, gyro, gps, wind = e
    delay, lag = delay + dead * lag, (1.0 - dead) * lag
    h = TICK / per_tick
    ticks = noise.shape[0]
    m = 1500.0 + payload + mass_extra
    iz = 2500.0 * (1 + 0.5 * (payload + mass_extra) / 1500.0)
    lf, lr, cf, cr = 1.2, 1.5, 90e3 * front, 110e3 * rear
    y, psi, vx, vy, r = start[0], start[1], commanded[0, 3] + start[2], 0.0, 0.0
    delta, ay, integral = 0.0, 0.0, 0.0
    sent = np.zeros(ticks * per_tick)
    keep = 1.0 if lag < 1e-9 else 1.0 - np.exp(-h / lag)
    out = np.zeros((ticks, 11))
    for k in range(ticks):
        n = noise[k]
        y_m, psi_m, v_m = y + gps + 0.02 * n[0], psi + 0.003 * n[1], vx + 0.05 * n[2]
        r_m, ay_m = r + gyro + 0.005 * n[3], ay + 0.15 * n[4]
        steer, force, integral, y_ref, v_ref = controller(commanded[k], gain, y_m, psi_m, v_m, r_m, integral)
        row = out[k]
        row[0], row[1], row[2], row[3], row[4], row[5] = y_ref, v_ref, y + 0.002 * n[5], y_m, psi_m, v_m
        row[6], row[7], row[8], row[9], row[10] = r_m, ay_m, steer, delta + 0.001 * n[6], force
        if abs(y) > 15 or abs(vy) > 8:
            return out[: k + 1], True
        for j in range(per_tick):
            i = k * per_tick + j
            sent[i] = steer
            late = i - delay / h
            low = int(np.floor(late))
            part = late - low
            a = sent[low] if low >= 0 else 0.0
            b = sent[min(low + 1, i)] if low + 1 >= 0 else 0.0
            arrived = a + part * (b - a)
            delta += keep * (arrived - delta)
            wheel = delta + bend
            ff = cf * (wheel - (vy + lf * r) / vx)
            fr = -cr * (vy - lr * r) / vx
            ay = (ff + fr + wind) / m
            fx = strength * force - (0.4 + drag) * vx * vx - 150.0
            vx += h * (fx - ff * wheel) / m
            vy += h * (ay - vx * r)
            r += h * (lf * ff - lr * fr) / iz
            psi += h * r
            y += h * (vx * np.sin(psi) + vy * np.cos(psi))
    return out, False


@dataclass(frozen=True)
class Car:
    """A car that makes a double lane change."""

    added: Choice = ()
    per_tick: int = 4
    loud: float = 1.0
    name = "car"
    channels = tuple(Channel(n, u, d) for n, u, d in zip(COLUMNS, UNITS, TOLD, strict=True))
    parameters = (
        Parameter("speed", "m/s", 10.0, 25.0, 18.0, "at the begin; 2 m/s more from 1 to 3 s"),
        Parameter("offset", "m", 0.5, 3.5, 2.5, "of the other lane"),
        Parameter("payload", "kg", 0.0, 400.0, 0.0, "in the middle of the car"),
    )
    deterministic, duration, cost = True, DURATION, 1e-3

    @property
    def model_hash(self):
        text = "".join(path.read_text() for path in sorted(Path(__file__).parent.glob("s2r_car*.py")))
        text += repr((self.added, self.per_tick, self.loud))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def effects(self):
        return CATALOGUE

    def with_effects(self, values):
        return replace(self, added=choose(self.name, CATALOGUE, self.added, values))

    def chosen(self):
        return as_values(self.added)

    def variants(self):
        return {"half step": replace(self, per_tick=8), "loud sensors": replace(self, loud=2.0)}

    def rollout(self, params, seed):
        speed, offset, payload = (p.check(params.get(p.name, p.default)) for p in self.parameters)
        return self._drive(lane_change(speed, offset), 1.0, payload, seed, {})

    def protocols(self):
        return PROTOCOLS

    def run(self, protocol, params, seed):
        values = named(PROTOCOLS, protocol, self.name).values(params)
        meta = {PROTOCOL: protocol, "params": dict(values), "seed": seed}
        gain = values.pop("gain")
        return self._drive(plan(protocol, **values), gain, 0.0, seed, meta)

    def _drive(self, commanded, gain, payload, seed, meta):
        chosen = settings(CATALOGUE, self.added)
        e = tuple(
            float(chosen.get(x.name, {}).get(p.name, p.nominal)) for x in CATALOGUE for p in x.parameters
        )
        rng = np.random.default_rng(seed)
        start = rng.normal(size=3) * (0.02, 0.003, 0.1)
        noise = self.loud * rng.normal(size=(len(commanded), 7))
        rows, spun = simulate(commanded, gain, payload, start, noise, e, self.per_tick)
        return Trace(
            TICK * np.arange(len(rows)),
            dict(zip(COLUMNS, rows.T, strict=True)),
            dict(zip(COLUMNS, UNITS, strict=True)),
            {**meta, "failure": "spun"} if spun else meta,
        )  # fmt: skip
