"""Rigid-body quantities that one control tick needs, computed by Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from s2r_sim import pinocchio_model, rotation
from s2r_sim.figures import LEGS, Robot
from s2r_sim.physics import State

FloatArray = NDArray[np.float64]


class RigidBody:
    """The controller's picture of the robot at one measured state.

    Base twists and wrenches are in base axes; foot quantities in world axes.

    Attributes:
        rotation: (3, 3) base axes to world axes.
        twist: (18,) base linear and angular velocity in base axes, joint speeds.
        mass_matrix: (18, 18), symmetric.
        bias: (18,) Coriolis, centrifugal and gravity forces.
        base_jacobian: (12, 6) foot velocities per base twist.
        leg_jacobian: (12, 12) foot velocities per joint speed, block diagonal.
        drift: (12,) foot acceleration at zero joint and base acceleration (J̇ v).
        feet, feet_velocity: (4, 3) ball centres [m], [m/s].
        thighs: (4, 3) thigh joint positions [m].
    """

    def __init__(self, robot: Robot, rotor_inertia: float) -> None:
        self._model = pinocchio_model.build(robot, rotor_inertia)
        self._data = self._model.createData()
        self._q = np.zeros(19)
        self._no_acceleration = np.zeros(18)
        self._frames = tuple(self._model.getFrameId(name) for name in pinocchio_model.FEET)
        # These are live views of Pinocchio's own memory: taking them once saves a wrapper per tick.
        thighs = [self._model.getJointId(f"{leg.name}_thigh_joint") for leg in LEGS]
        self._foot_views = [self._data.oMf[frame].translation for frame in self._frames]
        self._thigh_views = [self._data.oMi[joint].translation for joint in thighs]
        self._upper = np.triu(np.ones((18, 18)))
        self._strict_upper = np.triu(np.ones((18, 18)), 1)
        self.weight = float(pin.computeTotalMass(self._model)) * 9.81
        self.rotation: FloatArray = np.eye(3)
        self.twist = np.zeros(18)
        self.mass_matrix = np.zeros((18, 18))
        self.bias = np.zeros(18)
        self.base_jacobian = np.zeros((12, 6))
        self.leg_jacobian = np.zeros((12, 12))
        self.drift = np.zeros(12)
        self.feet = np.zeros((4, 3))
        self.feet_velocity = np.zeros((4, 3))
        self.thighs = np.zeros((4, 3))

    def update(self, state: State) -> None:
        """Compute everything at this state."""
        model, data, q, twist = self._model, self._data, self._q, self.twist
        roll, pitch, yaw = state.rpy.tolist()
        self.rotation = rotation.matrix(roll, pitch, yaw)
        q[:3] = state.position
        q[3:7] = rotation.quaternion(roll, pitch, yaw)
        q[7:] = state.q
        twist[:3] = self.rotation.T @ state.velocity
        twist[3:6] = state.omega
        twist[6:] = state.dq

        pin.crba(model, data, q)
        # crba leaves the lower triangle undefined.
        np.multiply(data.M, self._upper, out=self.mass_matrix)
        self.mass_matrix += (data.M * self._strict_upper).T
        self.bias = pin.nonLinearEffects(model, data, q, twist)
        pin.forwardKinematics(model, data, q, twist, self._no_acceleration)
        pin.computeJointJacobians(model, data)
        pin.updateFramePlacements(model, data)
        self._read_feet(model, data)

    def _read_feet(self, model: Any, data: Any) -> None:
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for leg, frame in enumerate(self._frames):
            rows = slice(3 * leg, 3 * leg + 3)
            columns = slice(6 + 3 * leg, 9 + 3 * leg)
            jacobian = pin.getFrameJacobian(model, data, frame, world)
            self.base_jacobian[rows] = jacobian[:3, :6]
            self.leg_jacobian[rows, rows] = jacobian[:3, columns]
            self.drift[rows] = pin.getFrameClassicalAcceleration(model, data, frame, world).linear
            self.feet[leg] = self._foot_views[leg]
            self.thighs[leg] = self._thigh_views[leg]
        velocity = self.base_jacobian @ self.twist[:6] + self.leg_jacobian @ self.twist[6:]
        self.feet_velocity[:] = velocity.reshape(4, 3)
