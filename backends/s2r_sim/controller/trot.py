"""The trot controller: clock, footholds, base task, inverse-dynamics QP, joint commands."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from s2r_sim.controller.base_task import advance, base_task
from s2r_sim.controller.dynamics import RigidBody
from s2r_sim.controller.foot_task import STANDS, foot_task
from s2r_sim.controller.full_qp import FullQP
from s2r_sim.controller.gains import RATE, Form, Gains
from s2r_sim.controller.gait import Gait, Progress
from s2r_sim.controller.qp import ControlTask, Solution, Stance
from s2r_sim.controller.reduction import in_joint_space
from s2r_sim.controller.stance_qp import StanceQP
from s2r_sim.robot.constants import FloatArray, Robot
from s2r_sim.robot.signals import MotorCommand, RobotState, VelocityCommand


@dataclass
class Memory:
    """The controller's state between two ticks; a copy of it restores the controller."""

    reference: FloatArray = field(default_factory=lambda: np.zeros(3))
    tick: int = 0
    lift_off: FloatArray = field(default_factory=lambda: np.zeros((4, 3)))
    forces: FloatArray = field(default_factory=lambda: np.zeros(12))
    failed_in_a_row: int = 0


class Tick(NamedTuple):
    """Decision of one tick; ``solution`` is None when the QP failed."""

    motors: MotorCommand
    stance: Stance
    solution: Solution | None


class Controller:
    """Turns a measured state and a velocity command into twelve motor commands, 500 times a second."""

    def __init__(self, robot: Robot, gains: Gains, form: Form = "condensed") -> None:
        self._gains = gains
        self._gait = Gait.of(gains)
        task = np.empty((6, 7)), np.empty((3, 12)), np.empty((12, 7))
        ticks = range(self._gait.period)
        self._schedule = tuple(_Phase(gains, self._gait.progress(tick), task) for tick in ticks)
        self._foot_radius = robot.foot_radius
        self._body = RigidBody(robot, gains.rotor_inertia)
        self._qp = StanceQP(gains, robot) if form == "condensed" else FullQP(gains, robot)
        self._base = gains.base, gains.base_height, float(RATE)
        self._swing = (*gains.swing, self._gait.swing_time, self._gait.stance_time)
        self.memory = Memory()

    def restore(self, memory: Memory) -> None:
        """Continue from a copy of this memory alone."""
        self.memory = deepcopy(memory)
        self._qp.reset()

    def snapshot(self) -> Memory:
        """Return a copy of the memory, to restore later."""
        return deepcopy(self.memory)

    @property
    def stance(self) -> Stance:
        """Feet that stand at the next tick, by the gait's clock."""
        return self._schedule[self.memory.tick % len(self._schedule)].stance

    def skip(self, ticks: int, measured: RobotState, command: VelocityCommand) -> None:
        """Advance the gait's clock and the reference over missed ticks; ``measured`` is the last state before them."""
        memory = self.memory
        memory.tick += ticks
        for _ in range(ticks):
            advance(memory.reference, measured.flat, (command.vx, command.vy, command.wz), float(RATE))

    def tick(self, measured: RobotState, command: VelocityCommand) -> Tick:
        """Run one control tick."""
        gains, body, memory = self._gains, self._body, self.memory
        phase = self._schedule[memory.tick % len(self._schedule)]
        memory.tick += 1
        body.update(measured)
        desired = (command.vx, command.vy, command.wz)
        base, feet, legs, _ = task = phase.task
        contact = foot_task(
            phase.progress, memory.lift_off, body.legs, measured.flat, desired, self._swing, feet
        )
        step = gains.max_joint_step
        targets = in_joint_space(body.jacobian, feet, body.known, measured.q, step, legs)
        ground = contact - self._foot_radius
        base_task(memory.reference, measured.flat, body.twist, desired, ground, self._base, base)
        solution = self._qp.solve(body, task)
        torque = self._feedforward(solution, phase.stance)
        if torque is None:
            none = np.zeros(12)  # the last resort: every joint brakes
            brake = MotorCommand(q=none, dq=none, kp=none, kd=np.full(12, gains.kd_damping), tau=none)
            return Tick(brake, phase.stance, solution)
        motors = MotorCommand(targets[0], targets[1], phase.kp, phase.kd, torque)
        return Tick(motors, phase.stance, solution)

    def _feedforward(self, solution: Solution | None, stance: Stance) -> FloatArray | None:
        """Return (12,) torques: the QP's, or for ``hold_ticks`` ticks those of the last good forces, or None."""
        memory, body = self.memory, self._body
        if solution is not None:
            memory.forces = solution.forces
            memory.failed_in_a_row = 0
            return solution.torque
        memory.failed_in_a_row += 1
        if memory.failed_in_a_row > self._gains.hold_ticks:
            return None
        held = memory.forces * np.repeat(stance, 3)
        return body.bias[6:] - body.leg_jacobian.T @ held


class _Phase:
    """Quantities that one tick of the gait period fixes; all phases write their task to the same memory."""

    def __init__(
        self, gains: Gains, progress: Progress, task: tuple[FloatArray, FloatArray, FloatArray]
    ) -> None:
        self.stance: Stance = tuple(s is None for s in progress)
        self.task = ControlTask(*task, self.stance)
        self.progress = np.array([STANDS if s is None else s for s in progress])
        self.kp = np.repeat([0.0 if stands else gains.kp_joint_swing for stands in self.stance], 3)
        self.kd = np.full(12, gains.kd_joint)
