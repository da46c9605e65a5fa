"""Rigid-body quantities that one control tick needs, computed by Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from s2r_sim import pinocchio_model, rotation
from s2r_sim.figures import LEGS, Robot
from s2r_sim.physics import State

FloatArray = NDArray[np.float64]

_WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class RigidBody:
    """The controller's picture of the robot at one measured state.

    Base twists and wrenches are in base axes; foot quantities in world axes.

    Attributes:
        twist: (18,) base linear and angular velocity in base axes, joint speeds.
        mass_matrix: (18, 18), symmetric.
        bias: (18,) Coriolis, centrifugal and gravity forces.
        jacobian: (12, 18) foot velocities per twist; a leg's rows have only its own joints' columns.
        base_jacobian, leg_jacobian: (12, 6) and (12, 12), its two parts.
        drift: (12,) foot acceleration at zero joint and base acceleration (J̇ v).
        feet, feet_velocity: (12,) ball centres [m], [m/s].
        thighs: (12,) thigh joint positions [m].
    """

    def __init__(self, robot: Robot, rotor_inertia: float) -> None:
        self._model = pinocchio_model.build(robot, rotor_inertia)
        self._data = self._model.createData()
        self._q = np.zeros(19)
        self._no_acceleration = np.zeros(18)
        self._legs = tuple(
            (self._model.getFrameId(name), slice(3 * leg, 3 * leg + 3), slice(6 + 3 * leg, 9 + 3 * leg))
            for leg, name in enumerate(pinocchio_model.FEET)
        )
        # These are live views of Pinocchio's own memory: taking them once saves a wrapper per tick.
        thighs = [self._model.getJointId(f"{leg.name}_thigh_joint") for leg in LEGS]
        self._foot_views = [self._data.oMf[frame].translation for frame, _, _ in self._legs]
        self._thigh_views = [self._data.oMi[joint].translation for joint in thighs]
        self._below_diagonal = np.tril(np.ones((18, 18), dtype=bool), -1)
        self.twist = np.zeros(18)
        self.mass_matrix: FloatArray = self._data.M
        self.bias: FloatArray = self._data.nle
        self.jacobian = np.zeros((12, 18))
        self.base_jacobian = self.jacobian[:, :6]
        self.leg_jacobian = self.jacobian[:, 6:]
        self.drift = np.zeros(12)
        self.feet = np.zeros(12)
        self.feet_velocity = np.zeros(12)
        self.thighs = np.zeros(12)

    def update(self, state: State) -> None:
        """Compute everything at this state."""
        model, data, q, twist = self._model, self._data, self._q, self.twist
        roll, pitch, yaw = state.rpy.tolist()
        q[:3] = state.position
        q[3:7] = rotation.quaternion(roll, pitch, yaw)
        q[7:] = state.q
        twist[:3] = state.velocity @ rotation.matrix(roll, pitch, yaw)
        twist[3:6] = state.omega
        twist[6:] = state.dq

        pin.crba(model, data, q)
        # crba fills the upper triangle only.
        np.copyto(self.mass_matrix, self.mass_matrix.T, where=self._below_diagonal)
        pin.nonLinearEffects(model, data, q, twist)
        pin.forwardKinematics(model, data, q, twist, self._no_acceleration)
        pin.computeJointJacobians(model, data)
        pin.updateFramePlacements(model, data)
        for frame, rows, joints in self._legs:
            jacobian = pin.getFrameJacobian(model, data, frame, _WORLD)
            self.base_jacobian[rows] = jacobian[:3, :6]
            self.jacobian[rows, joints] = jacobian[:3, joints]
            self.drift[rows] = pin.getFrameClassicalAcceleration(model, data, frame, _WORLD).linear
        np.matmul(self.jacobian, twist, out=self.feet_velocity)
        np.concatenate(self._foot_views, out=self.feet)
        np.concatenate(self._thigh_views, out=self.thighs)
