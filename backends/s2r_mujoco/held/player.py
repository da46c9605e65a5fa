"""A held robot that plays targets without a policy: a protocol, or the targets of a log from the state of the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import Any

import mujoco
import numpy as np

from s2r_mujoco.arrays import FloatArray
from s2r_mujoco.channels import joint_channels
from s2r_mujoco.effects.kinds import scales_of
from s2r_mujoco.held.motions import Motion, Reach, motion, protocols
from s2r_mujoco.joints import Joints
from s2r_mujoco.law import servo_gains
from s2r_mujoco.robot import Robot
from s2r_mujoco.rollout import Record
from s2r_mujoco.running import Running
from s2r_mujoco.start import draw
from s2r_spec.effects import Choice, as_values, choose
from s2r_spec.errors import TraceError
from s2r_spec.protocols import PROTOCOL, Protocol
from s2r_spec.protocols import named as protocol_named
from s2r_spec.trace import Trace
from s2r_spec.trace.samples import period_of

BEGIN = 5
"""Budget: first samples of a log whose straight line is the velocity at its begin, where the log has none."""


@dataclass(frozen=True, eq=False)
class Player:
    """A held robot and the rate at which its core simulates it: time of a core for a second [s]."""

    running: Running
    cost: float

    @property
    def robot(self) -> Robot:
        """The robot without its policy."""
        return self.running.robot

    @cached_property
    def order(self) -> Any:
        """(k,) places of the driven joints in the order of the channel ``target``."""
        return np.argsort(self.robot.plan.joints.qpos)

    def protocols(self) -> tuple[Protocol, ...]:
        """Return the protocols."""
        return protocols(self.cost)

    @cached_property
    def reach(self) -> Reach:
        """How far the driven joints may move, in policy order."""
        plan, model = self.robot.plan, self.robot.model
        inertia, torque = scales_of(model, plan, self.robot.pose)
        joints = plan.joints
        slides = model.jnt_type[model.dof_jntid[joints.dof]] == int(mujoco.mjtJoint.mjJNT_SLIDE)
        stiffness, _ = servo_gains(model, plan.law, joints)
        scales = torque[joints.dof], inertia[joints.dof], stiffness
        return Reach.of(plan.pose, joints.low, joints.high, scales, slides)

    def motion(self, name: str, params: Mapping[str, float]) -> tuple[Motion, dict[str, float]]:
        """Return the motion of a protocol, in policy order, and all its parameters; a UsageError for a wrong one."""
        one = protocol_named(self.protocols(), name, self.robot.name)
        values = one.values(params)
        return motion(name, values, one.duration, self.robot.plan.step, self.reach), values

    def playable(self, name: str, params: Mapping[str, float]) -> Trace:
        """Return the references of a protocol: ``q``, ``dq`` = 0, ``kp`` and ``kd``, in the order of ``target``."""
        moved, values = self.motion(name, params)
        plan, order, robot = self.robot.plan, self.order, self.robot
        kp, kd = (one[order] * moved.on[:, None] for one in servo_gains(robot.model, plan.law, plan.joints))
        rotates = next(one for one in robot.channels if one.name == "target").unit == "rad"
        length, force = ("rad", "N*m") if rotates else ("", "")
        q = moved.targets[:, order]
        units = {"q": length, "dq": f"{length}/s", "kp": f"{force}/rad", "kd": f"{force}*s/rad"}
        times = plan.step * np.arange(len(q), dtype=np.float64)
        channels = {"q": q, "dq": np.zeros_like(q), "kp": kp, "kd": kd}
        return Trace(times, channels, units if rotates else {}, {PROTOCOL: name, "params": values})

    def run(self, moved: Motion, seed: int, added: Choice, variant: str) -> Record:
        """Play a protocol from its first pose."""
        robot = self.robot
        pose = robot.pose.copy()
        pose[robot.plan.joints.qpos] = moved.targets[0]
        position, velocity = draw(robot.model, robot.plan, robot.description.table.start, seed)
        start = pose + position, velocity
        return self.running.play(start, moved.targets, moved.on, seed, self.known(added), variant)

    def replay(self, log: Trace, seed: int, added: Choice, variant: str) -> Record:
        """Play the targets of a log from the positions and velocities at its begin; without targets, its torques.

        Raises:
            TraceError: the log has no ``q``, neither ``target`` nor ``tau``, or other joints.
        """
        robot = self.robot
        forces = None if "target" in log.channels else self.forces(log)
        targets = self.targets(log) if forces is None else np.tile(robot.plan.pose, (len(log), 1))
        times, ticks = log.times - log.times[0], ceil(log.duration / robot.plan.step - 1e-6) + 1
        late = robot.plan.step * np.arange(ticks) + 0.5 * period_of(times)
        rows = np.clip(np.searchsorted(times, late, side="right") - 1, 0, len(times) - 1)
        simulator = self.running.simulator({}, self.known(added), variant)
        qpos = robot.pose.copy()
        qvel = np.zeros(robot.model.nv)
        for joints, q, dq in self.states(log):
            zero = 0.0 if simulator.loop is None else simulator.loop.offset[joints.dof]
            qpos[joints.qpos] = q[0] - zero
            first = min(BEGIN, len(q))
            slope = np.polyfit(times[:first], q[:first], 1)[0] if first > 1 else np.zeros(q.shape[1])
            qvel[joints.dof] = slope if dq is None else dq[0]
        on, force = np.full(ticks, forces is None), None if forces is None else forces[rows]
        return self.running.play((qpos, qvel), targets[rows], on, seed, self.known(added), variant, force)

    def targets(self, log: Trace) -> FloatArray:
        """Return (n, k) targets of a log in policy order."""
        if "target" not in log.channels:
            raise TraceError("the log has no channel 'target', so its commands cannot be played")
        values = wide(log, "target")
        if values.shape[1] != self.order.size:
            raise TraceError(
                f"target has {values.shape[1]} columns, and the robot has {self.order.size} driven joints"
            )
        targets = np.empty_like(values)
        targets[:, self.order] = values
        return targets

    def forces(self, log: Trace) -> FloatArray:
        """Return (n, nv) the torques and forces of the actuators that a log has."""
        force = np.zeros((len(log), self.robot.model.nv))
        for position, joints in joint_channels(self.robot.model).items():
            name = f"tau{position.removeprefix('q')}"
            if name not in log.channels or wide(log, name).shape[1] != len(joints):
                raise TraceError(
                    f"the log has neither 'target' nor a channel {name!r} with {len(joints)} columns"
                )
            force[:, joints.dof] = wide(log, name)
        return force

    def states(self, log: Trace) -> list[tuple[Joints, FloatArray, FloatArray | None]]:
        """Return the joints of ``q`` and of ``q_slide`` with (n, j) positions and velocities, which may be missing."""
        found = []
        for name, joints in joint_channels(self.robot.model).items():
            if name not in log.channels or wide(log, name).shape[1] != len(joints):
                raise TraceError(
                    f"the log needs a channel {name!r} with the positions of {len(joints)} joints"
                )
            dq = wide(log, f"d{name}") if f"d{name}" in log.channels else None
            found.append((joints, wide(log, name), dq))
        return found

    def known(self, added: Choice) -> Choice:
        """Return the effects that also the held robot has; those of its base and of its policy do nothing here."""
        have = {effect.name: {p.name for p in effect.parameters} for effect in self.robot.catalogue}
        own = {
            name: {key: value for key, value in values.items() if key in have[name]}
            for name, values in as_values(added).items()
            if name in have
        }
        return choose(self.robot.name, self.robot.catalogue, (), own)


def wide(trace: Trace, name: str) -> FloatArray:
    """Return (n, w) a channel."""
    values = np.asarray(trace[name], dtype=np.float64)
    return values.reshape(len(values), -1)
