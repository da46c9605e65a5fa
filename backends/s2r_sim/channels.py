"""The channels of a trace: names and units."""

from __future__ import annotations

from s2r_spec.backend import Channel

CHANNELS = (
    Channel("vx", "m/s", "true base velocity, forward in the heading frame"),
    Channel("vy", "m/s", "true base velocity, left in the heading frame"),
    Channel("wz", "rad/s", "true yaw rate"),
    Channel("vx_cmd", "m/s", "commanded forward velocity"),
    Channel("vy_cmd", "m/s", "commanded lateral velocity"),
    Channel("wz_cmd", "rad/s", "commanded yaw rate"),
    Channel("x", "m", "base position in the world"),
    Channel("y", "m", "base position in the world"),
    Channel("height", "m", "base height above the world's origin"),
    Channel("roll", "rad", "base attitude"),
    Channel("pitch", "rad", "base attitude"),
    Channel("yaw", "rad", "base attitude"),
    Channel("qp_iterations", "", "interior-point iterations of the force QP"),
    Channel("qp_solved", "", "1 where the QP was solved, 0 where the controller fell back"),
    Channel("fallen", "", "1 at the sample at which the robot has fallen"),
    Channel("stance", "", "1 where the gait has the foot on the ground; FR, FL, RR, RL", 4),
    Channel("q", "rad", "joint angles; FR, FL, RR, RL, each hip, thigh, calf", 12),
    Channel("dq", "rad/s", "joint speeds", 12),
    Channel("tau_cmd", "N*m", "what the motor law asks for at the sample, before clipping", 12),
    Channel("tau", "N*m", "what the motors deliver within the 2 ms after the sample", 12),
    Channel("foot_force", "N", "ground on feet within the 2 ms after the sample; x, y, z of each foot", 12),
)

UNITS = {channel.name: channel.unit for channel in CHANNELS}
