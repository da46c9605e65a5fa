"""A log by the names and orders of a robot's files: the state behind each term of the observation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.channels import Attitude
from s2r_mujoco.observation import Memory, Observer, Part, Parts
from s2r_mujoco.plan import Plan
from s2r_mujoco.robot import Robot
from s2r_spec.trace import Trace

RATE = 0.05
"""Tolerance: relative distance of a log's period from the control period."""


class Log:
    """A trace by the names and orders of a robot, of n rows, one a control tick."""

    def __init__(self, robot: Robot, trace: Trace) -> None:
        self.robot, self.trace, self.plan = robot, trace, robot.plan
        self.used: set[str] = set()

    def __len__(self) -> int:
        return len(self.trace)

    @property
    def period(self) -> float:
        """Median time between two rows [s]; infinite for one row."""
        return float(np.median(np.diff(self.trace.times))) if len(self.trace) > 1 else np.inf

    @property
    def is_by_ticks(self) -> bool:
        """Whether its rows are control ticks."""
        return abs(self.period / self.plan.step - 1.0) <= RATE

    def channel(self, name: str) -> FloatArray | None:
        """Return (n, w) a channel; None where the log lacks it. ``used`` remembers its name."""
        if name not in self.trace.channels:
            return None
        self.used.add(name)
        values = np.asarray(self.trace[name], dtype=np.float64)
        return values.reshape(len(values), -1)

    def joints(self, name: str, wanted: Sequence[str]) -> FloatArray | None:
        """Return (n, joints) of the channels ``q`` and ``q_slide``, or of velocities or torques."""
        columns: dict[str, FloatArray] = {}
        for channel in self.robot.channels:
            values = self.channel(channel.name) if channel.name in (name, f"{name}_slide") else None
            if values is not None and values.shape[1] == len(channel.columns):
                columns |= {column: values[:, k] for k, column in enumerate(channel.columns)}
        return np.stack([columns[one] for one in wanted], axis=1) if {*wanted} <= columns.keys() else None

    @property
    def attitude(self) -> FloatArray | None:
        """(n, 3, 3) attitude of the base."""
        quaternion = self.channel("quaternion")
        return None if quaternion is None or quaternion.shape[1] != 4 else Attitude(quaternion).matrix

    def observer(self, plan: Plan, memory: Memory) -> Observer:
        """Return the observer of a plan whose terms read this log; NaN where the log lacks the state of a term."""
        model = self.robot.model
        made = Parts(plan, model, mujoco.MjData(model), memory).of(plan.terms, {})
        parts = []
        for part in made:
            if part.term.name != "last_action":
                values = self.term(part)
                raw = np.full((len(self), part.width), np.nan) if values is None else values
                part = replace(part, read=lambda tick, raw=raw: raw[tick])  # type: ignore[misc]
            parts.append(part)
        return Observer(tuple(parts), plan)

    def expected(self, plan: Plan) -> FloatArray:
        """Return (n, width) the observations of a plan; NaN where the log lacks the state of a term."""
        action = self.channel("action")
        memory = self.memory(plan)
        observer, rows = self.observer(plan, memory), []
        for tick in range(len(self)):
            if tick:
                memory.last_action[:] = np.nan if action is None else self.limited(action[tick - 1])
            rows.append(observer.read(tick))
        return np.array(rows, dtype=np.float64)

    @staticmethod
    def memory(plan: Plan) -> Memory:
        """Return what a rollout remembers at its first tick."""
        return Memory(np.zeros(3), np.zeros(len(plan.law.moved)))

    def limited(self, action: FloatArray) -> FloatArray:
        """Return an action within the limits of the files."""
        clip = self.plan.law.clip_action
        return action if clip is None else np.clip(action, *clip)

    def term(self, part: Part) -> FloatArray | None:
        """Return (n, width) the raw values of a term from the channels; None where the log lacks them."""
        plan, term = self.plan, part.term
        if term.name in ("joint_pos", "joint_pos_rel", "joint_vel", "joint_vel_rel"):
            names = self.names(part)
            values = self.joints("q" if "pos" in term.name else "dq", names)
            if values is None or term.name != "joint_pos_rel":
                return values
            home = dict(zip(plan.joints.names, plan.pose.tolist(), strict=True))
            return values - [home.get(name, 0.0) for name in names] if {*names} <= home.keys() else None
        if term.name == "velocity_commands":
            each = [self.channel(name) for name in ("vx_cmd", "vy_cmd", "wz_cmd")]
            return None if any(one is None for one in each) else np.concatenate(each, axis=1)  # type: ignore[arg-type]
        if term.name == "phase":
            ticks = np.round(self.trace.times / plan.step).astype(int)
            return np.array([part.read(int(tick)) for tick in ticks])
        return self._sensor(part) if term.sensor else self._base(part)

    def names(self, part: Part) -> list[str]:
        """Return the name of each component of a term."""
        model, joints = self.robot.model, self.plan.joints
        if part.term.name.startswith("joint_"):
            chosen = part.term.joints or range(len(joints))
            if not part.term.names:
                return [joints.names[k] for k in chosen]
            of_dof = {int(model.jnt_dofadr[j]): model.joint(j).name for j in range(model.njnt)}
            return [of_dof[int(dof)] for dof in part.dof]
        if part.term.name == "last_action":
            return [joints.names[k] for k in self.plan.law.moved]
        return list("xyz") if part.width == 3 else [str(k) for k in range(part.width)]

    def _sensor(self, part: Part) -> FloatArray | None:
        """Return the values of a sensor, by its name or, at a site of the root, from the state of the base."""
        model, turn = self.robot.model, self.attitude
        sensor = model.sensor(part.term.sensor)
        values, site = self.channel(part.term.sensor), int(sensor.objid[0])
        at_site = int(sensor.objtype[0]) == int(mujoco.mjtObj.mjOBJ_SITE)
        names = {
            int(mujoco.mjtSensor.mjSENS_GYRO): "omega",
            int(mujoco.mjtSensor.mjSENS_VELOCIMETER): "velocity",
        }
        if values is None and at_site and int(sensor.type[0]) in names:
            name = names[int(sensor.type[0])]
            base = self._of_base(name)
            values = None if base is None else self._at_site(name, base, site)
        if values is None or part.term.frame != "world":
            return values
        if turn is None or int(model.site_bodyid[site]) != self.plan.root:
            return None
        return np.einsum("nij,nj->ni", turn @ _rotation(model.site_quat[site]), values)

    def _base(self, part: Part) -> FloatArray | None:
        name = {
            "base_lin_vel": "velocity", "base_ang_vel": "omega", "projected_gravity": "gravity"
        }.get(part.term.name, "")  # fmt: skip
        values, turn, frame = self._of_base(name), self.attitude, part.term.frame
        if values is None or frame == "body" or (frame == "world" and name == "gravity"):
            return values
        if frame == "world":
            return None if turn is None else np.einsum("nij,nj->ni", turn, values)
        return self._at_site(name, values, int(self.robot.model.site(frame).id))

    def _of_base(self, name: str) -> FloatArray | None:
        """Return (n, 3) a vector of the base in its axes; gravity and velocity also by the attitude."""
        values, turn = self.channel(name), self.attitude
        if values is not None or turn is None:
            return values
        if name == "gravity":
            return -turn[:, 2]
        each = [self.channel(one) for one in ("vx", "vy", "vz")]
        if name != "velocity" or any(one is None for one in each):
            return None
        heading = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
        forward, left, up = (np.asarray(one)[:, 0] for one in each)
        c, s = np.cos(heading), np.sin(heading)
        world = np.stack([c * forward - s * left, s * forward + c * left, up], axis=1)
        return np.einsum("nji,nj->ni", turn, world)

    def _at_site(self, name: str, values: FloatArray, site: int) -> FloatArray | None:
        """Return (n, 3) a vector of the base in axes of a site; None for a site on another body."""
        model = self.robot.model
        if int(model.site_bodyid[site]) != self.plan.root:
            return None
        if name == "velocity":
            omega = self.channel("omega")
            if omega is None:
                return None
            values = values + np.cross(omega, model.site_pos[site])
        return values @ _rotation(model.site_quat[site])


def stated_gains(model: Any, plan: Plan) -> FloatArray:
    """Return (n, 2) kp and kd of the joints of the policy; NaN where no law states them."""
    if plan.law.pd != "model":
        return np.stack([plan.law.stiffness, plan.law.damping], axis=1)
    actuators = plan.joints.actuators
    gear = model.actuator_gear[actuators, 0]
    gains = np.stack(
        [model.actuator_gainprm[actuators, 0] * gear, -model.actuator_biasprm[actuators, 2] * gear**2], 1
    )
    return np.where((model.actuator_biasprm[actuators, 1] < 0.0)[:, None], gains, np.nan)


def reached(model: Any, plan: Plan, target: FloatArray) -> FloatArray:
    """Return (n, joints) the targets within the limits that a model's own actuators have for them, in policy order."""
    actuators = plan.joints.actuators
    limited = (
        model.actuator_ctrllimited[actuators].astype(bool) & plan.law.has_target & (plan.law.pd == "model")
    )
    low, high = model.actuator_ctrlrange[actuators].T
    return np.clip(target, np.where(limited, low, -np.inf), np.where(limited, high, np.inf))


def _rotation(quaternion: Any) -> FloatArray:
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, quaternion)
    return turn.reshape(3, 3)
