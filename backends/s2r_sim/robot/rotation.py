"""Attitudes: roll-pitch-yaw, rotation matrices, quaternions (scalar last unless named wxyz); conversion of states."""

from __future__ import annotations

from collections.abc import Sequence
from math import asin, atan2, cos, sin
from typing import Any

import numpy as np

from s2r_sim.robot.constants import FloatArray
from s2r_spec.compiled import compiled


@compiled
def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return (x, y, z, w) of Rz(yaw) Ry(pitch) Rx(roll), which turns base axes into world axes."""
    cr, sr = cos(roll / 2), sin(roll / 2)
    cp, sp = cos(pitch / 2), sin(pitch / 2)
    cy, sy = cos(yaw / 2), sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


@compiled
def rpy_from_wxyz(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return (roll, pitch, yaw) [rad] of a unit quaternion."""
    sin_pitch = min(1.0, max(-1.0, 2.0 * (w * y - z * x)))
    return (
        atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        asin(sin_pitch),
        atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def rotate(
    roll: Any, pitch: Any, yaw: Any, vector: Sequence[Any] | FloatArray, sin: Any, cos: Any
) -> tuple[Any, Any, Any]:
    """Return R · vector, of numbers with ``math``'s sine and cosine, or of arrays with NumPy's."""
    x, y, z = vector
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    y, z = cr * y - sr * z, sr * y + cr * z
    x, z = cp * x + sp * z, cp * z - sp * x
    return cy * x - sy * y, sy * x + cy * y, z


def turned_back(
    roll: Any, pitch: Any, yaw: Any, vector: Sequence[Any] | FloatArray, sin: Any, cos: Any
) -> tuple[Any, Any, Any]:
    """Return R' · vector, of numbers or of arrays as in :func:`rotate`."""
    x, y, z = vector
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    x, y = cy * x + sy * y, cy * y - sy * x
    x, z = cp * x - sp * z, sp * x + cp * z
    return x, cr * y + sr * z, cr * z - sr * y


@compiled
def from_mujoco(qpos: FloatArray, qvel: FloatArray) -> FloatArray:
    """Return ``State.flat`` (36,) of MuJoCo's positions (19,) and velocities (18,)."""
    flat = np.empty(36)
    flat[:3] = qpos[:3]
    flat[3], flat[4], flat[5] = rpy_from_wxyz(qpos[3], qpos[4], qpos[5], qpos[6])
    flat[6:12] = qvel[:6]
    flat[12:24] = qpos[7:]
    flat[24:] = qvel[6:]
    return flat


@compiled
def to_pinocchio(flat: FloatArray, q: FloatArray, twist: FloatArray) -> None:
    """Write Pinocchio's configuration (19,) and velocity (18,), with the base's in base axes, of ``State.flat``."""
    roll, pitch, yaw = flat[3], flat[4], flat[5]
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    vx, vy, vz = flat[6], flat[7], flat[8]
    vx, vy = cy * vx + sy * vy, cy * vy - sy * vx
    vx, vz = cp * vx - sp * vz, sp * vx + cp * vz
    q[:3] = flat[:3]
    q[3], q[4], q[5], q[6] = quaternion(roll, pitch, yaw)
    q[7:] = flat[12:24]
    twist[0], twist[1], twist[2] = vx, cr * vy + sr * vz, cr * vz - sr * vy
    twist[3:6] = flat[9:12]
    twist[6:] = flat[24:]
