"""Motion capture of a walk: poses over UDP, the alignment of clocks, and the velocity of the base."""

from s2r_a1.mocap.alignment import SEARCH, Alignment, Gyro
from s2r_a1.mocap.poses import Listener, MocapError, Placing, Poses, read_placing
from s2r_a1.mocap.speed import TURNED, Velocity, velocity

DELAYED = 0.1
"""A level [s]: delay of the poses from which on the operator is informed."""

__all__ = [
    "DELAYED",
    "SEARCH",
    "TURNED",
    "Alignment",
    "Gyro",
    "Listener",
    "MocapError",
    "Placing",
    "Poses",
    "Velocity",
    "read_placing",
    "velocity",
]
