"""The door to the robot: its constants, its controller, its logger and its catalogue of effects.

Everything that this package takes from ``s2r_sim`` passes through here. Nothing of the simulator's physics does.
"""

from __future__ import annotations

from s2r_sim.controller.estimator import replay, specific_force
from s2r_sim.controller.gains import RATE, Gains
from s2r_sim.controller.trot import Controller, Memory, Tick
from s2r_sim.effects import CATALOGUE
from s2r_sim.plant.channels import CHANNELS
from s2r_sim.plant.physics import FallLimits, Physics
from s2r_sim.plant.recorder import Recorder
from s2r_sim.protocols import PROTOCOLS as EXCITATION
from s2r_sim.protocols.references import Reference, reference
from s2r_sim.robot.constants import A1, GRAVITY, LEGS, Inertia, fuse
from s2r_sim.robot.signals import MotorCommand, RobotState, VelocityCommand

__all__ = [
    "A1",
    "CATALOGUE",
    "CHANNELS",
    "EXCITATION",
    "FALL",
    "GRAVITY",
    "LEGS",
    "PROTOCOLS",
    "RATE",
    "Controller",
    "Inertia",
    "Memory",
    "MotorCommand",
    "Recorder",
    "Reference",
    "RobotState",
    "Tick",
    "VelocityCommand",
    "controller",
    "fuse",
    "logger",
    "reference",
    "replay",
    "specific_force",
]

PROTOCOLS = tuple(protocol.name for protocol in EXCITATION)
"""Names of the excitation protocols."""
FALL = FallLimits()
"""The laboratory's rule of a fall, the same as in simulation."""


def controller() -> Controller:
    """Return the trot controller, as it runs on the robot."""
    return Controller(A1, Gains(), "condensed")


def logger(command: VelocityCommand, slope: float) -> Recorder:
    """Return a logger, which makes channels of states; the ground rises by ``slope`` [deg] along x."""
    return Recorder(A1, Physics(slope=slope), command)
