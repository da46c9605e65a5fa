"""Rotation matrices, against which the tests hold the formulas of the simulator."""

from math import cos, sin

import numpy as np


def matrix(roll, pitch, yaw):
    """Return (3, 3) R = Rz(yaw) Ry(pitch) Rx(roll): base axes to world axes."""
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
