"""A real Go2 with its base held in the air, beside a simulator of its twelve joints: a backend in one file.

Run: python -m benchmarks.diagnose.go2_inair --data ../shared/data/go2_inair --out FOLDER

The recording (iit-DLSLab/sim2real-robot-identification, BSD-3) is 23.5 s of commanded and measured joint angles at
200 Hz; its MuJoCo model comes with it. Its authors collected it with the motor law
torque = 20 N*m/rad (q_ref - q) - 1.5 N*m*s/rad dq. The simulator plays the same command into the same law. Nominally
its joints are ideal: no armature, no friction, nothing late; effects add those.

What is written is eleven rollouts of 2 s in the form that ``log:FOLDER`` reads. Printed is the gap of the nominal
simulator, and of one with the joint figures that the recording's own model file gives.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import s2r_spec as s2r
from s2r_spec import logs
from s2r_spec.backend import Channel, Effect, EffectParameter, Parameter
from s2r_spec.effects import Choice, Values, as_values, choose, settings, words
from s2r_spec.errors import TraceError
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Twelve = tuple[float, ...]

SPEC = Path(__file__).with_suffix(".stl")
KP, KD = 20.0, 1.5
"""[N*m/rad], [N*m*s/rad] of the motor law, by the authors' configuration."""
RATE = 200
"""[Hz] of the recording."""
SUBSTEPS = 5
"""Physics steps of 1 ms in a sample."""
LEAD_IN = 0.5
"""[s] of the record that run before the wanted part; the motor law forgets in 75 ms."""
NOISE = 3e-4
"""[rad] of an encoder, white; assumed."""
LEGS = ("FL", "FR", "RL", "RR")
JOINTS = [f"{leg} {joint}" for leg in LEGS for joint in ("hip", "thigh", "calf")]
LIMITS = np.tile([23.7, 23.7, 45.43], 4)
"""[N*m]"""
_MIRROR = np.tile([1.0, 1.0, 1.0, -1.0, 1.0, 1.0], 2)
"""Sign of a joint's outward direction: hips of right legs are mirrored."""


@dataclass(frozen=True)
class Joints:
    """What effects change; defaults are ideal."""

    armature: Twelve = (0.0,) * 12
    damping: Twelve = (0.0,) * 12
    friction: Twelve = (0.0,) * 12
    delay: float = 0.0
    strength: float = 1.0
    speed_gain: float = 1.0
    hip_offset: float = 0.0
    thigh_offset: float = 0.0
    calf_offset: float = 0.0
    leg_mass: float = 1.0


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect; ``apply(joints, **values)`` adds or multiplies."""

    apply: Callable[..., Joints]


def _one(
    name: str, unit: str, low: float, high: float, nominal: float, prior: str
) -> tuple[EffectParameter, ...]:
    return (EffectParameter(name, unit, low, high, nominal, prior),)


def _each(unit: str, low: float, high: float, prior: str) -> tuple[EffectParameter, ...]:
    """Return one for each kind of joint: a calf is driven through a linkage with a reduction of its own."""
    return tuple(EffectParameter(joint, unit, low, high, 0.0, prior) for joint in ("hip", "thigh", "calf"))


def _plus(now: Twelve, hip: float, thigh: float, calf: float) -> Twelve:
    return tuple(x + more for x, more in zip(now, (hip, thigh, calf) * 4, strict=True))


def _dry_friction(kind: str) -> JointEffect:
    """Return dry friction of one kind of joint, with the spread over the legs."""

    def apply(j: Joints, torque: float, **legs: float) -> Joints:
        own = [
            torque * (1.0 + legs[leg]) if joint == kind else 0.0
            for leg in LEGS
            for joint in ("hip", "thigh", "calf")
        ]
        return replace(j, friction=tuple(x + more for x, more in zip(j.friction, own, strict=True)))

    spread = [
        EffectParameter(leg, "", -0.8, 0.8, 0.0, "normal around 0, standard deviation 0.3") for leg in LEGS
    ]
    return JointEffect(
        f"{kind}_friction", "friction", f"Coulomb friction acts at the {kind} joints, and differs from leg to leg.",
        (*_one("torque", "N*m", 0.0, 2.0, 0.0, "half-normal, 0.4 N*m"), *spread), apply,
    )  # fmt: skip


CATALOGUE = (
    JointEffect(
        "armature", "inertia", "Rotor inertia is felt at the joints.",
        _each("kg*m^2", 0.0, 0.1, "half-normal, 0.02 kg*m^2"),
        lambda j, hip, thigh, calf: replace(j, armature=_plus(j.armature, hip, thigh, calf)),
    ),
    JointEffect(
        "viscous_friction", "friction", "The joints are held back in proportion to their speed.",
        _each("N*m*s/rad", 0.0, 2.0, "half-normal, 0.4 N*m*s/rad"),
        lambda j, hip, thigh, calf: replace(j, damping=_plus(j.damping, hip, thigh, calf)),
    ),
    *(_dry_friction(joint) for joint in ("hip", "thigh", "calf")),
    JointEffect(
        "delay", "timing", "The commanded angles reach the motors this much later.",
        _one("time", "s", 0.0, 0.06, 0.0, "half-normal, 0.01 s"),
        lambda j, time: replace(j, delay=j.delay + time),
    ),
    JointEffect(
        "motor_strength", "actuation", "The motors make this part of the torque that their law asks for.",
        _one("factor", "", 0.4, 1.5, 1.0, "normal around 1, standard deviation 0.15"),
        lambda j, factor: replace(j, strength=j.strength * factor),
    ),
    JointEffect(
        "speed_gain", "actuation", "The motors damp with this part of the gain on speed that they were given.",
        _one("factor", "", 0.3, 2.0, 1.0, "normal around 1, standard deviation 0.15"),
        lambda j, factor: replace(j, speed_gain=j.speed_gain * factor),
    ),
    JointEffect(
        "encoder_offset", "sensing", "The zero of the encoders is off; hips of both sides outwards.",
        _each("rad", -0.15, 0.15, "normal, 0.02 rad"),
        lambda j, hip, thigh, calf: replace(
            j, hip_offset=j.hip_offset + hip, thigh_offset=j.thigh_offset + thigh, calf_offset=j.calf_offset + calf
        ),
    ),
    JointEffect(
        "leg_mass", "inertia", "Every part of the legs is heavier by this factor, and so is its inertia.",
        _one("factor", "", 0.6, 1.6, 1.0, "normal around 1, standard deviation 0.1"),
        lambda j, factor: replace(j, leg_mass=j.leg_mass * factor),
    ),
)  # fmt: skip

CHANNELS = (
    Channel("q_ref", "rad", "commanded angle; FL, FR, RL, RR, each hip, thigh, calf", 12),
    Channel("q", "rad", "measured angle", 12),
    Channel(
        "torque",
        "N*m",
        "that the motor law asks for at the sample, with the difference of angles as speed",
        12,
    ),
)
GIVEN = {
    "armature": {"hip": 0.01, "thigh": 0.01, "calf": 0.01},
    "viscous_friction": {"hip": 0.6, "thigh": 0.6, "calf": 0.6},
    **{f"{kind}_friction": {"torque": 0.2} for kind in ("hip", "thigh", "calf")},
}
"""Joint figures in the recording's model file."""


@dataclass(frozen=True)
class Go2InAir:
    """Twelve joints in MuJoCo, base fixed, under the recorded command; a pure function of parameters and seed."""

    data: Path
    """Folder with go2.xml and traj_0.npz."""
    duration: float = 2.0
    added: Choice = ()
    deterministic: bool = field(default=True, init=False)
    channels: tuple[Channel, ...] = field(default=CHANNELS, init=False, repr=False)

    @property
    def name(self) -> str:
        """Not installed: the name says only what was added."""
        return ":".join(filter(None, ("go2_inair", ",".join(words(self.added)))))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Where in the record a rollout starts."""
        last = (recorded(self.data)[0].shape[0] - 1) / RATE - self.duration
        return (Parameter("start", "s", 0.0, last, 0.0, "moment of the record at which the rollout begins"),)

    @property
    def cost(self) -> float:
        """Expected time of one rollout on one core [s]."""
        return 0.04 * self.duration

    @property
    def model_hash(self) -> str:
        """Hash of the joints, of the data and of this file."""
        digest = hashlib.sha256(f"{self._joints()!r}".encode())
        for path in (Path(__file__), self.data / "go2.xml", self.data / "traj_0.npz"):
            digest.update(path.read_bytes())
        return digest.hexdigest()

    def effects(self) -> tuple[Effect, ...]:
        """Return the catalogue."""
        return CATALOGUE

    def with_effects(self, values: Values) -> Go2InAir:
        """Return the same backend with these effects added."""
        return replace(self, added=choose("go2_inair", CATALOGUE, self.added, values))

    def with_duration(self, seconds: float) -> Go2InAir:
        """Return the same backend with rollouts of this length."""
        return replace(self, duration=seconds)

    def _joints(self) -> Joints:
        joints = Joints()
        by_name = {effect.name: effect for effect in CATALOGUE}
        for name, values in settings(CATALOGUE, self.added).items():
            joints = by_name[name].apply(joints, **values)
        return joints

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test; samples every 5 ms from t = 0 to ``duration`` inclusive."""
        (parameter,) = self.parameters
        start = parameter.check(params.get("start", parameter.default))
        asked, measured = recorded(self.data)
        first, count = round(start * RATE), ceil(self.duration * RATE - 1e-9) + 1
        begin = max(0, first - round(LEAD_IN * RATE))
        joints = self._joints()
        angles = simulate(self.data, joints, asked[begin : first + count], measured[begin : begin + 5])
        seen = angles[first - begin :] + NOISE * np.random.default_rng(seed).normal(size=(count, 12))
        meta: dict[str, Any] = {"params": {"start": start}, "seed": seed}
        if self.added:
            meta["effects"] = as_values(self.added)
        before = angles[first - begin - 1] if first > begin else seen[0]
        return logged(asked[first : first + count], seen, before, meta)

    def residuals(self, trace: Trace, params: Mapping[str, float] | None = None) -> Trace:
        """Return the torque [N*m] at every joint that this model does not explain, by inverse dynamics at 10 Hz.

        Raises:
            TraceError: ``q`` or ``q_ref`` is missing.
        """
        import mujoco
        from scipy.signal import butter, sosfiltfilt

        if not {"q", "q_ref"} <= set(trace.channels):
            raise TraceError(
                f"residuals need q and q_ref, but the trace has {', '.join(sorted(trace.channels))}"
            )
        joints = self._joints()
        sos = butter(2, 10.0, fs=RATE, output="sos")
        q = np.asarray(sosfiltfilt(sos, trace["q"], axis=0)) - offsets(joints)
        v = np.gradient(q, 1 / RATE, axis=0)
        a = np.gradient(v, 1 / RATE, axis=0)
        target = delayed(trace["q_ref"], joints.delay + 0.5 / RATE)
        motor = KP * (sosfiltfilt(sos, target, axis=0) - q - offsets(joints)) - joints.speed_gain * KD * v
        model = compiled(self.data, joints)
        data = mujoco.MjData(model)
        needed = np.empty_like(q)
        for k in range(q.shape[0]):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            needed[k] = data.qfrc_inverse
        inner = slice(RATE // 10, -(RATE // 10))
        left = (needed - joints.strength * motor)[inner]
        return Trace(trace.times[inner], {"torque": left}, {"torque": "N*m"}, {"parts": {"torque": JOINTS}})


@cache
def recorded(data: Path) -> tuple[FloatArray, FloatArray]:
    """Return (n, 12) commanded and measured angles [rad]."""
    with np.load(data / "traj_0.npz") as archive:
        return archive["des_dof_pos"].astype(np.float64), archive["dof_pos"].astype(np.float64)


@cache
def compiled(data: Path, joints: Joints) -> Any:
    """Return the MuJoCo model: the file's bodies and inertias, base fixed, without geometry, with these joints."""
    import mujoco

    root = ET.fromstring((data / "go2.xml").read_text())
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in (
                "geom",
                "mesh",
                "material",
                "freejoint",
                "site",
                "sensor",
                "keyframe",
                "actuator",
            ):
                parent.remove(child)
    for inertial in root.iter("inertial"):
        for name in ("mass", "diaginertia"):
            numbers = [joints.leg_mass * float(word) for word in inertial.attrib[name].split()]
            inertial.attrib[name] = " ".join(map(repr, numbers))
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    model.opt.timestep = 1 / (RATE * SUBSTEPS)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_armature[:] = joints.armature
    model.dof_damping[:] = joints.damping
    model.dof_frictionloss[:] = joints.friction
    return model


def offsets(joints: Joints) -> FloatArray:
    """Return (12,) by how much each encoder reads too much [rad]."""
    return _MIRROR * np.tile([joints.hip_offset, joints.thigh_offset, joints.calf_offset], 4)


def delayed(asked: FloatArray, time: float) -> FloatArray:
    """Return (n, 12) commands as they arrive, between samples by straight lines."""
    ticks = np.arange(asked.shape[0], dtype=np.float64)
    return np.stack([np.interp(ticks - time * RATE, ticks, column) for column in asked.T], axis=1)


def simulate(data: Path, joints: Joints, asked: FloatArray, measured: FloatArray) -> FloatArray:
    """Return (n, 12) of what the encoders read under commands (n, 12), from the state in the first (k, 12) measured."""
    import mujoco

    model = compiled(data, joints)
    state = mujoco.MjData(model)
    state.qpos[:] = measured[0] - offsets(joints)
    state.qvel[:] = np.polyfit(np.arange(measured.shape[0]) / RATE, measured, 1)[0]
    held = np.arange(asked.shape[0] * SUBSTEPS) / (RATE * SUBSTEPS) - joints.delay
    arrived = asked[np.maximum(np.floor(held * RATE + 1e-9).astype(int), 0)]
    zero = offsets(joints)
    read = np.empty_like(asked)
    for k in range(asked.shape[0]):
        read[k] = state.qpos + zero
        for j in range(SUBSTEPS):
            torque = (
                KP * (arrived[k * SUBSTEPS + j] - state.qpos - zero) - joints.speed_gain * KD * state.qvel
            )
            state.qfrc_applied[:] = joints.strength * np.clip(torque, -LIMITS, LIMITS)
            mujoco.mj_step(model, state)
    return read


def logged(asked: FloatArray, seen: FloatArray, before: FloatArray, meta: Mapping[str, Any]) -> Trace:
    """Return a trace of commanded and measured angles, with the torque that the motor law makes of them."""
    speed = np.diff(seen, axis=0, prepend=before[None]) * RATE
    torque = np.clip(KP * (asked - seen) - KD * speed, -LIMITS, LIMITS)
    units = {channel.name: channel.unit for channel in CHANNELS}
    return Trace(np.arange(asked.shape[0]) / RATE, {"q_ref": asked, "q": seen, "torque": torque}, units, meta)


def segments(data: Path, seconds: float = 2.0) -> list[tuple[dict[str, float], Trace]]:
    """Return ({"start": s}, trace) of every whole segment of the recording."""
    asked, measured = recorded(data)
    count = round(seconds * RATE)
    found = []
    for first in range(0, asked.shape[0] - count, count):
        part = slice(first, first + count + 1)
        trace = logged(asked[part], measured[part], measured[max(0, first - 1)], {"source": "traj_0.npz"})
        found.append(({"start": first / RATE}, trace))
    return found


def main() -> None:
    """Write the folder, and print gaps."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with go2.xml and traj_0.npz")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    if not (arguments.data / "traj_0.npz").exists():
        sys.exit(
            f"there is no {arguments.data / 'traj_0.npz'}; see datasets/ in iit-DLSLab/sim2real-robot-identification"
        )
    if arguments.out.exists():
        sys.exit(f"{arguments.out} already exists; give another --out")
    real = segments(arguments.data)
    arguments.out.mkdir(parents=True)
    with (arguments.out / "rollouts.csv").open("w", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["id", "start [s]"])
        for params, trace in real:
            logs.write(trace, arguments.out / f"from-{params['start']:04.1f}.npz")
            table.writerow([f"from-{params['start']:04.1f}", params["start"]])
    spec = s2r.load_spec(SPEC)
    nominal = Go2InAir(arguments.data)
    for what, model in (("ideal joints", nominal), ("as in go2.xml", nominal.with_effects(GIVEN))):
        gap, error = [], []
        for params, trace in real:
            run = model.rollout(params, 0)
            gap.append(
                abs(spec.robustness(trace, params)["follows"] - spec.robustness(run, params)["follows"])
            )
            error.append(np.sqrt(np.mean((run["q"] - trace["q"]) ** 2)))
        print(
            f"{what:14s} mean gap {np.mean(gap):.4f} rad, largest {np.max(gap):.4f}; rms of q {np.mean(error):.4f} rad"
        )


if __name__ == "__main__":
    main()
