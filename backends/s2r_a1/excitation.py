"""Play a protocol: the commands at every reading, from the stand to the protocol's first pose, and back to the stand.

    go to the first pose, hold it
    t = 0: play the protocol
    go back to the stand; then the guard takes over

Nothing here sends or waits. References follow the robot's clock, so a late or lost reading does not delay them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from s2r_a1.guard import moves
from s2r_a1.pilot import Note
from s2r_a1.sensing import Sensed, control_ticks, sense
from s2r_a1.ticks import TickUnit
from s2r_a1.wire import MOTORS, FloatArray, Reading
from s2r_sim.controller.gains import RATE
from s2r_sim.controller.trot import Tick
from s2r_sim.protocols.references import reference
from s2r_sim.robot.constants import A1
from s2r_sim.robot.signals import MotorCommand, VelocityCommand

SHARES = (0.25, 0.5)
"""Levels: shares of the amplitude that are rehearsed before the first run of a protocol at these gains, in this
order."""
REHEARSED = 2.0
"""A budget [s]: longest rehearsal of a share."""
GOING = 1.0
"""A level [s]: time from one pose to another."""
SETTLING = 0.4
"""A definition [s]: time for which the first pose is held before t = 0, as in the simulator."""

_ZERO = np.zeros(MOTORS)
_STANCE = (True,) * 4
_STILL = VelocityCommand()


class Rows(NamedTuple):
    """References at n ticks: q and dq (n, 12) [rad, rad/s], kp and kd (n,) [N·m/rad, N·m·s/rad]."""

    q: FloatArray
    dq: FloatArray
    kp: FloatArray
    kd: FloatArray


@dataclass(frozen=True)
class Segment:
    """A part of a run: its references from the reading at its begin, and whether it is the protocol itself."""

    rows: Callable[[Reading], Rows]
    measured: bool = False


def plan(protocol: str, amplitude: float, gain: float, seconds: float = np.inf) -> tuple[Segment, ...]:
    """Return the segments of a run; the protocol itself ends after at most this time [s]."""
    made = reference(protocol, amplitude, gain)
    kp, kd = float(made.kp[0]), float(made.kd[0])
    count = int(min(len(made.q), seconds * RATE + 1))
    rows = Rows(made.q[:count], made.dq[:count], made.kp[:count], made.kd[:count])
    return (
        Segment(partial(_go, made.q[0], kp, kd, SETTLING)),
        Segment(lambda reading: rows, measured=True),
        Segment(partial(_go, moves.STANDING, kp, kd, 0.0)),
    )


def _go(target: FloatArray, kp: float, kd: float, held: float, reading: Reading) -> Rows:
    """Return a smooth motion to a pose (12,) [rad], which is then held for a time [s].

    It begins beyond the measured angles, so that the new gains give the present torques of the motors.
    """
    start = reading.q + np.clip(reading.tau / kp, -moves.YIELD, moves.YIELD)
    times = np.arange(1, round((GOING + held) * RATE) + 1) / RATE
    x = np.minimum(times / GOING, 1.0)[:, None]
    way = target - start
    one = np.ones(len(times))
    return Rows(start + x * x * (3.0 - 2.0 * x) * way, 6.0 * x * (1.0 - x) / GOING * way, kp * one, kd * one)


class Player:
    """Plays the segments of one run, reading by reading like a :class:`s2r_a1.pilot.Pilot`."""

    def __init__(self, segments: tuple[Segment, ...], unit: TickUnit) -> None:
        self._coming = list(segments)
        self._unit: TickUnit = unit
        self._segment: Segment | None = None
        self._rows: Rows | None = None
        self._begun = 0
        self._place = -1
        self._after: int | None = None
        self._sensed: Sensed | None = None

    def step(self, reading: Reading) -> Note:
        """Compute the motor commands at a reading that is newer than the last."""
        before = self._sensed
        ticks = 0.0 if before is None else control_ticks(before.tick, reading.tick, self._unit)
        self._sensed = sensed = sense(A1, before, reading, _STANCE, ticks)
        passed = round(control_ticks(self._begun, reading.tick, self._unit)) if self._rows else 0
        if self._rows is None or (passed >= len(self._rows.q) and self._coming):
            self._begin(self._coming.pop(0), reading)
            passed = 0
        assert self._rows is not None
        late = max(0, passed - self._place - 1)
        self._place = passed
        at = min(passed, len(self._rows.q) - 1)
        q, dq, kp, kd = (values[at] for values in self._rows)
        one = np.ones(MOTORS)
        done = Tick(MotorCommand(q, dq, kp * one, kd * one, _ZERO), _STANCE, None)
        return Note(reading.tick, self._tick(passed), late, _STILL, sensed.state, done)

    def stop(self) -> None:
        """Go back to the stand now."""
        if self._coming:
            self._coming = self._coming[-1:]
            self._rows = None

    def is_done(self, note: Note) -> bool:
        """Return whether the robot is back in the stand."""
        return not self._coming and self._rows is not None and self._place >= len(self._rows.q) - 1

    def _begin(self, segment: Segment, reading: Reading) -> None:
        if self._segment is not None and self._segment.measured and self._rows is not None:
            self._after = len(self._rows.q)
        self._segment, self._rows = segment, segment.rows(reading)
        self._begun, self._place = reading.tick, -1

    def _tick(self, passed: int) -> int:
        """Return the control tick: from 0 on in the protocol, −1 before it."""
        assert self._segment is not None
        if self._segment.measured:
            return passed
        return -1 if self._after is None else self._after + passed
