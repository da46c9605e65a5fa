"""The recorder: it stores the states and decisions of every control tick, and computes the channels at the end."""

from __future__ import annotations

from typing import Any

import numpy as np

from s2r_sim.controller.trot import Tick
from s2r_sim.plant import terrain
from s2r_sim.plant.channels import TRUE_CHANNELS
from s2r_sim.plant.physics import Physics
from s2r_sim.robot.constants import LEGS, FloatArray, Robot
from s2r_sim.robot.leg_kinematics import foot_motion
from s2r_sim.robot.rotation import rotate
from s2r_sim.robot.signals import RobotState, VelocityCommand

_NO_BASE = np.zeros(6)


class Recorder:
    """Stores references tick by tick and computes over whole arrays once, in a tenth of the time.

    A row is a plain tuple of numbers and arrays: Python's garbage collector does not visit it again and again.
    """

    def __init__(self, robot: Robot, physics: Physics, command: VelocityCommand, truth: bool = False) -> None:
        """Record a rollout under one command; with ``truth``, also the :data:`TRUE_CHANNELS`."""
        self._robot = robot
        self._physics = physics
        self._command = command
        self._with_truth = truth
        self._rows: list[tuple[Any, ...]] = []

    def write(
        self, truth: RobotState, own: RobotState, done: Tick, torque: FloatArray, foot_forces: FloatArray
    ) -> None:
        """Append a tick; ``own`` is the state from the robot's own sensors. The arrays must not change afterwards."""
        solution, states = done.solution, (truth.flat, own.flat, torque, foot_forces)
        base, iterations = (_NO_BASE, 0) if solution is None else (solution.base, solution.iterations)
        self._rows.append((*states, base, *done.motors, done.stance, iterations, solution is not None))

    @property
    def qp_failures(self) -> int:
        """Number of ticks without a solution of the QP."""
        return sum(not row[-1] for row in self._rows)

    def channels(self, estimate: FloatArray, fallen: bool) -> dict[str, FloatArray]:
        """Return name → (n,) or (n, width) samples, in the order of ``CHANNELS``, then of ``TRUE_CHANNELS``.

        Joints, attitude, rates and the controller's results are those of the robot's own sensors. Base,
        feet and ground are true, as motion capture measures them from outside.

        Args:
            estimate: (n, 3) the robot's own estimate of its velocity, world axes [m/s].
            fallen: whether the robot has fallen at the last sample.
        """
        n = len(self._rows)
        true_states, own_states, torque, foot_forces, base, *motors, stance, iterations, solved = zip(
            *self._rows, strict=True
        )
        truth = RobotState(np.array(true_states).T)
        # Without sensor errors they are the same arrays.
        own = truth if own_states[0] is true_states[0] else RobotState(np.array(own_states).T)
        roll, pitch, yaw = own.rpy
        vx, vy, vz = truth.velocity
        own_x, own_y, _ = estimate.T
        foot_position, foot_velocity = self._feet(truth)
        foot_force = np.array(foot_forces)
        channels = {
            "vx": np.cos(yaw) * vx + np.sin(yaw) * vy,
            "vy": np.cos(yaw) * vy - np.sin(yaw) * vx,
            "vz": vz,
            "wz": yaw_rate(own),
            "vx_cmd": np.full(n, self._command.vx),
            "vy_cmd": np.full(n, self._command.vy),
            "wz_cmd": np.full(n, self._command.wz),
            "vx_est": np.cos(yaw) * own_x + np.sin(yaw) * own_y,
            "vy_est": np.cos(yaw) * own_y - np.sin(yaw) * own_x,
            "x": truth.position[0],
            "y": truth.position[1],
            "z": truth.position[2],
            "height": truth.position[2] - terrain.mean_height(self._physics, 1.0) * truth.position[0],
            "roll": roll,
            "pitch": pitch,
            "yaw": yaw,
            "omega": own.omega.T,
            "acc_pred": _predicted(own, np.array(base), np.array(solved)),
            "qp_iterations": np.array(iterations, dtype=float),
            "qp_solved": np.array(solved, dtype=float),
            "fallen": np.append(np.zeros(n - 1), float(fallen)),
            "stance": np.array(stance, dtype=float),
            "q": own.q.T,
            "dq": own.dq.T,
            "tau_cmd": _commanded(own, *(np.array(rows) for rows in motors)),
            "tau": np.array(torque),
            "foot_position": foot_position,
            "foot_velocity": foot_velocity,
            "foot_force": foot_force,
            "contact": (foot_force[:, 2::3] > 0.0).astype(float),
        }
        if self._with_truth:
            values = (truth.q.T, truth.dq.T, truth.rpy[0], truth.rpy[1], yaw_rate(truth))
            channels |= {channel.name: one for channel, one in zip(TRUE_CHANNELS, values, strict=True)}
        return channels

    def _feet(self, truth: RobotState) -> tuple[FloatArray, FloatArray]:
        """Return (n, 12) true positions [m] and (n, 12) velocities [m/s] of the ball centres, world axes."""
        n = truth.flat.shape[1]
        motions = [
            foot_motion(self._robot, leg, truth.q[k : k + 3], truth.dq[k : k + 3], np.sin, np.cos)
            for k, leg in zip(range(0, 12, 3), LEGS, strict=True)
        ]
        position = np.stack([motion.position for motion in motions], axis=1)
        velocity = np.stack([motion.velocity for motion in motions], axis=1)
        moved = np.cross(truth.omega[:, None], position, axis=0) + velocity
        roll, pitch, yaw = truth.rpy
        position = truth.position[:, None] + rotate(roll, pitch, yaw, position, np.sin, np.cos)
        velocity = truth.velocity[:, None] + rotate(roll, pitch, yaw, moved, np.sin, np.cos)
        return position.T.reshape(n, 12), velocity.T.reshape(n, 12)


def _predicted(own: RobotState, base: FloatArray, solved: FloatArray) -> FloatArray:
    """Return (n, 3) the base acceleration that the QP predicts, forward, left, up [m/s²]; 0 without one.

    In the robot's own heading frame, level by its own attitude. ``base`` (n, 6) is spatial, in base axes.
    """
    roll, pitch, yaw = own.rpy
    # Spatial and classical acceleration differ by ω × v; pitch and roll alone lead to the heading frame.
    forward, left, up = rotate(roll, pitch, 0.0, base.T[:3], np.sin, np.cos)
    wx, wy, wz = rotate(roll, pitch, 0.0, own.omega, np.sin, np.cos)
    vx, vy, vz = rotate(0.0, 0.0, -yaw, own.velocity, np.sin, np.cos)
    acceleration = (forward + wy * vz - wz * vy, left + wz * vx - wx * vz, up + wx * vy - wy * vx)
    return np.where(solved, acceleration, 0.0).T


def _commanded(
    own: RobotState, q: FloatArray, dq: FloatArray, kp: FloatArray, kd: FloatArray, tau: FloatArray
) -> FloatArray:
    """Return (n, 12) torque commands of the motors' own loops, from encoder readings, before saturation [N m]."""
    return tau + kp * (q - own.q.T) + kd * (dq - own.dq.T)


def yaw_rate(state: RobotState) -> FloatArray:
    """Return (n,) the rate of the heading [rad/s] of n states."""
    roll, pitch, _ = state.rpy
    wx, wy, wz = state.omega
    return np.cos(pitch) * (np.sin(roll) * wy + np.cos(roll) * wz) - np.sin(pitch) * wx
