"""One control tick of a test: from a reading to motor commands, with the simulator's own controller and estimator.

Nothing here sends or waits, so a :class:`Pilot` computes the same commands from a recording as on the robot.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from s2r_a1.schedule import Schedule
from s2r_a1.sensing import Sensed, control_ticks, sense
from s2r_a1.ticks import SECONDS, TickUnit
from s2r_a1.wire import A1, CLOSED_LOOP, MOTORS, Orders, Reading, pack, pack_reading, unpack
from s2r_sim.controller.gains import RATE
from s2r_sim.controller.trot import Controller, Memory, Tick
from s2r_sim.robot.leg_kinematics import stand_angles
from s2r_sim.robot.signals import RobotState, VelocityCommand
from s2r_sim.settings import Settings

PRACTICE = 100
"""A budget: control ticks on an artificial reading before the first request to the robot. The first one compiles for
seconds, which the guard would take for silence; the others fill caches."""


class Note(NamedTuple):
    """Input and output of the controller at one reading.

    Attributes:
        clock: the robot's tick at the reading.
        tick: the control tick; 0 is t = 0.
        late: control ticks just before this one that the controller missed.
        command: velocity command.
        state: estimated state.
        done: output of the controller.
    """

    clock: int
    tick: int
    late: int
    command: VelocityCommand
    state: RobotState
    done: Tick


class Pilot:
    """Computes the commands of one test after another; :meth:`begin` removes all memory of earlier tests."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._controller = Controller(settings.robot, settings.gains, settings.form)

    def begin(self, schedule: Schedule, unit: TickUnit) -> None:
        """Reset, and prepare for a test; ``unit`` is the unit of the robot's clock."""
        self._schedule, self._unit = schedule, unit
        self._controller.restore(Memory())
        self._sensed: Sensed | None = None
        self._begun = 0
        self._tick = -schedule.trot - 1

    def step(self, reading: Reading) -> Note:
        """Compute the motor commands at a reading that is newer than the last.

        The gait follows the robot's clock, so a late or lost reading does not change its phase.
        """
        schedule, before, controller = self._schedule, self._sensed, self._controller
        if before is None:
            self._begun, ticks, late = reading.tick, 0.0, 0
            self._tick += 1
        else:
            ticks = control_ticks(before.tick, reading.tick, self._unit)
            passed = round(control_ticks(self._begun, reading.tick, self._unit))
            late = max(0, passed - schedule.trot - self._tick - 1)
            if late:
                controller.skip(late, before.state, schedule.at(self._tick))
            self._tick += 1 + late
        self._sensed = sensed = sense(self.settings.robot, before, reading, controller.stance, ticks)
        command = schedule.at(self._tick)
        done = controller.tick(sensed.state, command)
        return Note(reading.tick, self._tick, late, command, sensed.state, done)

    def stop(self) -> None:
        """Begin the ramp to zero now, before the end of the test."""
        self._schedule = self._schedule.cut(self._tick)

    def is_done(self, note: Note) -> bool:
        """Return whether the robot may be halted: it trots in place, and all its feet are on the ground."""
        return self._schedule.is_over(note.tick) and all(note.done.stance)

    def practise(self) -> None:
        """Compile and run all code of a walk, on artificial readings of a standing robot."""
        unit: TickUnit = "ms"
        settings = self.settings
        standing = Reading(
            quaternion=np.array([1.0, 0.0, 0.0, 0.0]),
            gyro=np.zeros(3),
            accelerometer=np.array([0.0, 0.0, 9.81]),
            q=stand_angles(settings.robot, settings.gains.base_height),
            dq=np.zeros(MOTORS),
            tau=np.zeros(MOTORS),
            temperature=np.full(MOTORS, 30.0),
            mode=np.full(MOTORS, CLOSED_LOOP),
            tick=0,
        )
        self.begin(Schedule(VelocityCommand(), PRACTICE // 2, PRACTICE), unit)
        for tick in range(PRACTICE):
            clock = round(tick * (1 + (tick > PRACTICE // 2)) / (RATE * SECONDS[unit]))
            reading = unpack(pack_reading(standing._replace(tick=clock), A1), A1)
            pack(orders(self.step(reading)), A1)


def orders(note: Note) -> Orders:
    """Return the controller's commands for the motors."""
    return Orders(*note.done.motors)
