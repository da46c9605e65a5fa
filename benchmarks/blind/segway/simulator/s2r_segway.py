"""Two-wheeled self-balancing robot: LQR on a complementary filter's tilt; backend `segway`."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numba import njit
from s2r_segway_protocols import PROTOCOLS, plan
from scipy.linalg import expm, solve_discrete_are

from s2r_spec import Trace
from s2r_spec.backend import Channel, Effect, EffectParameter, Parameter
from s2r_spec.effects import Choice, as_values, choose, settings
from s2r_spec.errors import TraceError
from s2r_spec.protocols import PROTOCOL, named

G, DT, SUB, DURATION = 9.81, 0.01, 10, 8.0
M_BODY, HEIGHT, J_BODY = 12.0, 0.25, 0.30  # kg, m, kg*m^2 about its centre
M_WHEELS, J_WHEELS, RADIUS = 2.0, 0.012, 0.10
CARGO_HEIGHT, IMU_HEIGHT, LIMIT, FILTER = 0.40, 0.10, 8.0, 2.0
TICKS = round(DURATION / DT)


def _gains():
    m, ml, j = M_BODY, M_BODY * HEIGHT, J_BODY + M_BODY * HEIGHT**2
    mass = np.array([[m + M_WHEELS + J_WHEELS / RADIUS**2, ml], [ml, j]])
    inv = np.linalg.inv(mass)
    a, b = np.zeros((4, 4)), np.zeros((4, 1))
    a[0, 1] = a[2, 3] = 1.0
    a[1, 2], a[3, 2] = inv @ np.array([0.0, ml * G])
    b[1, 0], b[3, 0] = inv @ np.array([1 / RADIUS, -1.0])
    big = expm(np.block([[a, b], [np.zeros((1, 5))]]) * DT)
    ad, bd = big[:4, :4], big[:4, 4:]
    q, r = np.diag([4.0, 4.0, 30.0, 1.0]), np.array([[0.4]])
    p = solve_discrete_are(ad, bd, q, r)
    return np.linalg.solve(r + bd.T @ p @ bd, bd.T @ p @ ad)[0]


K = _gains()
INERTIA = M_BODY + M_WHEELS + J_WHEELS / RADIUS**2

CATALOGUE = (
    Effect("rolling_friction", "friction", "The tyres roll with a resistance of this force against any motion.", (
        EffectParameter("force", "N", 0.0, 15.0, 0.0, "half-normal, 2.5 N"),)),
    Effect("viscous_friction", "friction", "Bearings and grease hold the wheels back in proportion to their speed.", (
        EffectParameter("coefficient", "N*s/m", 0.0, 25.0, 0.0, "half-normal, 3.5 N*s/m"),)),
    Effect("motor_strength", "actuation", "The motors make this part of the torque that is asked for.", (
        EffectParameter("factor", "", 0.5, 1.3, 1.0, "normal around 1, standard deviation 0.1"),)),
    Effect("battery_sag", "actuation", "At full command this part of the torque is lost, below in proportion.", (
        EffectParameter("drop", "", 0.0, 0.8, 0.0, "half-normal, 0.2"),)),
    Effect("latency", "timing", "Commands reach the motors this much later.", (
        EffectParameter("delay", "s", 0.0, 0.03, 0.0, "half-normal, 0.006 s"),)),
    Effect("dead_zone", "transmission", "Commands below this torque move nothing: play and stiction in the gears.", (
        EffectParameter("torque", "N*m", 0.0, 0.8, 0.0, "half-normal, 0.15 N*m"),)),
    Effect("extra_mass", "load", "The body is heavier than the drawing says, at the height of its centre.", (
        EffectParameter("mass", "kg", -3.0, 6.0, 0.0, "normal, 1 kg"),)),
    Effect("com_height", "load", "The body's centre of mass is higher than the drawing says.", (
        EffectParameter("shift", "m", -0.08, 0.1, 0.0, "normal, 0.02 m"),)),
    Effect("slope", "ground", "The floor rises in the direction of travel.", (
        EffectParameter("angle", "deg", -4.0, 4.0, 0.0, "normal, 1 deg"),)),
    Effect("gyro_bias", "sensing", "The gyro reads this much too much.", (
        EffectParameter("rate", "rad/s", -0.08, 0.08, 0.0, "normal, 0.015 rad/s"),)),
    Effect("accelerometer_offset", "sensing", "The accelerometer's forward axis reads this much too much.", (
        EffectParameter("offset", "m/s^2", -1.0, 1.0, 0.0, "normal, 0.2 m/s^2"),)),
    Effect("wheel_radius", "geometry", "The wheels have this part of the radius that the controller believes.", (
        EffectParameter("factor", "", 0.85, 1.15, 1.0, "normal around 1, standard deviation 0.03"),)),
)  # fmt: skip


@dataclass(frozen=True)
class Physics:
    force: float = 0.0
    viscous: float = 0.0
    strength: float = 1.0
    sag: float = 0.0
    delay: float = 0.0
    dead: float = 0.0
    mass: float = 0.0
    shift: float = 0.0
    angle: float = 0.0
    bias: float = 0.0
    offset: float = 0.0
    wheel: float = 1.0
    cargo: float = 0.0

    def numbers(self):
        body = M_BODY + self.mass
        height = HEIGHT + self.shift
        m = body + self.cargo
        ml = body * height + self.cargo * CARGO_HEIGHT
        j = J_BODY + body * height**2 + self.cargo * CARGO_HEIGHT**2
        return np.array([self.force, self.viscous, self.strength, self.sag, self.delay, self.dead, m, ml, j,
                         np.deg2rad(self.angle), self.bias, self.offset, RADIUS * self.wheel])  # fmt: skip


FIELD = {"rolling_friction": "force", "viscous_friction": "viscous", "motor_strength": "strength", "battery_sag": "sag",
         "latency": "delay", "dead_zone": "dead", "extra_mass": "mass", "com_height": "shift", "slope": "angle",
         "gyro_bias": "bias", "accelerometer_offset": "offset", "wheel_radius": "wheel"}  # fmt: skip


@lru_cache(maxsize=512)
def profile(cruise, accel):
    """(ticks,) acceleration, speed and place asked for: up from 0.5 s on, 1.5 s of cruise, and down again."""
    t = DT * np.arange(TICKS + 1)
    rise = cruise / accel
    jerk = 0.3  # s, smoothing of the acceleration
    a = accel * (((t >= 0.5) & (t < 0.5 + rise)).astype(float) - ((t >= 2.0 + rise) & (t < 2.0 + 2 * rise)))
    edges = np.cumsum(np.concatenate([[0.0], a])) * DT  # exact area
    v = edges[:-1]
    n = int(jerk / DT)
    v = np.convolve(np.concatenate([np.zeros(n), v]), np.ones(n) / n, "full")[n : n + t.size]
    a = np.gradient(v, DT)
    x = np.cumsum(v) * DT
    return np.ascontiguousarray(a), v, x


@njit(cache=True)
def _run(p, k, commanded, held, rolls, tilt0, noise, sway, sub):
    """Rows of a log, and the row of a fall or -1; `commanded` is (ticks + 1, 4), and `rolls` the speed at the begin."""
    force, viscous, strength, sag, delay, dead, m, ml, j, slope, bias, offset, r = p
    h = 0.01 / sub
    ticks = commanded.shape[0] - 1
    total = m + 2.0
    out = np.zeros((ticks + 1, 9))
    commands = np.zeros(ticks + 1)
    x, v, th, om, xe, the, acc = 0.0, rolls, tilt0, 0.0, 0.0, tilt0, -9.81 * tilt0
    fallen = -1
    for i in range(ticks + 1):
        a_ref, v_ref, x_ref, added = commanded[i]
        gyro = om + bias + noise[i, 0]
        f = acc + offset + noise[i, 1]
        w = v / r - om + noise[i, 2]
        the = the + 0.01 * gyro + 0.01 / 2.0 * (-(f - a_ref) / 9.81 - the)
        ve = 0.10 * (w + gyro)
        xe += 0.01 * ve
        tau0 = 15.2 * a_ref * 0.10
        th_ref = (3.0 * a_ref + tau0) / (3.0 * 9.81)
        u = tau0 - k[0] * (xe - x_ref) - k[1] * (ve - v_ref) - k[2] * (the - th_ref) - k[3] * gyro
        u = added if held else u + added
        u = min(max(u, -8.0), 8.0)
        commands[i] = u
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = u, w, gyro, the
        out[i, 4], out[i, 5], out[i, 6] = v + noise[i, 3], th + noise[i, 4], f
        out[i, 7], out[i, 8] = v_ref, xe - x_ref
        if abs(th) > 0.8:
            fallen = i
            break
        for s in range(sub):
            # the share of this substep that each of two commands covers
            at = (i * sub + s) - delay / h
            lo = int(np.floor(at))
            part = at - lo  # of the step, the newer one
            old = commands[max(lo // sub, 0)] if lo >= 0 else 0.0
            new = commands[max((lo + 1) // sub, 0)] if lo + 1 >= 0 else 0.0
            c = (1.0 - part) * old + part * new
            c = np.sign(c) * max(abs(c) - dead, 0.0)
            tau = strength * c * (1.0 - sag * abs(c) / 8.0)
            push = tau / r - force * np.tanh(v / 0.02) - viscous * v - total * 9.81 * np.sin(slope) + sway[i]
            co, si = np.cos(th + slope), np.sin(th + slope)
            b1 = push + ml * si * om * om
            b2 = ml * 9.81 * np.sin(th) - tau
            a11 = total + 0.012 / (r * r)
            det = a11 * j - (ml * co) ** 2
            xa = (j * b1 - ml * co * b2) / det
            ta = (a11 * b2 - ml * co * b1) / det
            if held:  # what holds the body upright takes the motors' torque
                xa, ta = b1 / a11, 0.0
            v += h * xa
            om += h * ta
            x += h * v
            th += h * om
            acc = xa * co + 0.10 * ta - 9.81 * np.sin(th)
    return out, fallen


NAMES = (("u", "N*m", "motor torque asked for"), ("wheel_speed", "rad/s", "wheel against body, by the encoder"),
         ("tilt_rate", "rad/s", "by the gyro"), ("tilt_est", "rad", "tilt by the complementary filter"),
         ("speed", "m/s", "by motion capture"), ("tilt", "rad", "by motion capture, positive forwards"),
         ("acc", "m/s^2", "accelerometer, forward axis"), ("v_ref", "m/s", "speed asked for"),
         ("x_err", "m", "odometer less place asked for"))  # fmt: skip


@dataclass(frozen=True)
class Segway:
    """A two-wheeled balancing robot that drives off, cruises and stops."""

    added: Choice = ()
    quirk: str = ""
    name = "segway"
    channels = tuple(Channel(*row) for row in NAMES)
    parameters = (
        Parameter("cruise", "m/s", 0.2, 1.2, 0.8, "speed to reach"),
        Parameter("accel", "m/s^2", 0.4, 1.2, 0.8, "acceleration to get there, and to stop"),
        Parameter("cargo", "kg", 0.0, 3.0, 1.0, "declared load, 0.4 m above the axle"),
    )
    deterministic, duration, cost = True, DURATION, 2e-3

    @property
    def model_hash(self):
        return f"segway-1 {self.added} {self.quirk}"

    def effects(self):
        return CATALOGUE

    def with_effects(self, values):
        return replace(self, added=choose(self.name, CATALOGUE, self.added, values))

    def chosen(self):
        return as_values(self.added)

    def variants(self):
        return {"half the step": replace(self, quirk="fine"), "twice the noise": replace(self, quirk="loud")}

    def _physics(self, params):
        chosen = settings(CATALOGUE, self.added)
        figures = {FIELD[e]: next(iter(v.values())) for e, v in chosen.items()}
        return Physics(**figures, cargo=self.parameters[2].check(params.get("cargo", 1.0))).numbers()

    def rollout(self, params, seed):
        cruise = self.parameters[0].check(params.get("cruise", 0.8))
        accel = self.parameters[1].check(params.get("accel", 0.8))
        commanded = np.zeros((TICKS + 1, 4))
        commanded[:, :3] = np.column_stack(profile(cruise, accel))
        return self._ride(commanded, self._physics(params), seed, False, 0.0, {})

    def protocols(self):
        return PROTOCOLS

    def run(self, protocol, params, seed):
        values = named(PROTOCOLS, protocol, self.name).values(params)
        rolls = values["amplitude"] if protocol == "held_coast" else 0.0
        commanded, held = plan(protocol, values["amplitude"]), protocol.startswith("held")
        meta = {PROTOCOL: protocol, "params": values, "seed": seed}
        return self._ride(commanded, self._physics(values), seed, held, rolls, meta)

    def _ride(self, commanded, p, seed, held, rolls, meta):
        rng, rows = np.random.default_rng(seed), len(commanded)
        loud = 2.0 if self.quirk == "loud" else 1.0
        tilt0 = 0.01 * rng.normal() * (not held)
        noise = rng.normal(size=(rows, 5)) * np.array([0.01, 0.15, 0.05, 0.01, 0.002]) * loud
        white = rng.normal(size=rows)
        sway = np.zeros(rows)  # N, unevenness of the floor, 0.2 s
        for i in range(1, rows):
            sway[i] = 0.95 * sway[i - 1] + 0.2 * loud * white[i]
        sub = SUB * (2 if self.quirk == "fine" else 1)
        out, fallen = _run(p, K, commanded, held, rolls, tilt0, noise, sway, sub)
        n = rows if fallen < 0 else fallen + 1
        channels = {row[0]: out[:n, c] for c, row in enumerate(NAMES)}
        units = {row[0]: row[1] for row in NAMES}
        return Trace(DT * np.arange(n), channels, units, {**meta, "failure": "fall"} if fallen >= 0 else meta)

    def residuals(self, trace, params=None):
        need = {"u", "speed", "tilt", "tilt_rate", "wheel_speed", "acc"}
        have = set(trace.channels)
        if not {"speed", "tilt"} <= have or not have & {"u", "tilt_rate", "wheel_speed", "acc"}:
            raise TraceError(f"residuals need {sorted(need)}, but the trace has {sorted(have)}")
        t = trace.times
        dt = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
        half = round(0.12 / dt) if dt else 0
        if len(t) < 6 * half + 10 or not np.allclose(np.diff(t), dt, rtol=0, atol=0.05 * dt):
            raise TraceError("residuals need an evenly sampled trace of more than 0.8 s")
        force, viscous, strength, sag, delay, dead, m, ml, j, slope, bias, offset, r = self._physics(
            params or {}
        )
        ramp = np.arange(-half, half + 1) * dt
        kernel = np.exp(-0.5 * (ramp / 0.04) ** 2)
        kernel /= kernel.sum()
        slope_kernel = -np.gradient(kernel, dt)  # convolve: derivative of the smooth signal

        def smooth(y):
            return np.convolve(y, kernel, "valid")

        def rate(y):
            return -np.convolve(y, slope_kernel, "valid")

        times = t[half:-half]
        v, vdot = smooth(trace["speed"]), rate(trace["speed"])
        th, om = smooth(trace["tilt"]), rate(trace["tilt"])
        acc_th = np.gradient(om, dt)
        if "tilt_rate" in have:
            acc_th = rate(trace["tilt_rate"])
        co = np.cos(th + slope)
        channels, units, parts = {}, {}, {}

        def put(name, unit, part, y):
            channels[name], units[name], parts[name] = y[3:-3], unit, [part]

        if "u" in have:
            c = np.interp(t - delay - 0.5 * DT, t, trace["u"])
            c = np.sign(c) * np.maximum(np.abs(c) - dead, 0.0)
            tau = smooth(strength * c * (1.0 - sag * np.abs(c) / LIMIT))
            total = m + M_WHEELS
            drive = (total + J_WHEELS / r**2) * vdot + ml * (co * acc_th - np.sin(th + slope) * om**2)
            given = (
                tau / r
                - force * smooth(np.tanh(trace["speed"] / 0.02))
                - viscous * v
                - total * G * np.sin(slope)
            )
            put("force", "N", "wheels", drive - given)
            if not str(trace.meta.get(PROTOCOL, "")).startswith("held"):
                put("torque", "N*m", "body", j * acc_th + ml * co * vdot - ml * G * np.sin(th) + tau)
        if "tilt_rate" in have:
            put("gyro", "rad/s", "IMU", smooth(trace["tilt_rate"]) - om - bias)
        if "acc" in have:
            put(
                "accelerometer",
                "m/s^2",
                "IMU",
                smooth(trace["acc"]) - (vdot * co + IMU_HEIGHT * acc_th - G * np.sin(th) + offset),
            )
        if "wheel_speed" in have:
            put("odometry", "rad/s", "wheels", smooth(trace["wheel_speed"]) - (v / r - om))
        return Trace(times[3:-3], channels, units, {"parts": parts})
