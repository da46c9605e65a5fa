"""Rigid-body quantities of one control tick, computed by Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from s2r_sim.controller.foot_jacobian import at_feet
from s2r_sim.robot import pinocchio_model
from s2r_sim.robot.constants import LEGS, FloatArray, Robot
from s2r_sim.robot.rotation import to_pinocchio
from s2r_sim.robot.signals import RobotState


class RigidBody:
    """Kinematics and dynamics of the controller's model at one measured state.

    Base twists and wrenches are in base axes; foot quantities in world axes.

    Attributes:
        twist: (18,) base linear and angular velocity in base axes, joint speeds.
        mass_upper: (18, 18) mass matrix; the part below the diagonal is undefined.
        bias: (18,) Coriolis, centrifugal and gravity forces.
        jacobian: (12, 18) foot velocities per twist; a leg's rows have only its own joints' columns.
        base_jacobian, leg_jacobian: (12, 6) and (12, 12), its two parts.
        known: (3, 12) motion of the feet without the joints: their acceleration at zero joint and base
            acceleration (J̇ v), zero, and their velocity at zero joint speed.
        drift: (12,) the first row of ``known``.
        legs: (3, 4, 3) ball centres and thigh joint positions [m], velocities of the ball centres [m/s].
        feet, thighs, speeds: (4, 3), its three parts.
    """

    def __init__(self, robot: Robot, rotor_inertia: float) -> None:
        self._model = pinocchio_model.build(robot, rotor_inertia)
        self._data = self._model.createData()
        self._q = np.zeros(19)
        feet = [self._model.getFrameId(name) for name in pinocchio_model.FEET]
        thighs = [self._model.getJointId(f"{leg.name}_thigh_joint") for leg in LEGS]
        # Live views of Pinocchio's memory: to take them once saves the wrapper objects of every tick.
        self._points = [self._data.oMf[frame].translation for frame in feet]
        self._points += [self._data.oMi[joint].translation for joint in thighs]
        self._bodies: FloatArray = self._data.J
        self.legs = np.zeros((3, 4, 3))
        self.feet, self.thighs, self.speeds = self.legs
        self._at = self.legs[:2].reshape(24)
        self.twist = np.zeros(18)
        self.mass_upper: FloatArray = self._data.M
        self.bias: FloatArray = self._data.nle
        self.jacobian = np.zeros((12, 18))
        self.base_jacobian = self.jacobian[:, :6]
        self.leg_jacobian = self.jacobian[:, 6:]
        self.known = np.zeros((3, 12))
        self.drift = self.known[0]

    @property
    def mass_matrix(self) -> FloatArray:
        """A (18, 18) copy of the mass matrix, symmetric."""
        upper = np.triu(self.mass_upper)
        return upper + np.triu(upper, 1).T

    def update(self, state: RobotState) -> None:
        """Compute all attributes at this state."""
        model, data, q, twist = self._model, self._data, self._q, self.twist
        to_pinocchio(state.flat, q, twist)
        # In this convention the algorithm also leaves the bodies' Jacobian behind.
        pin.crba(model, data, q, pin.Convention.WORLD)
        pin.nonLinearEffects(model, data, q, twist)
        pin.updateFramePlacements(model, data)
        np.concatenate(self._points, out=self._at)
        at_feet(self._bodies, self.feet, twist, self.jacobian, self.speeds, self.known)
