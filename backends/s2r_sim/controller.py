"""The trot controller: clock, footholds, base task, inverse-dynamics QP, joint commands."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesv

from s2r_sim.base_task import Command, Reference, base_acceleration, base_weight
from s2r_sim.dynamics import RigidBody
from s2r_sim.figures import Robot
from s2r_sim.foot_task import FootTask, foot_task
from s2r_sim.full_qp import FullQP
from s2r_sim.gains import Gains
from s2r_sim.gait import Gait
from s2r_sim.physics import MotorCommand, State
from s2r_sim.qp import InverseDynamics, Solution, Stance, Task
from s2r_sim.settings import Form
from s2r_sim.stance_qp import StanceQP

FloatArray = NDArray[np.float64]

FORMS: dict[Form, Callable[[Gains, Robot], InverseDynamics]] = {"condensed": StanceQP, "full": FullQP}


@dataclass
class Memory:
    """All that the controller carries from tick to tick; a copy of it restores the controller."""

    reference: Reference = field(default_factory=lambda: Reference(0.0, 0.0, 0.0))
    tick: int = 0
    lift_off: FloatArray = field(default_factory=lambda: np.zeros((4, 3)))
    forces: FloatArray = field(default_factory=lambda: np.zeros(12))
    failed_in_a_row: int = 0


class Tick(NamedTuple):
    """What one tick decided; ``solution`` is None when the QP failed."""

    motors: MotorCommand
    stance: Stance
    solution: Solution | None


class Controller:
    """Turns a measured state and a velocity command into twelve motor commands, 500 times a second."""

    def __init__(self, robot: Robot, gains: Gains, form: Form = "condensed") -> None:
        self._gains = gains
        self._gait = Gait.of(gains)
        self._schedule = tuple(self._gait.progress(tick) for tick in range(self._gait.period))
        self._foot_radius = robot.foot_radius
        self._body = RigidBody(robot, gains.rotor_inertia)
        self._qp = FORMS[form](gains, robot)
        self.memory = Memory()

    def restore(self, memory: Memory) -> None:
        """Continue from a copy of this memory, and from nothing else."""
        self.memory = deepcopy(memory)
        self._qp.reset()

    def snapshot(self) -> Memory:
        """Return a copy of the memory, to restore later."""
        return deepcopy(self.memory)

    def tick(self, measured: State, command: Command) -> Tick:
        """Run one control tick."""
        gains, body, memory = self._gains, self._body, self.memory
        progress = self._schedule[memory.tick % len(self._schedule)]
        stance: Stance = (progress[0] is None, progress[1] is None, progress[2] is None, progress[3] is None)
        body.update(measured)
        standing = [leg for leg in range(4) if stance[leg]]
        ground = float(body.feet[standing, 2].mean()) - self._foot_radius
        memory.reference = memory.reference.advanced(measured, command)
        memory.lift_off[standing] = body.feet[standing]

        landing_height = ground + self._foot_radius - gains.touch_down_depth
        feet = foot_task(
            gains, self._gait, progress, memory.lift_off, body, measured, command, landing_height
        )
        legs = _in_joint_space(body, feet)
        task = Task(
            base=base_acceleration(gains, measured, body.rotation, memory.reference, command, ground),
            weight=base_weight(gains, body.rotation, float(measured.rpy[2])),
            feet=feet.acceleration,
            leg_acceleration=legs[:, 0],
            leg_response=legs[:, 1:7],
            stance=stance,
        )
        solution = self._qp.solve(body, task)
        torque = self._feedforward(solution, stance)
        memory.tick += 1
        if torque is None:
            return Tick(_damping(gains), stance, solution)
        return Tick(_motors(gains, measured, stance, torque, legs[:, 7], legs[:, 8]), stance, solution)

    def _feedforward(self, solution: Solution | None, stance: Stance) -> FloatArray | None:
        """Return (12,) torques: the QP's, or for a few ticks those of the last good forces, or None."""
        memory, body = self.memory, self._body
        if solution is not None:
            memory.forces = solution.forces
            memory.failed_in_a_row = 0
            return solution.torque
        memory.failed_in_a_row += 1
        if memory.failed_in_a_row > self._gains.hold_ticks:
            return None
        held = memory.forces * np.repeat(stance, 3)
        static: FloatArray = body.bias[6:] - body.leg_jacobian.T @ held
        return static


def _in_joint_space(body: RigidBody, feet: FootTask) -> FloatArray:
    """Return (12, 9): joint accelerations e, response N (6 columns), joint steps, joint speeds.

    One factorisation of the leg Jacobians serves q̈ = e − N a and both joint targets.
    """
    rhs = np.empty((12, 9), order="F")
    rhs[:, 0] = feet.acceleration - body.drift
    rhs[:, 1:7] = body.base_jacobian
    rhs[:, 7] = feet.step
    rhs[:, 8] = feet.velocity - body.base_jacobian @ body.twist[:6]
    solved: FloatArray = dgesv(body.leg_jacobian, rhs)[2]
    return solved


def _motors(
    gains: Gains, measured: State, stance: Stance, torque: FloatArray, step: FloatArray, speed: FloatArray
) -> MotorCommand:
    bound = gains.max_joint_step
    return MotorCommand(
        q=measured.q + np.minimum(np.maximum(step, -bound), bound),
        dq=speed,
        kp=np.repeat([0.0 if stands else gains.kp_joint_swing for stands in stance], 3),
        kd=np.full(12, gains.kd_joint),
        tau=torque,
    )


def _damping(gains: Gains) -> MotorCommand:
    """Return the command of last resort: every joint brakes."""
    none = np.zeros(12)
    return MotorCommand(q=none, dq=none, kp=none, kd=np.full(12, gains.kd_damping), tau=none)
