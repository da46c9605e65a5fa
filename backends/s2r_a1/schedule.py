"""Which command holds at which control tick of a test.

    trot in place   at least 1.2 s, so long that the gait has the seed's phase at t = 0
    the test        its command from t = 0 to its duration, both included
    ramp            to no command in 0.5 s
    trot in place   until all four feet stand; then the guard takes over

A tick is 2 ms; tick 0 is t = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from s2r_sim.controller.gains import RATE, Gains
from s2r_sim.controller.gait import Gait
from s2r_sim.plant.noise import Noise, draw
from s2r_sim.robot.signals import Command

TROT = 600
"""A budget [ticks]: the least that the robot trots in place before a test, 1.2 s, as long as it does in the simulator.
Twice as much costs 1.2 s a rollout."""
RAMP = 250
"""A budget [ticks]: of the way from the command to none, 0.5 s. Twice as much costs 0.5 s and 8 cm of floor."""

_STILL = Command()


@dataclass(frozen=True)
class Schedule:
    """One test, in control ticks.

    Attributes:
        command: of the test.
        trot: ticks of trotting in place before t = 0.
        hold: the last tick of the test itself.
    """

    command: Command
    trot: int
    hold: int

    @classmethod
    def of(cls, command: Command, seed: int, ticks: int, gains: Gains) -> Schedule:
        """Return the schedule of a test that holds its command for so many ticks after t = 0.

        The gait begins with all feet on the ground. Its phase at t = 0 is the one that the simulator draws from
        this seed.
        """
        period = Gait.of(gains).period
        phase = draw(Noise(), seed, 0, period).phase
        return cls(command, TROT + (phase - TROT) % period, ticks)

    def at(self, tick: int) -> Command:
        """Return the command at a tick."""
        if tick < 0:
            return _STILL
        left = min(1.0, max(0.0, 1.0 - (tick - self.hold) / RAMP))
        if left == 1.0:
            return self.command
        return Command(*(left * part for part in self.command))

    def cut(self, tick: int) -> Schedule:
        """Return the schedule of a test that ends at this tick, if it would go on."""
        return replace(self, hold=min(self.hold, tick))

    def is_over(self, tick: int) -> bool:
        """Return whether the robot may be halted as soon as all feet stand."""
        return tick >= self.hold + RAMP

    @property
    def seconds(self) -> float:
        """How long the robot walks, at most [s]."""
        return (self.trot + self.hold + RAMP) / RATE + Gains().period / 2.0
