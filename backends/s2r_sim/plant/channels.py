"""The channels of a trace: names and units.

Channels that a robot can log come from its own sensors and loops, with their systematic errors and without white
noise. Base, feet and ground are true, as motion capture and force plates measure them.
"""

from __future__ import annotations

from s2r_sim.robot.constants import LEGS
from s2r_spec.backend import Channel

FEET = tuple(leg.name for leg in LEGS)
JOINTS = tuple(f"{foot} {joint}" for foot in FEET for joint in ("hip", "thigh", "calf"))
AXES = ("x", "y", "z")
HEADING = ("forward", "left", "up")
AT_FEET = tuple(f"{foot} {axis}" for foot in FEET for axis in AXES)

CHANNELS = (
    Channel("vx", "m/s", "true base velocity, forward in the heading frame"),
    Channel("vy", "m/s", "true base velocity, left in the heading frame"),
    Channel("vz", "m/s", "true base velocity, up"),
    Channel("wz", "rad/s", "yaw rate measured by the IMU"),
    Channel("vx_cmd", "m/s", "commanded forward velocity"),
    Channel("vy_cmd", "m/s", "commanded lateral velocity"),
    Channel("wz_cmd", "rad/s", "commanded yaw rate"),
    Channel("vx_est", "m/s", "the robot's own estimate, forward in the heading frame"),
    Channel("vy_est", "m/s", "the robot's own estimate, left in the heading frame"),
    Channel("x", "m", "base position in the world"),
    Channel("y", "m", "base position in the world"),
    Channel("z", "m", "base position in the world"),
    Channel("height", "m", "base height above the mean plane of the ground below it"),
    Channel("roll", "rad", "base attitude from the IMU"),
    Channel("pitch", "rad", "base attitude from the IMU"),
    Channel("yaw", "rad", "base attitude from the IMU"),
    Channel("omega", "rad/s", "angular velocity measured by the IMU, base axes", 3, AXES),
    Channel("acc_pred", "m/s^2",
            "base acceleration predicted by the QP; forward, left, up in the heading frame from the IMU", 3, HEADING),
    Channel("qp_iterations", "", "interior-point iterations of the force QP; 0 where no limit matters"),
    Channel("qp_solved", "", "1 where the QP was solved, 0 where the controller fell back"),
    Channel("fallen", "", "1 at the sample at which the robot has fallen"),
    Channel("stance", "", "1 where the gait has the foot on the ground; FR, FL, RR, RL", 4, FEET),
    Channel("q", "rad", "joint angles from the encoders; FR, FL, RR, RL, each hip, thigh, calf", 12, JOINTS),
    Channel("dq", "rad/s", "joint velocities from the encoders", 12, JOINTS),
    Channel("tau_cmd", "N*m",
            "torque command of the motor law at the sample, from encoder readings, before saturation", 12, JOINTS),
    Channel("tau", "N*m",
            "torque that the motors report within the 2 ms after the sample, from their currents", 12, JOINTS),
    Channel("foot_position", "m", "centre of the ball foot in the world; x, y, z of each foot", 12, AT_FEET),
    Channel("foot_velocity", "m/s", "velocity of that centre, world axes", 12, AT_FEET),
    Channel("foot_force", "N",
            "force of the ground on the feet within the 2 ms after the sample; x, y, z of each foot", 12, AT_FEET),
    Channel("contact", "", "1 where the ground pushes on the foot", 4, FEET),
)  # fmt: skip

FROM_OUTSIDE = frozenset((
    "vx", "vy", "vz", "x", "y", "z", "height", "fallen", "foot_position", "foot_velocity", "foot_force", "contact",
))  # fmt: skip
"""Names of the channels that motion capture and force plates measure, free of the robot's own sensor errors."""

TRUE_CHANNELS = (
    Channel("q_true", "rad", "true joint angles", 12, JOINTS),
    Channel("dq_true", "rad/s", "true joint velocities", 12, JOINTS),
    Channel("roll_true", "rad", "true base attitude"),
    Channel("pitch_true", "rad", "true base attitude"),
    Channel("wz_true", "rad/s", "true yaw rate"),
)
"""Further channels of ``record=truth``: true values of the measured quantities. No robot logs them."""
