"""The channels of a trace, computed over whole arrays after the rollout.

Joints have the model's order in ``q``, ``dq``, ``tau`` and ``target``; ``action`` and ``obs`` have the policy's own.
The state is true. What a robot can measure are its sensors: a channel each, by the name in the model.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain, count
from operator import attrgetter
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco import joints as joint_order
from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.joints import Joints
from s2r_mujoco.plan import Plan
from s2r_mujoco.rollout import Record
from s2r_mujoco.start import floor_height
from s2r_spec.backend import Channel
from s2r_spec.spec import SpecError, parse_spec

AXES = ("x", "y", "z")
_T = mujoco.mjtSensor
SENSOR_UNITS = {
    _T.mjSENS_TOUCH: "N", _T.mjSENS_ACCELEROMETER: "m/s^2", _T.mjSENS_VELOCIMETER: "m/s", _T.mjSENS_GYRO: "rad/s",
    _T.mjSENS_FORCE: "N", _T.mjSENS_TORQUE: "N*m", _T.mjSENS_MAGNETOMETER: "T", _T.mjSENS_RANGEFINDER: "m",
    _T.mjSENS_BALLANGVEL: "rad/s", _T.mjSENS_TENDONPOS: "m", _T.mjSENS_TENDONVEL: "m/s",
    _T.mjSENS_FRAMEPOS: "m", _T.mjSENS_FRAMELINVEL: "m/s", _T.mjSENS_FRAMEANGVEL: "rad/s",
    _T.mjSENS_FRAMELINACC: "m/s^2", _T.mjSENS_FRAMEANGACC: "rad/s^2", _T.mjSENS_SUBTREECOM: "m",
    _T.mjSENS_SUBTREELINVEL: "m/s", _T.mjSENS_SUBTREEANGMOM: "N*m*s", _T.mjSENS_CLOCK: "s",
    _T.mjSENS_GEOMDIST: "m", _T.mjSENS_E_POTENTIAL: "J", _T.mjSENS_E_KINETIC: "J",
}  # fmt: skip
"""Definition: type of a MuJoCo sensor → unit, from MuJoCo's XML reference; a type that is missing has none."""
_OF_JOINTS = {
    _T.mjSENS_JOINTPOS: ("rad", "m"), _T.mjSENS_JOINTVEL: ("rad/s", "m/s"), _T.mjSENS_JOINTACTFRC: ("N*m", "N"),
    _T.mjSENS_JOINTLIMITPOS: ("rad", "m"), _T.mjSENS_JOINTLIMITVEL: ("rad/s", "m/s"),
    _T.mjSENS_JOINTLIMITFRC: ("N*m", "N"), _T.mjSENS_ACTUATORPOS: ("rad", "m"),
    _T.mjSENS_ACTUATORVEL: ("rad/s", "m/s"), _T.mjSENS_ACTUATORFRC: ("N*m", "N"),
}  # fmt: skip
"""Definition: type of a sensor of a joint, or of its actuator → its units for a hinge and for a slide."""

Compute = Callable[[Record], FloatArray]


@dataclass(frozen=True)
class Computed:
    """A channel and the function that computes it from a record."""

    channel: Channel
    compute: Compute

    def of(self, record: Record) -> FloatArray:
        """Return (n,) samples, or (n, width) of a channel with several columns."""
        values = self.compute(record)
        return values[:, 0] if self.channel.width == 1 and values.ndim == 2 else values


class Attitude:
    """Rotation of the base at n samples: quaternion, Euler angles, and vectors in its axes."""

    def __init__(self, quaternion: FloatArray) -> None:
        self.w, self.x, self.y, self.z = quaternion.T

    @cached_property
    def roll(self) -> FloatArray:
        """Rotation about the forward axis [rad]."""
        return np.arctan2(2 * (self.w * self.x + self.y * self.z), 1 - 2 * (self.x**2 + self.y**2))

    @cached_property
    def pitch(self) -> FloatArray:
        """Rotation about the left axis [rad], positive with the nose down."""
        return np.arcsin(np.clip(2 * (self.w * self.y - self.z * self.x), -1.0, 1.0))

    @cached_property
    def yaw(self) -> FloatArray:
        """Heading [rad], continuous over the rollout."""
        return np.unwrap(np.arctan2(2 * (self.w * self.z + self.x * self.y), 1 - 2 * (self.y**2 + self.z**2)))

    @cached_property
    def matrix(self) -> FloatArray:
        """(n, 3, 3), whose columns are the axes of the base in the world."""
        w, x, y, z = self.w, self.x, self.y, self.z
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        return np.moveaxis(np.array(rows), -1, 0)


def channels_of(
    model: Any, plan: Plan, columns: tuple[str, ...], acts: bool, trained: bool = True
) -> tuple[Computed, ...]:
    """Return the channels of a robot.

    Args:
        model: the compiled model.
        plan: the plan of its rollouts.
        columns: names of the components of an observation; empty without a trained policy.
        acts: whether the controller is a function that returns the controls.
        trained: whether there is a policy, whose output is a channel.
    """
    found = [*_joint_channels(model), *_control_channels(model, plan, acts, trained)]
    if plan.root >= 0:
        found += _base_channels(model, plan)
    if columns:
        found.append(_observed(plan, columns))
    found += _commanded(plan, acts)
    taken = {one.channel.name for one in found}
    return (*found, *_sensor_channels(model, taken))


def joint_channels(model: Any) -> dict[str, Joints]:
    """Return the channels of positions, ``q`` of the hinges and ``q_slide``, each with its joints if there are any."""
    joints = joint_order.scalar_joints(model)
    slide = int(mujoco.mjtJoint.mjJNT_SLIDE)
    groups = {
        "q": [joint for joint in joints if model.jnt_type[joint] != slide],
        "q_slide": [joint for joint in joints if model.jnt_type[joint] == slide],
    }
    return {name: joint_order.named(model, group) for name, group in groups.items() if group}


def _joint_channels(model: Any) -> list[Computed]:
    found = []
    for name, own in joint_channels(model).items():
        end = name.removeprefix("q")
        kind, angle, force = ("slides", "m", "N") if end else ("hinges", "rad", "N*m")
        for stem, unit, words, field, index in (
            ("q", angle, f"positions of the {kind}", "qpos", own.qpos),
            ("dq", f"{angle}/s", f"velocities of the {kind}", "qvel", own.dof),
            ("tau", force, "by the actuators, within the physics step after the sample", "torque", own.dof),
        ):
            channel = Channel(f"{stem}{end}", unit, words, len(own), own.names)
            found.append(Computed(channel, _columns(field, index)))
    return found


def _control_channels(model: Any, plan: Plan, acts: bool, trained: bool) -> list[Computed]:
    if acts:
        names = tuple(model.actuator(i).name or f"actuator {i}" for i in range(model.nu))
        return [
            Computed(Channel("ctrl", "", "controls of the actuators", model.nu, names), attrgetter("target"))
        ]
    joints, n = plan.joints, len(plan.joints)
    order = np.argsort(joints.qpos)
    names = tuple(joints.names[i] for i in order)
    moved = tuple(joints.names[i] for i in plan.law.moved)
    angles = plan.law.has_target.all() and not plan.law.speed.any()
    unit = "rad" if angles and _all_hinges(model, joints) else ""
    targets = Channel("target", unit, "targets of the joints", n, names)
    found = [Computed(targets, lambda record: record.target[:, order])]
    if trained:
        action = Channel("action", "", "the policy's output; in its own order", len(moved), moved)
        found.append(Computed(action, attrgetter("action")))
    return found


def _all_hinges(model: Any, joints: Joints) -> bool:
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    kinds = {int(model.jnt_qposadr[j]): int(model.jnt_type[j]) for j in range(model.njnt)}
    return all(kinds[int(address)] == hinge for address in joints.qpos)


def _observed(plan: Plan, columns: tuple[str, ...]) -> Computed:
    description = "the policy's input, scaled; in its own order, with histories"
    return Computed(
        Channel("obs", "", description, len(columns), columns), lambda r: r.observation.astype(np.float64)
    )


def _commanded(plan: Plan, acts: bool) -> list[Computed]:
    """Return the commands and the phases of a policy, or the commands of a controller, that has them."""
    found = []
    given = acts and any(one.parameter or one.value for one in plan.commands.values())
    if given or any(term.name == "velocity_commands" for term in plan.terms):
        for place, (name, unit) in enumerate((("vx_cmd", "m/s"), ("vy_cmd", "m/s"), ("wz_cmd", "rad/s"))):
            found.append(Computed(Channel(name, unit, "command"), _constant(place)))
    term = next((term for term in plan.terms if term.name == "phase"), None)
    if term is not None:
        start = np.array(term.start or (0.0,))

        def phase(record: Record) -> FloatArray:
            turns = 2 * np.pi * term.frequency * plan.step * np.arange(len(record))
            values: FloatArray = np.mod(start + turns[:, None] + np.pi, 2 * np.pi) - np.pi
            return values

        found.append(Computed(Channel("phase", "rad", "phase of the gait, within ±π", len(start)), phase))
    return found


def _constant(place: int) -> Compute:
    return lambda record: np.full(len(record), record.command[place])


def _columns(name: str, index: Any) -> Compute:
    def compute(record: Record) -> FloatArray:
        values: FloatArray = getattr(record, name)[:, index]
        return values

    return compute


def _base_channels(model: Any, plan: Plan) -> list[Computed]:
    joint = int(model.body_jntadr[plan.root])
    p, v = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    ground = floor_height(model)

    @lru_cache(maxsize=1)  # for all channels of one record
    def attitude(record: Record) -> Attitude:
        return Attitude(record.qpos[:, p + 3 : p + 7])

    def in_body(record: Record) -> FloatArray:
        return np.einsum("nij,ni->nj", attitude(record).matrix, record.qvel[:, v : v + 3])

    def heading(record: Record, side: float) -> FloatArray:
        yaw, (vx, vy) = attitude(record).yaw, record.qvel[:, v : v + 2].T
        return np.cos(yaw - side) * vx + np.sin(yaw - side) * vy

    def rate(record: Record) -> FloatArray:
        _, wy, wz = record.qvel[:, v + 3 : v + 6].T
        roll, pitch = attitude(record).roll, attitude(record).pitch
        # The rate of the heading; the base's own vertical rate differs from it where the base is tilted.
        return (np.sin(roll) * wy + np.cos(roll) * wz) / np.maximum(np.cos(pitch), 1e-9)

    table: tuple[tuple[Channel, Compute], ...] = (
        (Channel("x", "m", "base position in the world"), lambda r: r.qpos[:, p]),
        (Channel("y", "m", "base position in the world"), lambda r: r.qpos[:, p + 1]),
        (Channel("z", "m", "base position in the world"), lambda r: r.qpos[:, p + 2]),
        (Channel("height", "m", "base height above the floor"), lambda r: r.qpos[:, p + 2] - ground),
        (Channel("vx", "m/s", "base velocity, forward in the heading frame"), lambda r: heading(r, 0.0)),
        (Channel("vy", "m/s", "base velocity, left in the heading frame"), lambda r: heading(r, -np.pi / 2)),
        (Channel("vz", "m/s", "base velocity, up"), lambda r: r.qvel[:, v + 2]),
        (Channel("wz", "rad/s", "rate of the heading"), rate),
        (Channel("velocity", "m/s", "base velocity, base axes", 3, AXES), in_body),
        (
            Channel("omega", "rad/s", "angular velocity, base axes", 3, AXES),
            lambda r: r.qvel[:, v + 3 : v + 6],
        ),
        (
            Channel("quaternion", "", "base attitude", 4, ("w", "x", "y", "z")),
            lambda r: r.qpos[:, p + 3 : p + 7],
        ),
        (Channel("roll", "rad", "base attitude"), lambda r: attitude(r).roll),
        (Channel("pitch", "rad", "base attitude, positive with the nose down"), lambda r: attitude(r).pitch),
        (Channel("yaw", "rad", "heading, continuous"), lambda r: attitude(r).yaw),
        (
            Channel("gravity", "", "direction of gravity, base axes", 3, AXES),
            lambda r: -attitude(r).matrix[:, 2],
        ),
    )
    return [Computed(channel, compute) for channel, compute in table]


def _sensor_channels(model: Any, taken: set[str]) -> list[Computed]:
    words = [
        re.sub(r"\W", "_", model.sensor(i).name or f"sensor_{i}", flags=re.ASCII)
        for i in range(model.nsensor)
    ]
    found, fits = [], _are_names(words)
    for sensor, word in enumerate(words):
        other = (f"sensor_{word}{end}" for end in chain([""], (f"_{i}" for i in count(2))))
        own = [word] if word[0].isalpha() and (fits or _are_names([word])) else []
        name = next(one for one in chain(own, other) if one not in taken)
        taken.add(name)
        first, width = int(model.sensor_adr[sensor]), int(model.sensor_dim[sensor])
        names = AXES if width == 3 else ()
        channel = Channel(name, _unit(model, sensor), "sensor of the model", width, names)
        found.append(Computed(channel, _columns("sensors", slice(first, first + width))))
    return found


def _are_names(words: Iterable[str]) -> bool:
    """Return whether a specification can declare all of these words; ``always`` and others are its keywords."""
    try:
        parse_spec("".join(f"signal {word}\n" for word in sorted(set(words))) + "require r: 0 < 1\n")
    except SpecError:
        return False
    return True


def _unit(model: Any, sensor: int) -> str:
    kind = mujoco.mjtSensor(int(model.sensor_type[sensor]))
    place = int(model.sensor_objid[sensor])
    if int(model.sensor_objtype[sensor]) == int(mujoco.mjtObj.mjOBJ_ACTUATOR):
        place = {actuator: joint for joint, actuator in joint_order.actuator_of(model).items()}.get(place, -1)
    if kind in _OF_JOINTS and place >= 0:
        return _OF_JOINTS[kind][int(model.jnt_type[place]) == int(mujoco.mjtJoint.mjJNT_SLIDE)]
    return SENSOR_UNITS.get(kind, "")
