"""Settings of a simulator."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from s2r_sim.controller.gains import Feedback, Form, Gains
from s2r_sim.plant.physics import FallLimits, Physics
from s2r_sim.robot.constants import A1, Robot

Record = Literal["measured", "truth"]


@dataclass(frozen=True)
class Settings:
    """All inputs of a trace besides the noise, the test and the seed."""

    robot: Robot = A1
    gains: Gains = field(default_factory=Gains)
    physics: Physics = field(default_factory=Physics)
    fall: FallLimits = field(default_factory=FallLimits)
    form: Form = "condensed"
    """Form of the QP: over the stance forces only, or with all 30 unknowns."""
    feedback: Feedback = "truth"
    """Base position and velocity for the controller: the true ones under noise, or the robot's own estimate."""
    record: Record = "measured"
    """Channels of a trace: those of the robot's log and of motion capture, or also the true values of its sensors."""
    warm_up: float = 1.0
    """[s] duration of trotting in place without noise, simulated once and shared by all rollouts."""
    settling: float = 0.2
    """[s] duration of trotting in place under the rollout's own noise, before the command."""
