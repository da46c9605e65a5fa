"""A planar two-link arm in a vertical plane: feed-forward torque and PD, sinusoids about a posture.

Someone outside wrote it, with its catalogue, to be diagnosed; the machine next door is theirs, too.
Angles are relative, the elbow's to the upper arm; every joint is one mass unless its gears wind up.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from s2r_arm_protocols import PROTOCOLS, plan

from s2r_spec import Trace
from s2r_spec.backend import Channel, Effect, EffectParameter, Parameter
from s2r_spec.effects import Choice, Values, as_values, choose, read_word, settings, words
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.protocols import PROTOCOL, Protocol, named

Array = NDArray[np.float64]

TS, DURATION, G = 0.002, 3.0, 9.81  # s, s, m/s^2
L1, LC1, M1, I1 = 0.40, 0.20, 3.0, 0.05  # m, m, kg, kg m^2
L2, LC2, M2, I2 = 0.35, 0.17, 2.0, 0.025
ROTOR = (0.20, 0.05)  # kg m^2 behind the gears
KP, KD = (400.0, 150.0), (30.0, 8.0)
LIMIT = (80.0, 30.0)  # N m
CENTRE = (-0.6, 0.8)
RAMP, TRIP, ELBOW = 0.6, 0.6, 0.4  # s, rad, the elbow's friction as a part of the shoulder's
VS = 0.02  # rad/s, over which dry friction changes sign


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
) -> Effect:
    return Effect(name, family, physics, (EffectParameter(parameter, unit, low, high, nominal, prior),))


CATALOGUE = (
    _effect(
        "viscous", "friction", "Grease drags in proportion to joint speed; the elbow has 0.4 of the shoulder's.",
        "coefficient", "N*m*s/rad", 0.0, 2.5, 0.0, "half-normal, 0.25 N*m*s/rad",
    ),
    _effect(
        "coulomb", "friction", "Dry friction in the gears; the elbow has 0.4 of the shoulder's.",
        "torque", "N*m", 0.0, 4.0, 0.0, "half-normal, 0.5 N*m",
    ),
    _effect(
        "torque_constant", "actuation", "Both motors make this part of the torque that is asked for.",
        "factor", "", 0.75, 1.25, 1.0, "normal around 1, standard deviation 0.04",
    ),
    _effect(
        "torque_limit", "actuation", "Both drives saturate at this part of the torque on their plate.",
        "factor", "", 0.4, 1.0, 1.0, "1 minus half-normal, 0.15",
    ),
    _effect(
        "rotor_inertia", "inertia", "Rotors and gears have this many times the inertia in the data sheet.",
        "factor", "", 0.5, 1.6, 1.0, "normal around 1, standard deviation 0.1",
    ),
    _effect(
        "forearm_mass", "inertia", "The forearm is heavier than drawn, with the same shape.",
        "extra", "kg", -0.7, 0.7, 0.0, "normal, 0.12 kg",
    ),
    _effect(
        "payload_offset", "inertia", "The payload's centre of mass is this much farther out than the flange.",
        "out", "m", -0.12, 0.12, 0.0, "normal, 0.02 m",
    ),
    _effect(
        "delay", "timing", "Commanded torques reach the drives this much later.",
        "time", "s", 0.0, 0.01, 0.0, "half-normal, 0.0015 s",
    ),
    _effect(
        "speed_filter", "sensing", "The drive smooths the measured speed with this time constant.",
        "time", "s", 0.0, 0.012, 0.0, "half-normal, 0.002 s",
    ),
    _effect(
        "encoder_offset", "sensing", "The elbow's encoder reads this much too large.",
        "angle", "rad", -0.12, 0.12, 0.0, "normal, 0.012 rad",
    ),
    _effect(
        "base_tilt", "geometry", "The base is tilted by this angle, which turns gravity.",
        "angle", "rad", -0.1, 0.1, 0.0, "normal, 0.01 rad",
    ),
    _effect(
        "compliance", "transmission", "The gears wind up: rotors turn ahead of the links; the elbow's twice as much.",
        "per_torque", "rad/(N*m)", 0.0, 0.0015, 0.0, "half-normal, 0.00015 rad/(N*m)",
    ),
)  # fmt: skip
NAMES = tuple(effect.name for effect in CATALOGUE)
NOMINAL = tuple(effect.parameters[0].nominal for effect in CATALOGUE)
CHANNELS = (
    Channel("q_ref", "rad", "joint angles asked for", 2),
    Channel("q", "rad", "joint angles by the motors' encoders", 2),
    Channel("v", "rad/s", "speeds that the controller uses", 2),
    Channel("u", "N*m", "torques asked for", 2),
)
PARAMETERS = (
    Parameter("amplitude", "rad", 0.05, 0.8, 0.6, "of the shoulder's sinusoid; the elbow's is 0.7 of it"),
    Parameter("frequency", "Hz", 0.2, 1.0, 0.8, "of the shoulder's; the elbow's is 1.5 times it"),
    Parameter("payload", "kg", 0.0, 2.5, 1.5, "at the flange; the controller is told it"),
)


@lru_cache(maxsize=512)
def reference(amplitude: float, frequency: float, ticks: int) -> Array:
    """Return (ticks, 6): two angles, speeds and accelerations asked for."""
    t = TS * np.arange(ticks)
    s = np.clip(t / RAMP, 0.0, 1.0)
    r = s**3 * (10 - 15 * s + 6 * s * s)
    r1 = 30 * s * s * (1 - s) ** 2 / RAMP
    r2 = 60 * s * (1 - s) * (1 - 2 * s) / RAMP**2
    out = np.empty((ticks, 6))
    for j, (a, w) in enumerate(
        ((amplitude, 2 * np.pi * frequency), (0.7 * amplitude, 3 * np.pi * frequency))
    ):
        y, y1, y2 = np.sin(w * t), w * np.cos(w * t), -w * w * np.sin(w * t)
        out[:, j] = CENTRE[j] + a * r * y
        out[:, 2 + j] = a * (r1 * y + r * y1)
        out[:, 4 + j] = a * (r2 * y + 2 * r1 * y1 + r * y2)
    out.setflags(write=False)
    return out


@njit(cache=True)
def terms(q1, q2, v1, v2, extra, mp, lp, tilt):
    """Return M11, M12, M22 of the links, and the torques of speed and gravity."""
    m2 = M2 + extra
    i2 = I2 * m2 / M2
    a2 = i2 + m2 * LC2 * LC2 + mp * lp * lp
    k = m2 * LC2 + mp * lp
    c2, s2 = np.cos(q2), np.sin(q2)
    m12 = a2 + L1 * k * c2
    m11 = I1 + M1 * LC1 * LC1 + (m2 + mp) * L1 * L1 + a2 + 2 * L1 * k * c2
    h = L1 * k * s2
    g2 = k * G * np.cos(q1 + q2 + tilt)
    g1 = (M1 * LC1 + (m2 + mp) * L1) * G * np.cos(q1 + tilt) + g2
    return m11, m12, a2, -h * (2 * v1 * v2 + v2 * v2) + g1, h * v1 * v1 + g2


def simulate(ref, payload, start, push, enc, gain, e, substeps):
    """Return (ticks, 6) of q, v, u of a test, and how many ticks ran; see :func:`follow`."""
    return follow(ref, np.ones(len(ref)), 1.0, payload, start, push, enc, gain, e, substeps)


@njit(cache=True)
def follow(ref, on, stiffness, payload, start, push, enc, gain, e, substeps):
    """Return (ticks, 6) of q, v, u, and how many ticks ran.

    ``on`` is (ticks,) 1 where the drives are on, else 0; ``stiffness`` is a factor on that of the joints; ``e`` are the
    effects' values in the order of NAMES.
    """
    viscous, coulomb, kt, limit, rot, extra, out, delay, filt, off, tilt, comp = e
    n = ref.shape[0]
    h = TS / substeps
    rec = np.zeros((n, 6))
    x = np.zeros(2)  # links
    v = np.zeros(2)
    th = np.zeros(2)  # rotors
    w = np.zeros(2)
    rotor = np.array([ROTOR[0] * rot, ROTOR[1] * rot])
    for j in range(2):
        x[j] = ref[0, j] + start[j]
    x[1] -= off
    th[:] = x
    buffer = np.zeros((n * substeps, 2))
    _, _, _, hold0, hold1 = terms(ref[0, 0], ref[0, 1], 0.0, 0.0, 0.0, payload, L2, 0.0)
    hold = np.array([hold0, hold1])
    seen_before = np.zeros(2)
    speed = np.zeros(2)
    u = np.zeros(2)
    tau = np.zeros(2)
    fr = np.zeros(2)
    lp = L2 + out
    damping = np.sqrt(stiffness)
    keep = np.exp(-TS / filt) if filt > 0 else 0.0
    if comp > 0:  # wound up by gravity at the start
        _, _, _, g1, g2 = terms(x[0], x[1], 0.0, 0.0, extra, payload + start[2], lp, tilt)
        th[0] += comp * g1
        th[1] += 2 * comp * g2
        x[0] -= comp * g1
        x[1] -= 2 * comp * g2
        th[0] -= comp * g1
        th[1] -= 2 * comp * g2
    for i in range(n):
        f11, f12, f22, n1, n2 = terms(ref[i, 0], ref[i, 1], ref[i, 2], ref[i, 3], 0.0, payload, L2, 0.0)
        ff0 = (f11 + ROTOR[0]) * ref[i, 4] + f12 * ref[i, 5] + n1
        ff1 = f12 * ref[i, 4] + (f22 + ROTOR[1]) * ref[i, 5] + n2
        for j in range(2):
            seen = th[j] + enc[i, j] + (off if j == 1 else 0.0)
            raw = (seen - seen_before[j]) / TS if i else 0.0
            speed[j] = raw + keep * (speed[j] - raw) if filt > 0 else raw
            seen_before[j] = seen
            kp, kd = stiffness * KP[j], damping * KD[j]
            c = (ff0 if j == 0 else ff1) + kp * (ref[i, j] - seen) + kd * (ref[i, 2 + j] - speed[j])
            u[j] = on[i] * min(max(c, -LIMIT[j]), LIMIT[j])
            rec[i, j] = seen
            rec[i, 2 + j] = speed[j]
            rec[i, 4 + j] = u[j]
            if abs(ref[i, j] - seen) > TRIP:
                return rec, i + 1
        for k in range(substeps):
            now = i * substeps + k
            past = delay / h
            whole = int(past)
            part = past - whole
            for j in range(2):
                buffer[now, j] = u[j]
                # Until the first command arrives the drives hold the arm where it is.
                a = buffer[now - whole, j] if now >= whole else hold[j]
                b = buffer[now - whole - 1, j] if now > whole else hold[j]
                made = gain * kt * (a + part * (b - a))
                top = limit * LIMIT[j]
                tau[j] = min(max(made, -top), top)
                side = w[j] if comp > 0 else v[j]
                scale = 1.0 if j == 0 else ELBOW
                fr[j] = scale * (viscous * side + coulomb * min(max(side / VS, -1.0), 1.0))
            m11, m12, m22, n1, n2 = terms(x[0], x[1], v[0], v[1], extra, payload + start[2], lp, tilt)
            if comp > 0:
                b0 = push[i, 0] - n1
                b1 = push[i, 1] - n2
                for j in range(2):
                    stiff = 1.0 / (comp if j == 0 else 2 * comp)
                    damp = 0.002 * stiff
                    big = stiff * h * h + damp * h
                    t0 = stiff * (th[j] - x[j] + h * (w[j] - v[j])) + damp * (w[j] - v[j])
                    got = (rotor[j] * t0 + big * (tau[j] - fr[j])) / (rotor[j] + big)
                    if j == 0:
                        b0 += got
                        m11 += rotor[j] * big / (rotor[j] + big)
                    else:
                        b1 += got
                        m22 += rotor[j] * big / (rotor[j] + big)
                det = m11 * m22 - m12 * m12
                acc0 = (m22 * b0 - m12 * b1) / det
                acc1 = (m11 * b1 - m12 * b0) / det
                for j in range(2):
                    acc = acc0 if j == 0 else acc1
                    stiff = 1.0 / (comp if j == 0 else 2 * comp)
                    damp = 0.002 * stiff
                    big = stiff * h * h + damp * h
                    t0 = stiff * (th[j] - x[j] + h * (w[j] - v[j])) + damp * (w[j] - v[j])
                    w[j] += h * (tau[j] - fr[j] - t0 + big * acc) / (rotor[j] + big)
                    v[j] += h * acc
                    th[j] += h * w[j]
                    x[j] += h * v[j]
            else:
                m11 += rotor[0]
                m22 += rotor[1]
                b0 = tau[0] - fr[0] + push[i, 0] - n1
                b1 = tau[1] - fr[1] + push[i, 1] - n2
                det = m11 * m22 - m12 * m12
                v[0] += h * (m22 * b0 - m12 * b1) / det
                v[1] += h * (m11 * b1 - m12 * b0) / det
                for j in range(2):
                    x[j] += h * v[j]
                    th[j] = x[j]
    return rec, n


CUT, EDGE = 20.0, 60  # Hz of the filter before two derivatives; samples cut off at either end


@lru_cache(maxsize=16)
def _gain(size: int) -> Array:
    f = np.fft.rfftfreq(size, TS)
    return 1.0 / (1.0 + (f / CUT) ** 4)


def smooth(y: Array) -> Array:
    """Pass (n, k) through a low-pass without phase, either end turned about its last value."""
    from scipy.fft import irfft, next_fast_len, rfft

    pad = 3 * EDGE
    full = np.concatenate([2 * y[0] - y[pad:0:-1], y, 2 * y[-1] - y[-2 : -pad - 2 : -1]])
    size = next_fast_len(full.shape[0], real=True)
    full = np.concatenate([full, np.repeat(full[-1:], size - full.shape[0], axis=0)])
    return irfft(rfft(full, axis=0) * _gain(size)[:, None], size, axis=0)[pad : pad + y.shape[0]]


_last: list[Any] = [None, None]


def _kinematics(trace: Trace) -> tuple[Array, Array, Array]:
    """Return smooth angles, speeds and accelerations; of the last trace they are kept, for the next effect."""
    if _last[0] is not trace:
        q = smooth(trace["q"])
        w = np.gradient(q, TS, axis=0)
        _last[:] = [trace, (q, w, np.gradient(w, TS, axis=0))]
    return _last[1]


@dataclass(frozen=True)
class Arm:
    """A two-link arm that tracks sinusoids by computed feed-forward torques and joint PD.

    Attributes:
        options: words ``effect.parameter=value``, which go into ``added``.
        added: the chosen effects.
        substeps: of the physics in a control period.
        loud: how many times the noise is as loud as it should be.
    """

    options: str = ""
    added: Choice = ()
    substeps: int = 2
    loud: float = 1.0
    channels: tuple[Channel, ...] = field(default=CHANNELS, init=False, repr=False)
    parameters: tuple[Parameter, ...] = field(default=PARAMETERS, init=False, repr=False)
    deterministic = True
    duration = DURATION
    cost = 1e-3

    def __post_init__(self) -> None:
        added = self.added
        for word in filter(None, self.options.split(",")):
            values = read_word(word)
            if values is None:
                raise UsageError(f"{word!r} is no effect; write effect.parameter=value")
            added = choose("arm", CATALOGUE, added, values)
        object.__setattr__(self, "options", "")
        object.__setattr__(self, "added", added)

    @property
    def name(self) -> str:
        return ":".join(filter(None, ("arm", ",".join(words(self.added)))))

    @property
    def model_hash(self) -> str:
        text = f"{self.added} {self.substeps} {self.loud} {np.__version__}".encode()
        source = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("s2r_arm*.py")))
        return hashlib.sha256(text + source).hexdigest()

    def effects(self) -> tuple[Effect, ...]:
        return CATALOGUE

    def with_effects(self, values: Values) -> Arm:
        return replace(self, added=choose("arm", CATALOGUE, self.added, values))

    def chosen(self) -> dict[str, dict[str, float]]:
        return as_values(self.added)

    def variants(self) -> dict[str, Arm]:
        return {
            "half the step": replace(self, substeps=2 * self.substeps),
            "twice the noise": replace(self, loud=2.0 * self.loud),
        }

    @property
    def _values(self) -> tuple[float, ...]:
        got = settings(CATALOGUE, self.added)
        return tuple(
            next(iter(got[name].values())) if name in got else nominal
            for name, nominal in zip(NAMES, NOMINAL, strict=True)
        )

    def _test(self, params: Mapping[str, float]) -> list[float]:
        known = [p.name for p in PARAMETERS]
        for name in params:
            if name not in known:
                raise UsageError(f"arm has no parameter {name!r}; it has {known}")
        return [p.check(params.get(p.name, p.default)) for p in PARAMETERS]

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        amplitude, frequency, payload = self._test(params)
        ticks = round(self.duration / TS) + 1
        test = {"amplitude": amplitude, "frequency": frequency, "payload": payload}
        meta = {"seed": seed, "params": test}
        return self._follow(reference(amplitude, frequency, ticks), np.ones(ticks), 1.0, payload, meta)

    def protocols(self) -> tuple[Protocol, ...]:
        return PROTOCOLS

    def run(self, protocol: str, params: Mapping[str, float], seed: int) -> Trace:
        values = named(PROTOCOLS, protocol, self.name).values(params)
        meta = {PROTOCOL: protocol, "seed": seed, "params": values}
        return self._follow(*plan(protocol, values["amplitude"]), values["gain"], values["payload"], meta)

    def _follow(self, ref: Array, on: Array, gain: float, payload: float, meta: Mapping[str, Any]) -> Trace:
        """Return a run with the random numbers of the seed in ``meta``."""
        ticks, rng = len(ref), np.random.default_rng(meta["seed"])
        start = rng.normal(size=3) * (0.003, 0.003, 0.01)
        drives = 1.0 + 0.002 * rng.normal()
        enc = self.loud * 2e-5 * rng.normal(size=(ticks, 2))
        keep = np.exp(-TS / 0.1)
        kicks = rng.normal(size=(ticks, 2)) * np.sqrt(1 - keep**2) * self.loud * np.array([0.06, 0.02])
        push = _ou(kicks, keep)
        rec, ran = follow(ref, on, gain, payload, start, push, enc, drives, self._values, self.substeps)
        failure = {"failure": "tripped"} if ran < ticks else {}
        channels = {"q_ref": ref[:ran, :2], "q": rec[:ran, :2], "v": rec[:ran, 2:4], "u": rec[:ran, 4:]}
        units = {c.name: c.unit for c in CHANNELS}
        return Trace(TS * np.arange(ran), channels, units, {"backend": self.name, **meta, **failure})

    def residuals(self, trace: Trace, params: Mapping[str, float] | None = None) -> Trace:
        """Return what the equations of motion leave of the torques, and the control law of the commands."""
        lacking = {"q", "u"} - set(trace.channels)
        if lacking:
            raise TraceError(f"residuals need q and u; the trace lacks {sorted(lacking)}")
        if len(trace) < 4 * EDGE:
            raise TraceError("residuals need more samples")
        ref, on, gain, payload = self._followed(trace, params or {})
        viscous, coulomb, kt, limit, rot, extra, out, delay, filt, off, tilt, comp = self._values
        th, w, acc = _kinematics(trace)
        n, t = len(trace), trace.times
        shares, top = np.array([1.0, ELBOW]), limit * np.array(LIMIT)
        u = trace["u"]
        late = t - delay - TS / 2
        made = np.column_stack([np.interp(late, t, u[:, j]) for j in range(2)])
        made = smooth(np.clip(kt * made, -top, top))
        motor = made - shares * (viscous * w + coulomb * np.clip(w / VS, -1, 1)) - rot * np.array(ROTOR) * acc
        x, v, a = th, w, acc
        if comp:
            twist = comp * np.array([1.0, 2.0]) * motor
            x = th - twist
            v = w - np.gradient(twist, TS, axis=0)
            a = np.gradient(v, TS, axis=0)
        m11, m12, m22, n1, n2 = terms(
            x[:, 0], x[:, 1] - off, v[:, 0], v[:, 1], extra, payload, L2 + out, tilt
        )
        need = np.column_stack([m11 * a[:, 0] + m12 * a[:, 1] + n1, m12 * a[:, 0] + m22 * a[:, 1] + n2])
        inner = slice(EDGE, -EDGE)
        channels, units = {"torque": (need - motor)[inner]}, {"torque": "N*m"}
        if n <= len(ref):
            ref = ref[:n]
            f11, f12, f22, n1, n2 = terms(ref[:, 0], ref[:, 1], ref[:, 2], ref[:, 3], 0.0, payload, L2, 0.0)
            shoulder = (f11 + ROTOR[0]) * ref[:, 4] + f12 * ref[:, 5] + n1
            elbow = f12 * ref[:, 4] + (f22 + ROTOR[1]) * ref[:, 5] + n2
            ff = np.column_stack([shoulder, elbow])
            seen = trace["q"]
            raw = np.diff(seen, axis=0, prepend=seen[:1]) / TS
            if filt:
                from scipy.signal import lfilter

                keep = np.exp(-TS / filt)
                raw = lfilter([1 - keep], [1, -keep], raw, axis=0)
            kp, kd = gain * np.array(KP), np.sqrt(gain) * np.array(KD)
            law = ff + kp * (ref[:, :2] - seen) + kd * (ref[:, 2:4] - raw)
            law = on[:n, None] * np.clip(law, -np.array(LIMIT), LIMIT)
            channels["controller"], units["controller"] = (u - law)[inner], "N*m"
        return Trace(t[inner], channels, units, {"parts": {k: ["shoulder", "elbow"] for k in channels}})

    def _followed(self, trace: Trace, params: Mapping[str, float]) -> tuple[Array, Array, float, float]:
        """Return what the controller followed, when the drives were on, its gain and the payload."""
        if protocol := str(trace.meta.get(PROTOCOL, "")):
            values = named(PROTOCOLS, protocol, self.name).values(params)
            return *plan(protocol, values["amplitude"]), values["gain"], values["payload"]
        amplitude, frequency, payload = self._test(params)
        ref = reference(amplitude, frequency, round(self.duration / TS) + 1)
        return ref, np.ones(len(ref)), 1.0, payload


@njit(cache=True)
def _ou(kicks, keep):
    out = np.empty_like(kicks)
    s0 = kicks[0, 0] / np.sqrt(1 - keep * keep)
    s1 = kicks[0, 1] / np.sqrt(1 - keep * keep)
    for i in range(kicks.shape[0]):
        s0 = keep * s0 + kicks[i, 0]
        s1 = keep * s1 + kicks[i, 1]
        out[i, 0] = s0
        out[i, 1] = s1
    return out
