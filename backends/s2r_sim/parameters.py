"""The test parameters of a rollout: command, ground, payload and push."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from s2r_sim.plant.physics import Physics
from s2r_sim.robot.signals import VelocityCommand
from s2r_spec import backend
from s2r_spec.backend import Parameter

PARAMETERS = (
    Parameter("vd", "m/s", -0.5, 0.5, 0.0, "forward velocity commanded at t = 0"),
    Parameter("vy", "m/s", -0.2, 0.2, 0.0, "lateral velocity commanded at t = 0, left positive"),
    Parameter("wz", "rad/s", -0.5, 0.5, 0.0, "yaw rate commanded at t = 0"),
    Parameter("slope", "deg", -8.0, 8.0, 0.0, "slope of the ground, positive uphill in the initial heading"),
    Parameter("friction", "", 0.1, 1.2, 0.8, "friction coefficient of foot on ground"),
    Parameter("payload", "kg", 0.0, 6.0, 0.0, "mass on the trunk, 8 cm above the base origin"),
    Parameter("push", "N*s", -50.0, 50.0, 0.0, "horizontal impulse on the base, spread over 50 ms"),
    Parameter(
        "push_towards", "deg", -180.0, 180.0, 90.0, "direction of the push, counted from ahead to the left"
    ),
    Parameter("push_time", "s", 0.0, 10.0, 0.5, "time at which the push begins"),
)

PUSH_DURATION = 0.05
"""[s]"""


class Test(NamedTuple):
    """One point of the test space; fields as in ``PARAMETERS``."""

    vd: float
    vy: float
    wz: float
    slope: float
    friction: float
    payload: float
    push: float
    push_towards: float
    push_time: float

    @property
    def command(self) -> VelocityCommand:
        """The commanded velocity."""
        return VelocityCommand(self.vd, self.vy, self.wz)

    def world(self, physics: Physics) -> Physics:
        """Return the world in which the test takes place."""
        return replace(
            physics.with_payload(self.payload),
            slope=physics.slope + self.slope,
            friction=physics.friction * (self.friction / Physics.friction),
        )

    def push_force(self, time: float) -> float:
        """Return the force of the push [N] at this time [s]."""
        acts = self.push_time <= time < self.push_time + PUSH_DURATION
        return self.push / PUSH_DURATION if acts else 0.0


def read_test(params: Mapping[str, float]) -> Test:
    """Return the test with these parameters; a missing one takes its default.

    Raises:
        UsageError: a name is unknown or a value is out of range.
    """
    return Test(**backend.read_test("sim", PARAMETERS, params))
