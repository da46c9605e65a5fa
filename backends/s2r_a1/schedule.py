"""The velocity command at every control tick of a test.

    trot in place   for at least 1.2 s, until the gait has the seed's phase at t = 0
    the test        the command of the test, from t = 0 to its duration inclusive
    ramp            to zero in 0.5 s
    trot in place   until all four feet are on the ground; then the guard takes over

A tick is 2 ms; tick 0 is t = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from s2r_sim.controller.gains import Gains
from s2r_sim.controller.gait import Gait
from s2r_sim.plant.noise import Noise, draw
from s2r_sim.robot.signals import VelocityCommand

TROT = 600
"""A budget [ticks]: shortest time of trotting in place before a test, 1.2 s, as in the simulator."""
RAMP = 250
"""A budget [ticks]: duration of the ramp to zero, 0.5 s."""

_STILL = VelocityCommand()


@dataclass(frozen=True)
class Schedule:
    """One test in control ticks: ``trot`` in place before t = 0, and ``hold``, the last tick of the test itself."""

    command: VelocityCommand
    trot: int
    hold: int

    @classmethod
    def of(cls, command: VelocityCommand, seed: int, ticks: int, gains: Gains) -> Schedule:
        """Return the schedule of a test that holds its command for this number of ticks after t = 0.

        The gait begins with all feet on the ground. Its phase at t = 0 is the one that the simulator draws from
        the same seed.
        """
        period = Gait.of(gains).period
        phase = draw(Noise(), seed, 0, period).phase
        return cls(command, TROT + (phase - TROT) % period, ticks)

    def at(self, tick: int) -> VelocityCommand:
        """Return the command at a tick."""
        if tick < 0:
            return _STILL
        scale = min(1.0, max(0.0, 1.0 - (tick - self.hold) / RAMP))
        if scale == 1.0:
            return self.command
        return VelocityCommand(*(scale * velocity for velocity in self.command))

    def cut(self, tick: int) -> Schedule:
        """Return the schedule of the same test, ended at this tick at the latest."""
        return replace(self, hold=min(self.hold, tick))

    def is_over(self, tick: int) -> bool:
        """Return whether the robot may be halted once all feet are on the ground."""
        return tick >= self.hold + RAMP
