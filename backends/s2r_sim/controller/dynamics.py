"""Rigid-body quantities of one control tick, computed by Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from s2r_sim.robot import pinocchio_model
from s2r_sim.robot.constants import LEGS, FloatArray, Robot
from s2r_sim.robot.rotation import to_pinocchio
from s2r_sim.robot.signals import RobotState
from s2r_spec.compiled import compiled


class RigidBody:
    """Kinematics and dynamics of the controller's model at one measured state.

    Base twists and wrenches are in base axes; foot quantities in world axes.

    Attributes:
        twist: (18,) base linear and angular velocity in base axes, joint speeds.
        mass_upper: (18, 18) mass matrix; the part below the diagonal is undefined.
        bias: (18,) Coriolis, centrifugal and gravity forces.
        jacobian: (12, 18) foot velocities per twist; a leg's rows have only its own joints' columns.
        base_jacobian, leg_jacobian: (12, 6) and (12, 12), its two parts.
        motion: mass matrix, bias and Jacobian.
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
        self._bodies = self._data.J, _positions(self._data.oMf, feet), _positions(self._data.oMi, thighs)
        self.legs = np.zeros((3, 4, 3))
        self.feet, self.thighs, self.speeds = self.legs
        self.twist = np.zeros(18)
        self.mass_upper: FloatArray = self._data.M
        self.bias: FloatArray = self._data.nle
        self.jacobian = np.zeros((12, 18))
        self.base_jacobian = self.jacobian[:, :6]
        self.leg_jacobian = self.jacobian[:, 6:]
        self.known = np.zeros((3, 12))
        self.drift = self.known[0]
        self.motion = self.mass_upper, self.bias, self.jacobian

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
        at_feet(self._bodies, twist, self.jacobian, self.legs, self.known)


def _positions(placements: Any, indices: list[int]) -> FloatArray:
    """Return a live (n, 3) view of the positions of n of Pinocchio's placements, equally far apart in its memory."""
    positions = [placements[k].translation for k in indices]
    first, *others = places = [one.ctypes.data for one in positions]
    stride = others[0] - first
    assert places == [first + k * stride for k in range(len(places))], "they are not equally far apart"
    return as_strided(positions[0], (len(indices), 3), (stride, positions[0].itemsize))


@compiled
def add_cross(total: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Add a × b to a (3,) total."""
    total[0] += a[1] * b[2] - a[2] * b[1]
    total[1] += a[2] * b[0] - a[0] * b[2]
    total[2] += a[0] * b[1] - a[1] * b[0]


@compiled
def at_feet(
    bodies: tuple[FloatArray, FloatArray, FloatArray],
    twist: FloatArray,
    jacobian: FloatArray,
    legs: FloatArray,
    known: FloatArray,
) -> None:
    """Move the bodies' Jacobian from the world's origin to the feet, v = v₀ + ω × p, and the motion with it.

    A foot's drift J̇ v is its acceleration while joints and base have none. The
    motion m of its parent link turns the spatial velocity s of every joint. Their sum
    Σ m × s is a spatial acceleration (a₀, α). At the foot it is a₀ + α × p + ω × v.

    Args:
        bodies: (6, 18) spatial velocity J at the world's origin per twist, where a body moves with its own joints'
            columns only; (4, 3) positions of the feet and (4, 3) of the thigh joints [m].
        twist: (18,) velocity of base and joints.
        jacobian: (12, 18) on return that of the feet; the columns of other legs do not change.
        legs: (3, 4, 3) on return both positions, and the velocities of the feet [m/s].
        known: (3, 12) on return the drift, and the feet's velocity at zero joint speed; row 1 does not change.
    """
    J, feet, thighs = bodies
    legs[0], legs[1], speeds = feet, thighs, legs[2]
    s, m, a = np.empty(6), np.empty(6), np.empty(6)
    for leg in range(4):
        row, foot = 3 * leg, feet[leg]
        x, y, z = foot
        m[:], a[:] = 0.0, 0.0
        for k in range(9):
            column = k if k < 6 else row + k
            jacobian[row, column] = J[0, column] + (J[4, column] * z - J[5, column] * y)
            jacobian[row + 1, column] = J[1, column] + (J[5, column] * x - J[3, column] * z)
            jacobian[row + 2, column] = J[2, column] + (J[3, column] * y - J[4, column] * x)
            for i in range(6):
                s[i] = J[i, column] * twist[column]
            if k >= 6:
                add_cross(a[:3], m[3:], s[:3])
                add_cross(a[:3], m[:3], s[3:])
                add_cross(a[3:], m[3:], s[3:])
            for i in range(6):
                m[i] += s[i]
            if k == 5:
                known[2, row : row + 3] = m[:3]
                add_cross(known[2, row : row + 3], m[3:], foot)
        speeds[leg] = m[:3]
        add_cross(speeds[leg], m[3:], foot)
        known[0, row : row + 3] = a[:3]
        add_cross(known[0, row : row + 3], a[3:], foot)
        add_cross(known[0, row : row + 3], m[3:], speeds[leg])
