"""Rigid-body quantities that one control tick needs, computed by Pinocchio."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from s2r_sim import pinocchio_model, rotation
from s2r_sim.figures import LEGS, Robot
from s2r_sim.physics import State

FloatArray = NDArray[np.float64]

_WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

# Where (x, y, z) of the feet stand in (12, 6) rows of (I, −[p]×): flat places, which number, with which sign.
_ENTRIES = [
    (6 * (3 * leg + row) + 3 + column, 3 * leg + axis, sign)
    for leg in range(len(LEGS))
    for row, column, axis, sign in (
        (0, 1, 2, 1.0),
        (0, 2, 1, -1.0),
        (1, 0, 2, -1.0),
        (1, 2, 0, 1.0),
        (2, 0, 1, 1.0),
        (2, 1, 0, -1.0),
    )
]
_CROSS, _OF_FOOT, _SIGN = (np.array(column) for column in zip(*_ENTRIES, strict=True))


class RigidBody:
    """The controller's picture of the robot at one measured state.

    Base twists and wrenches are in base axes; foot quantities in world axes.

    Attributes:
        twist: (18,) base linear and angular velocity in base axes, joint speeds.
        mass_upper: (18, 18) mass matrix; what is below the diagonal is undefined.
        bias: (18,) Coriolis, centrifugal and gravity forces.
        jacobian: (12, 18) foot velocities per twist; a leg's rows have only its own joints' columns.
        base_jacobian, leg_jacobian: (12, 6) and (12, 12), its two parts.
        known: (3, 12) what the joints need not bring about: the feet's acceleration at zero joint and base
            acceleration (J̇ v), zero, and their velocity if the joints stood still.
        drift: (12,) the first row of it.
        feet, feet_velocity: (12,) ball centres [m], [m/s].
        thighs: (12,) thigh joint positions [m].
    """

    def __init__(self, robot: Robot, rotor_inertia: float) -> None:
        self._model = pinocchio_model.build(robot, rotor_inertia)
        self._data = self._model.createData()
        self._q = np.zeros(19)
        self._no_acceleration = np.zeros(18)
        feet = [self._model.getFrameId(name) for name in pinocchio_model.FEET]
        # These are live views of Pinocchio's own memory: taking them once saves a wrapper per tick.
        thighs = [self._model.getJointId(f"{leg.name}_thigh_joint") for leg in LEGS]
        self._foot_views = [self._data.oMf[frame].translation for frame in feet]
        self._thigh_views = [self._data.oMi[joint].translation for joint in thighs]
        self._world_jacobian: FloatArray = self._data.J
        self._to_feet = np.tile(np.eye(3, 6), (4, 1))
        self._own = np.hstack([np.ones((12, 6)), np.kron(np.eye(4), np.ones((3, 3)))])
        self.twist = np.zeros(18)
        self.base_twist = self.twist[:6]
        self.mass_upper: FloatArray = self._data.M
        self.bias: FloatArray = self._data.nle
        self.jacobian = np.zeros((12, 18))
        self.base_jacobian = self.jacobian[:, :6]
        self.leg_jacobian = self.jacobian[:, 6:]
        self.known = np.zeros((3, 12))
        self.drift, self._carried = self.known[0], self.known[2]
        self._drifts = [(frame, self.drift[3 * leg : 3 * leg + 3]) for leg, frame in enumerate(feet)]
        self.feet = np.zeros(12)
        self.feet_velocity = np.zeros(12)
        self.thighs = np.zeros(12)

    @property
    def mass_matrix(self) -> FloatArray:
        """A (18, 18) copy of the mass matrix, symmetric."""
        upper = np.triu(self.mass_upper)
        return upper + np.triu(upper, 1).T

    def update(self, state: State) -> None:
        """Compute everything at this state."""
        model, data, q, twist = self._model, self._data, self._q, self.twist
        roll, pitch, yaw = state.rpy.tolist()
        q[:3] = state.position
        q[3:7] = rotation.quaternion(roll, pitch, yaw)
        q[7:] = state.q
        twist[:3] = rotation.turned_back(roll, pitch, yaw, state.velocity.tolist(), sin, cos)
        twist[3:6] = state.omega
        twist[6:] = state.dq

        pin.crba(model, data, q)
        pin.nonLinearEffects(model, data, q, twist)
        pin.forwardKinematics(model, data, q, twist, self._no_acceleration)
        pin.computeJointJacobians(model, data)
        pin.updateFramePlacements(model, data)
        np.concatenate(self._foot_views, out=self.feet)
        np.concatenate(self._thigh_views, out=self.thighs)
        self._foot_jacobians()
        np.matmul(self.jacobian, twist, out=self.feet_velocity)
        np.matmul(self.base_jacobian, self.base_twist, out=self._carried)
        for frame, drift in self._drifts:
            drift[:] = pin.getFrameClassicalAcceleration(model, data, frame, _WORLD).linear

    def _foot_jacobians(self) -> None:
        """Move the bodies' common Jacobian from the world's origin to the feet, v = v₀ − [p]× ω, all in one product.

        Asking Pinocchio for every foot's costs four wrappers and eight copies.
        """
        self._to_feet.put(_CROSS, self.feet.take(_OF_FOOT) * _SIGN)
        np.matmul(self._to_feet, self._world_jacobian, out=self.jacobian)
        self.jacobian *= self._own
