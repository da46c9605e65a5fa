"""The channels of a robot's trace: the simulator's channels that a robot has, and channels that only a robot has."""

from __future__ import annotations

from s2r_sim.plant.channels import CHANNELS as SIMULATED
from s2r_sim.plant.channels import FEET, JOINTS
from s2r_spec.backend import Channel

SHARED = (
    *("wz", "vx_cmd", "vy_cmd", "wz_cmd", "vx_est", "vy_est", "roll", "pitch", "yaw", "omega"),
    *("acc_pred", "qp_iterations", "qp_solved", "stance", "q", "dq", "tau_cmd", "tau"),
)
"""The simulator's channels that a robot can measure on board."""
OWN = (
    Channel("foot_force_raw", "", "counts of the foot sensors; they drift, and have no unit", 4, FEET),
    Channel("motor_temperature", "degC", "temperature of each motor", 12, JOINTS),
    Channel("late", "", "control ticks just before the sample that the controller missed"),
)

EXCITED = (
    *("wz", "roll", "pitch", "yaw", "omega", "q", "dq", "tau_cmd", "tau"),
    *("foot_force_raw", "motor_temperature", "late"),
)
"""A definition: channels of a protocol's trace, which has no gait, no QP and no velocity."""


def channels(source: str) -> tuple[Channel, ...]:
    """Return the channels of a trace with the velocity from this ``source``."""
    forward = Channel("vx", "m/s", f"base velocity {source}, forward in the heading frame")
    left = Channel("vy", "m/s", f"base velocity {source}, left in the heading frame")
    return (forward, left, *(channel for channel in SIMULATED if channel.name in SHARED), *OWN)
