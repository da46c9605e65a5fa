"""The stiff plant: MuJoCo with fourth-order Runge–Kutta, pyramids of friction without creep, and sampled drives.

Laws:

    contact     feet are short capsules; a stiff constraint of constant impedance, stiffness and damping given directly;
                a pyramid of friction and MuJoCo's no-slip iterations, so that loaded feet do not creep
    joints      dry friction of a constraint, F (1 + s exp(−(q̇ / v_s)²)) + η |τ|, and fluid friction −b |q̇|^0.9
    drives      the motor law at 1 kHz; the torque of one sample acts during the next (nominal), in steps of 1/64 N m
    motion      Runge–Kutta of fourth order at 1 ms

A held base is part of the world.
"""

from __future__ import annotations

from collections import deque
from math import cos, radians, sin, sqrt, tan
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.plants.machine import Link, Machine, bodies
from benchmarks.plants.robot import A1, GRAVITY, LEGS, RATE, Inertia, MotorCommand
from benchmarks.plants.stiff.drives import demand, friction

FloatArray = NDArray[np.float64]

STEP = 0.001
"""Definition: duration of a step, and of a drive's sample [s]."""
STEPS = round(1.0 / (RATE * STEP))
ARMATURE, DRY, VISCOUS = 0.005, 0.08, 0.05
"""Definitions: inertia [kg m²], Coulomb friction [N m] and fluid friction [N m at 1 rad/s] of a joint.

Dry friction with rise at rest and gear loss is on average near the data sheet's 0.1 N m.
"""
FRICTION = 0.8
"""Definition: friction coefficient of rubber on the ground, along the sides of the pyramid."""
FOOT_WIDTH = 0.006
"""Definition: half length of a foot's capsule, across the robot [m]. Doubled, the stance is 6 mm wider at most."""
RATE_SQUARED, DAMPING_RATIO, IMPEDANCE = 8e4, 0.9, 0.95
"""Definitions: stiffness per mass of a contact [1/s²], its damping ratio, and MuJoCo's impedance."""
SOFT_IMPEDANCE, SINKAGE = 0.6, 0.5
"""Definitions: impedance of soft ground, and the depth of a standing foot as part of the catalogue's ``sink``.

Source of the latter: the simulator's feet sink by 0.55 in standing and 0.64 in the trot (``compare.py``).
"""
DRAG_HEIGHT, DRAG_POWER = 0.06, 0.9
"""Definitions: height of the ball's centre under which a foot is dragged [m]; power of speed, per 1 m/s."""
BOX = (0.18, 0.13, 0.08)
"""Definition: sides of a payload [m], a box of even density."""
PAYLOAD_HEIGHT = 0.08
"""Definition: height of a payload's centre above the base's origin [m], by the catalogue."""
_AXES = {"hip": (1.0, 0.0, 0.0), "thigh": (0.0, 1.0, 0.0), "calf": (0.0, 1.0, 0.0)}


class Plant:
    """One machine on its ground; see :class:`benchmarks.plants.rollout.Body`."""

    instruments = MappingProxyType(
        {
            **dict.fromkeys(("x", "y", "z", "height"), 2e-4),
            **dict.fromkeys(("vx", "vy", "vz"), 8e-4),
            **{"foot_position": 3e-4, "foot_velocity": 1e-3, "foot_force": 0.8, "tau": 0.05},
        }
    )

    def __init__(self, machine: Machine, held: bool, rng: Generator) -> None:
        self._machine, self._rng = machine, rng
        self._slope = 0.0 if held else radians(machine["slope.angle"])
        self._model = _model(machine, held, self._slope)
        self.data = mujoco.MjData(self._model)
        self._first, self._free = (0, 0) if held else (7, 6)
        self._feet = [int(self._model.geom(f"{leg.name} foot").id) for leg in LEGS]
        self._calves = [int(self._model.geom_bodyid[foot]) for foot in self._feet]
        self._dry = machine.friction(DRY, machine["dry_friction.torque"])
        self._fluid = machine.friction(VISCOUS, machine["viscous_friction.coefficient"])
        self._offset = np.tile([machine[f"encoder_offset.{joint}"] for joint in ("hip", "thigh", "calf")], 4)
        self._strength, self._constant = machine["motor_strength.factor"], machine["torque_constant.factor"]

    def place(self, height: float, q: FloatArray) -> None:
        mujoco.mj_resetData(self._model, self.data)
        if self._first:
            self.data.qpos[:7] = (0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0)
        else:
            self._model.body("base").pos[2] = height
        self._height = height
        self.data.qpos[self._first :] = q
        self._law = np.zeros((5, 12))
        self._late: deque[tuple[int, FloatArray]] = deque()
        self._now = 0
        self._next = np.zeros(12)
        self._made, self._pushed = np.zeros(12), np.zeros((4, 3))
        mujoco.mj_forward(self._model, self.data)

    def truth(self) -> FloatArray:
        q, v = self.data.qpos[self._first :], self.data.qvel[self._free :]
        if not self._first:
            return np.concatenate(((0.0, 0.0, self._height), np.zeros(9), q, v))
        w, x, y, z = self.data.qpos[3:7].tolist()
        roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return np.concatenate((self.data.qpos[:3], (roll, pitch, yaw), self.data.qvel[:6], q, v))

    def encoders(self) -> FloatArray:
        return np.concatenate((self.data.qpos[self._first :] + self._offset, self.data.qvel[self._free :]))

    def step(self, motors: MotorCommand) -> None:
        self._late.append((self._now + self._delay(), np.array(motors)))
        model, data = self._model, self.data
        self._made[:], self._pushed[:] = 0.0, 0.0
        for _ in range(STEPS):
            while self._late and self._late[0][0] <= self._now:
                self._law = self._late.popleft()[1]
            torque = self._constant * self._next
            read = self.encoders()
            self._made += self._next / STEPS
            self._next = demand(self._law, self._strength, read[:12], read[12:])
            most, fluid = friction(self._dry, self._fluid, torque, data.qvel[self._free :])
            model.dof_frictionloss[self._free :] = most
            data.qfrc_applied[:] = 0.0
            data.qfrc_applied[self._free :] = torque + fluid
            self._drag()
            mujoco.mj_step(model, data)
            self._pushed += data.sensordata.reshape(4, 3) / STEPS
            self._now += 1

    def reported(self) -> FloatArray:
        return self._made.copy()

    def foot_force(self) -> FloatArray:
        return self._pushed.ravel().copy()

    def energy(self) -> float:
        """Return kinetic and potential energy [J]."""
        mujoco.mj_energyPos(self._model, self.data)
        mujoco.mj_energyVel(self._model, self.data)
        return float(self.data.energy.sum())

    def _delay(self) -> int:
        """Return whole steps, rounded at random so that their mean is the latency."""
        return int(self._machine["latency.delay"] / STEP + self._rng.uniform())

    def _drag(self) -> None:
        drag = self._machine["foot_drag.coefficient"]
        if drag == 0.0:
            return
        velocity = np.empty(6)
        for foot, calf in zip(self._feet, self._calves, strict=True):
            at = self.data.geom_xpos[foot]
            if at[2] - tan(self._slope) * at[0] > DRAG_HEIGHT:
                continue
            mujoco.mj_objectVelocity(self._model, self.data, mujoco.mjtObj.mjOBJ_GEOM, foot, velocity, 0)
            speed = max(float(np.linalg.norm(velocity[3:])), 1e-3)
            force = -drag * speed ** (DRAG_POWER - 1.0) * velocity[3:]
            mujoco.mj_applyFT(self._model, self.data, force, np.zeros(3), at, calf, self.data.qfrc_applied)


def _model(machine: Machine, held: bool, slope: float) -> Any:
    """Return the ``MjModel``: without a free joint if the base is held; without actuators."""
    mass, (a, b, c) = machine["payload.mass"], BOX
    at = (machine["payload.x"], machine["payload.y"], PAYLOAD_HEIGHT)
    box = Inertia(mass, at, *(mass / 12.0 * both for both in (b * b + c * c, a * a + c * c, a * a + b * b)))
    trunk, legs = bodies(machine, box)
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    option = spec.option
    option.timestep, option.noslip_iterations, option.iterations = STEP, 3, 30
    option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_ISLAND
    surface = _surface(machine)
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        quat=[cos(slope / 2.0), 0.0, -sin(slope / 2.0), 0.0],
        contype=0,
        conaffinity=0 if held else 1,
        **surface,
    )
    base = spec.worldbody.add_body(name="base", **_inertial(trunk))
    if not held:
        base.add_freejoint()
    for leg, links in zip(LEGS, legs, strict=True):
        _add_leg(spec, base, leg.name, links, ARMATURE + machine["armature.inertia"], surface)
    return spec.compile()


def _surface(machine: Machine) -> dict[str, Any]:
    """Return the properties of a contact. Of soft ground, gravity on a constraint of low impedance gives the depth."""
    rate, impedance, sink = RATE_SQUARED * machine.rubber, IMPEDANCE, machine["soft_ground.sink"]
    if sink > 0.0:
        impedance = SOFT_IMPEDANCE
        soft = (1.0 - impedance) * GRAVITY / (impedance * SINKAGE * sink)
        rate = 1.0 / (1.0 / rate + 1.0 / soft)
    mu = FRICTION * machine.ground * machine["ground_friction.factor"]
    return {
        "condim": 3,
        "friction": [mu, 0.0, 0.0],
        "solref": [-rate, -2.0 * DAMPING_RATIO * sqrt(rate)],
        "solimp": [impedance, impedance, 0.001, 0.5, 2.0],
    }


def _inertial(inertia: Inertia) -> dict[str, Any]:
    i = inertia
    full = [i.xx, i.yy, i.zz, i.xy, i.xz, i.yz]
    return {"explicitinertial": True, "mass": i.mass, "ipos": list(i.com), "fullinertia": full}


def _add_leg(
    spec: Any, base: Any, leg: str, links: list[Link], armature: float, surface: dict[str, Any]
) -> None:
    body = base
    for (part, inertia, place), limit in zip(links, A1.limits, strict=True):
        body = body.add_body(name=f"{leg} {part}", pos=list(place), **_inertial(inertia))
        body.add_joint(
            name=f"{leg} {part}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=list(_AXES[part]),
            range=list(limit),
            limited=True,
            armature=armature,
            frictionloss=DRY,
        )
    body.add_geom(
        name=f"{leg} foot",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        pos=list(A1.foot_offset),
        quat=[sqrt(0.5), sqrt(0.5), 0.0, 0.0],
        size=[A1.foot_radius, FOOT_WIDTH, 0.0],
        contype=1,
        conaffinity=0,
        mass=0.0,
        **surface,
    )
    spec.add_sensor(
        name=f"{leg} force",
        type=mujoco.mjtSensor.mjSENS_CONTACT,
        objtype=mujoco.mjtObj.mjOBJ_GEOM,
        objname="ground",
        reftype=mujoco.mjtObj.mjOBJ_GEOM,
        refname=f"{leg} foot",
        intprm=[1 << mujoco.mjtConDataField.mjCONDATA_FORCE.value, 3, 1],
    )
