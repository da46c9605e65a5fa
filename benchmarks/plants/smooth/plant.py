"""The smooth plant: Pinocchio's rigid bodies, Kelvin–Voigt feet and tanh friction, 0.5 ms semi-implicit steps.

Laws (``laws.py`` has them in code):

    contact     N = max(0, k δ + c δ̇), no adhesion; friction μ N tanh(|s| / v_s); both at the step's end
    joints      F tanh(q̇ / v_j) + b q̇, in the step implicit
    drives      the motor law at 2 kHz on 16-bit encoders, with speeds by filtered differences; a first-order
                current loop, and at most 2 (1 − |q̇| / 21 rad/s) of the largest torque while driving
    motion      v' = v + dt M⁻¹(τ − h) + M⁻¹ Jᵀ λ, then q' = q ⊕ dt v'

A held base is exactly at rest. There are no ends of joints, no torsional friction, and the trunk touches nothing.
"""

from __future__ import annotations

from collections import deque
from math import cos, radians, sin, sqrt
from types import MappingProxyType

import numpy as np
import pinocchio as pin
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.plants.machine import Machine, bodies
from benchmarks.plants.robot import A1, RATE, Inertia, MotorCommand
from benchmarks.plants.smooth.laws import advance, drive

FloatArray = NDArray[np.float64]

STEP = 0.0005
"""Definition: duration of a step [s]."""
STEPS = round(1.0 / (RATE * STEP))
ARMATURE, DRY, VISCOUS = 0.005, 0.1, 0.05
"""Definitions: inertia [kg m²], Coulomb friction [N m] and viscous friction [N m s/rad] of a joint."""
FRICTION = 0.8
"""Definition: friction coefficient of rubber on the ground."""
STIFFNESS, DAMPING = 6e4, 150.0
"""Definitions: of a foot [N/m] and [N s/m]. A quarter of the robot sinks 0.6 mm. Doubled, half as far."""
SOIL = 85.0
"""Definition: load [N] under which soft ground gives way by its ``sink``. Half the robot then sinks by 0.8 of it.

Source: of the simulator's feet, that part is 0.55 in standing and 0.64 in the trot (``compare.py``).
"""
SOIL_DAMPING = 0.7
"""Definition: damping ratio of half the robot on soft ground. Turf dissipates; doubled, the robot sinks more slowly."""
DRAG_HEIGHT = 0.06
"""Definition: height of the ball's centre under which a foot is dragged [m], by the catalogue."""
PAYLOAD_HEIGHT = 0.08
"""Definition: height of a payload above the base's origin [m], by the catalogue."""


class Plant:
    """One machine on its ground; see :class:`benchmarks.plants.rollout.Body`."""

    instruments = MappingProxyType(
        {
            **dict.fromkeys(("x", "y", "z", "height"), 1e-4),
            **dict.fromkeys(("vx", "vy", "vz"), 1e-3),
            **{"foot_position": 2e-4, "foot_velocity": 2e-3, "foot_force": 0.5, "tau": 0.03},
        }
    )

    def __init__(self, machine: Machine, held: bool, rng: Generator) -> None:
        self._machine = machine
        self._free = 6 if held else 0
        self._model = _model(machine)
        self._data = self._model.createData()
        self._feet = [self._model.getFrameId(f"foot {leg}") for leg in range(4)]
        self._friction = np.array(
            [
                machine.friction(DRY, machine["dry_friction.torque"]),
                machine.friction(VISCOUS, machine["viscous_friction.coefficient"]),
            ]
        )
        self._ground = _ground(machine, held)
        self._offset = np.tile([machine[f"encoder_offset.{joint}"] for joint in ("hip", "thigh", "calf")], 4)
        self._strength, self._constant = machine["motor_strength.factor"], machine["torque_constant.factor"]
        self._delay = round(machine["latency.delay"] / STEP)
        self.q, self.v = pin.neutral(self._model), np.zeros(18)

    def place(self, height: float, q: FloatArray) -> None:
        self.q, self.v = pin.neutral(self._model), np.zeros(18)
        self.q[2], self.q[7:] = height, q
        self._drives = np.zeros((4, 12))
        self._law = np.zeros((5, 12))
        self._late: deque[tuple[int, FloatArray]] = deque()
        self._now = 0
        self._impulses = np.zeros((4, 3))
        self._read(self._law)
        self._motion()

    def truth(self) -> FloatArray:
        x, y, z, w = self.q[3:7]
        axes = pin.Quaternion(w, x, y, z).toRotationMatrix()
        return np.concatenate(
            (self.q[:3], pin.rpy.matrixToRpy(axes), axes @ self.v[:3], self.v[3:6], self.q[7:], self.v[6:])
        )

    def encoders(self) -> FloatArray:
        # The drives read half a millisecond before the controller's sample, and speeds pass their filter.
        return self._drives[:2].ravel()

    def step(self, motors: MotorCommand) -> None:
        self._late.append((self._now + self._delay, np.array(motors)))
        for _ in range(STEPS):
            while self._late and self._late[0][0] <= self._now:
                self._law = self._late.popleft()[1]
            self._read(self._law)
            torque = self._constant * self._drives[2]
            self.v = advance(
                (self._data.M, self._data.nle, self._data.J),
                self._centres,
                self.v,
                torque,
                self._friction,
                self._ground,
                self._free,
                STEP,
                self._impulses,
            )
            self.q = pin.integrate(self._model, self.q, STEP * self.v)
            self._motion()
            self._now += 1

    def reported(self) -> FloatArray:
        return self._drives[2].copy()

    def foot_force(self) -> FloatArray:
        return (self._impulses / STEP @ self._ground[:9].reshape(3, 3)).ravel()

    def energy(self) -> float:
        """Return kinetic and potential energy [J]."""
        return float(pin.computeMechanicalEnergy(self._model, self._data, self.q, self.v))

    def _read(self, law: FloatArray) -> None:
        drive(law, self._strength, STEP, self.q[7:] + self._offset, self.v[6:], self._drives)

    def _motion(self) -> None:
        """Compute the terms of motion at the present state."""
        pin.computeAllTerms(self._model, self._data, self.q, self.v)
        pin.updateFramePlacements(self._model, self._data)
        self._centres = np.array([self._data.oMf[foot].translation for foot in self._feet])


def _model(machine: Machine) -> pin.Model:
    """Return Pinocchio's model: a free base and twelve joints, legs in the robot's order."""
    at = (machine["payload.x"], machine["payload.y"], PAYLOAD_HEIGHT)
    trunk, legs = bodies(machine, Inertia(machine["payload.mass"], at, 0.0, 0.0, 0.0))
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(base, _inertia(trunk), pin.SE3.Identity())
    for number, links in enumerate(legs):
        parent = base
        for name, inertia, place in links:
            kind = pin.JointModelRX() if name == "hip" else pin.JointModelRY()
            shift = pin.SE3(np.eye(3), np.array(place))
            parent = model.addJoint(parent, kind, shift, f"{name} {number}")
            model.appendBodyToJoint(parent, _inertia(inertia), pin.SE3.Identity())
        foot = pin.SE3(np.eye(3), np.array(A1.foot_offset))
        model.addFrame(pin.Frame(f"foot {number}", parent, foot, pin.FrameType.OP_FRAME))
    model.armature = np.array([0.0] * 6 + [ARMATURE + machine["armature.inertia"]] * 12)
    return model


def _inertia(inertia: Inertia) -> pin.Inertia:
    return pin.Inertia(inertia.mass, np.array(inertia.com), inertia.tensor)


def _ground(machine: Machine, held: bool) -> FloatArray:
    """Return (15,): axes forward, left, normal; μ, stiffness, damping; the foot's radius; drag and its height.

    Soft ground is a spring and damper in series with the rubber's, at frequencies below those of both.
    """
    slope = 0.0 if held else radians(machine["slope.angle"])
    rubber, sink = STIFFNESS * machine.rubber, machine["soft_ground.sink"]
    stiffness, damping = rubber, DAMPING
    if sink > 0.0:
        soil = SOIL / sink
        stiffness = 1.0 / (1.0 / rubber + 1.0 / soil)
        soil_damping = 2.0 * SOIL_DAMPING * sqrt(soil * A1.mass / 2.0)
        damping = DAMPING * (stiffness / rubber) ** 2 + soil_damping * (stiffness / soil) ** 2
    axes = (cos(slope), 0.0, sin(slope), 0.0, 1.0, 0.0, -sin(slope), 0.0, cos(slope))
    mu = FRICTION * machine.ground * machine["ground_friction.factor"]
    return np.array(
        [*axes, mu, stiffness, damping, A1.foot_radius, machine["foot_drag.coefficient"], DRAG_HEIGHT]
    )
