"""Decides from the robot's own clock whether a state is new.

Every state carries a tick, 32 bits of a clock whose unit no document settles: milliseconds or microseconds. A driver
may hand out the last state again when nothing arrives, and a network may repeat or reorder packets; only the tick
tells. :class:`Ticks` judges each, measures the unit over the first half second, and counts what was wrong.
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
"""A budget: seconds over which the unit of the ticks is measured; twice as long halves the effect of a late packet."""
CLOSE = 0.1
"""A tolerance: how far the rate of the ticks may be from its unit, as a part of it. Packets that are 8 ms late at
both ends change the rate by 3 %; the two units differ by a factor of 1000, so twice this decides the same."""
AHEAD = 0.1
"""A tolerance [s]: how far a tick may run ahead of the time since the state before. Twice as much finds a clock that
jumps or changes its unit from jumps of 0.2 s on."""
STILL = 1e-4
"""A tolerance [s]: a tick that advances by less is one that stands still, as where µs become ms. The fastest robots
known send every millisecond; from ten times this on, their states would not count."""

TickFault = Literal["repeated", "backwards", "clock"]


@dataclass
class Counters:
    """What happened on a link since it was opened.

    Attributes:
        received: packets from the peer, good or not.
        late: reads that found nothing new.
        lost: states that are missing between two that came, by the robot's clock.
        corrupt: packets of a wrong length, level or checksum.
        numbers: packets with a number in them that cannot be.
        repeated: states whose tick came before: duplicates, or a clock that stands still.
        backwards: states older than one that came before.
        clock: states whose tick jumped ahead of the time that passed.
        foreign: packets from another address.
        unsent: packets that the network refused to take.
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
    """The robot's clock, as its states show it.

    Attributes:
        unit: of the ticks; None until it is measured.
        refusal: a sentence if the ticks have neither unit, until they have one.
    """

    def __init__(self, counters: Counters, unit: TickUnit | None = None) -> None:
        self.unit = unit
        self.refusal: str | None = None
        self._counters = counters
        self._last: tuple[float, int] | None = None
        self._first: tuple[float, int] | None = None

    def judge(self, tick: int, now: float) -> TickFault | None:
        """Return what is wrong with the tick of a state that came at ``now`` [s], or None if the state is new."""
        if self._last is None:
            self._last = self._first = (now, tick)
            return None
        then, before = self._last
        advance = elapsed(before, tick)
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
        """Begin anew, as when a robot was switched off and on: the next state is new, and the unit is measured."""
        self.unit = self.refusal = self._last = self._first = None

    def _measure(self, now: float, tick: int) -> None:
        assert self._first is not None
        start, first = self._first
        if now - start < MEASURED:
            return
        rate = elapsed(first, tick) / (now - start)
        self.unit = unit_of(rate)
        self.refusal = None
        if self.unit is None:
            self.refusal = (
                f"the robot's clock runs at {rate:.0f} ticks a second, which is neither milliseconds nor "
                "microseconds; check that the address is the robot's motion controller"
            )
            self._first = (now, tick)


def unit_of(rate: float) -> TickUnit | None:
    """Return the unit of a clock with so many ticks a second; None if it is neither ms nor µs."""
    for unit, seconds in SECONDS.items():
        if abs(rate * seconds - 1.0) <= CLOSE:
            return unit
    return None


def elapsed(before: int, after: int) -> int:
    """Return the ticks from one state to another of a clock of 32 bits that begins again; negative if it went back."""
    return ((after - before + 0x80000000) & 0xFFFFFFFF) - 0x80000000
