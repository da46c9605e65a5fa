"""Decide from the robot's own clock whether a state is new.

Every state has a tick, 32 bits of a clock. Its unit is milliseconds or microseconds; no document says which. A driver
may return the last state again if nothing arrives, and a network may repeat or reorder packets, so only the tick shows
whether a state is new. :class:`Ticks` checks each tick, measures the unit over the first half second, and counts
faults.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

TickUnit = Literal["ms", "us"]
SECONDS: dict[TickUnit, float] = {"ms": 1e-3, "us": 1e-6}
"""A definition: seconds of one tick."""

PERIOD = 0.002
"""A definition: seconds between two states of the robot, and of one round in lock step."""
MEASURED = 0.5
"""A budget [s]: time over which the unit of the ticks is measured."""
CLOSE = 0.1
"""A tolerance: relative error of the measured rate of the ticks. Packets that are 8 ms late at both ends change the
rate by 3 %; the two units differ by a factor of 1000."""
AHEAD = 0.1
"""A tolerance [s]: advance of a tick beyond the time since the state before."""
STILL = 1e-4
"""A tolerance [s]: smallest advance of a tick; a smaller one counts as none, as after a change from µs to ms. The
fastest known robots send every millisecond; with ten times as much their states would not count."""

TickFault = Literal["repeated", "backwards", "clock"]


@dataclass
class Counters:
    """Counts of packets on a link since it was opened.

    Attributes:
        received: packets from the peer, valid or not.
        late: reads without a new state.
        lost: states missing between two received ones, according to the robot's clock.
        corrupt: packets with a wrong length, level or checksum.
        numbers: packets with an impossible number.
        repeated: states with a repeated tick: duplicates, or a clock that stands still.
        backwards: states older than an earlier one.
        clock: states whose tick advanced further than the time that passed.
        foreign: packets from another address.
        unsent: packets that the network refused.
    """

    received: int = 0
    late: int = 0
    lost: int = 0
    corrupt: int = 0
    numbers: int = 0
    repeated: int = 0
    backwards: int = 0
    clock: int = 0
    foreign: int = 0
    unsent: int = 0


class Ticks:
    """The robot's clock, as read from its states.

    Attributes:
        unit: unit of the ticks; None until it is measured.
        refusal: a message while the ticks have no known unit.
    """

    def __init__(self, counters: Counters, unit: TickUnit | None = None) -> None:
        self.unit = unit
        self.refusal: str | None = None
        self._counters = counters
        self._last: tuple[float, int] | None = None
        self._first: tuple[float, int] | None = None

    def judge(self, tick: int, now: float) -> TickFault | None:
        """Return the fault of a state's tick, for a state received at ``now`` [s]; None if the state is new."""
        if self._last is None:
            self._last = self._first = (now, tick)
            return None
        then, before = self._last
        advance = elapsed_ticks(before, tick)
        if advance < 0:
            self._counters.backwards += 1
            return "backwards"
        if advance == 0 or (self.unit and advance * SECONDS[self.unit] < STILL):
            self._counters.repeated += 1
            return "repeated"
        if self.unit:
            robot_time = advance * SECONDS[self.unit]
            if robot_time > now - then + AHEAD:
                self._counters.clock += 1
                return "clock"
            self._counters.lost += max(0, round(robot_time / PERIOD) - 1)
        self._last = (now, tick)
        if self.unit is None:
            self._measure(now, tick)
        return None

    def forget(self) -> None:
        """Start again, as after the robot was switched off and on: the next state is new, and the unit is measured."""
        self.unit = self.refusal = self._last = self._first = None

    def _measure(self, now: float, tick: int) -> None:
        assert self._first is not None
        start, first = self._first
        if now - start < MEASURED:
            return
        rate = elapsed_ticks(first, tick) / (now - start)
        self.unit, self.refusal = unit_of(rate), None
        if self.unit is None:
            self.refusal = (
                f"the robot's clock runs at {rate:.0f} ticks per second, which is neither milliseconds nor "
                "microseconds; check that the address is the robot's motion controller"
            )
            self._first = (now, tick)


def unit_of(rate: float) -> TickUnit | None:
    """Return the unit of a clock from its rate [ticks/s]; None if it is neither ms nor µs."""
    return next((unit for unit, seconds in SECONDS.items() if abs(rate * seconds - 1.0) <= CLOSE), None)


def elapsed_ticks(before: int, after: int) -> int:
    """Return the ticks from one state to another, for a 32-bit clock that wraps around; negative if it went back."""
    return ((after - before + 0x80000000) & 0xFFFFFFFF) - 0x80000000
