"""The true velocity of a walk, from motion capture.

Data: poses of a rigid body on the robot over time, on a clock of their own, and the robot's gyroscope on its clock.
Both clocks are aligned first (:mod:`s2r_a1.mocap.alignment`). The velocity is the slope of the base's positions within
50 ms, in the base's heading frame.
"""

from __future__ import annotations

from math import radians
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_a1.mocap.alignment import LEAST, WINDOW, Alignment, Gyro, align, around
from s2r_a1.mocap.poses import MocapError, Placing, Poses
from s2r_a1.wire import FloatArray

TURNED = 10.0
"""A tolerance [deg]: error of the stated heading. Its cosine takes 1.5 % from the forward velocity, and its sine adds
17 % of the velocity to the left."""
FASTEST = 3.3
"""A level [m/s]: speed that no A1 reaches, according to its manufacturer. Faster motion means wrong units or jumping
poses."""


class Velocity(NamedTuple):
    """The base's velocity in its heading frame.

    Attributes:
        forward: (n,) forward velocity [m/s].
        left: (n,) velocity to the left [m/s].
        alignment: alignment of the clocks and of the heading.
    """

    forward: FloatArray
    left: FloatArray
    alignment: Alignment


def velocity(poses: Poses, placing: Placing, gyro: Gyro, times: FloatArray) -> Velocity:
    """Return the base's velocity at (n,) ``times`` of the robot [s], from poses of the body in the whole recording.

    Raises:
        MocapError: there are too few poses, they do not cover the test, they do not follow the gyroscope, the heading
            is wrong, or the velocity is impossible.
    """
    poses = _track(poses)
    if len(poses.times) < LEAST:
        raise MocapError(
            f"motion capture sent {len(poses.times)} valid poses, and {LEAST} are needed: check that it "
            "tracks the robot, and sends 100 poses per second to this port"
        )
    attitude, yaw = _base(poses.quaternion, radians(placing.heading))
    alignment = align(poses, attitude, gyro)
    if abs(alignment.turned) > TURNED:
        right = (placing.heading + alignment.turned + 180.0) % 360.0 - 180.0
        raise MocapError(
            f"according to the gyroscope the tracked body points {alignment.turned:.0f}° to the left of "
            f"heading={placing.heading:g}: write heading={right:.0f} if it is mounted so"
        )
    own = poses.times + alignment.offset
    if times[0] < own[0] - WINDOW or times[-1] > own[-1] + WINDOW:
        raise MocapError(
            "motion capture does not cover the whole rollout; check that it streams without a break"
        )
    # The poses just before and after the test count, too, because a gap may begin or end outside it.
    first, last = np.searchsorted(own, times[0]) - 1, np.searchsorted(own, times[-1], side="right")
    gap = float(np.max(np.diff(own[max(first, 0) : last + 1]), initial=0.0))
    if gap > WINDOW * (1 + 1e-9):
        raise MocapError(
            f"motion capture lost the robot for {gap:.3f} s, and at most {WINDOW:g} s are allowed; check cameras "
            "and markers"
        )
    base = poses.position - attitude @ np.array(placing.position)
    vx, vy = (_slope(poses.times, base[:, axis]) for axis in (0, 1))
    forward, left = np.cos(yaw) * vx + np.sin(yaw) * vy, np.cos(yaw) * vy - np.sin(yaw) * vx
    estimate = Velocity(np.interp(times, own, forward), np.interp(times, own, left), alignment)
    speed = float(np.hypot(estimate.forward, estimate.left).max())
    if speed > FASTEST:
        raise MocapError(
            f"according to motion capture the robot moves at {speed:.3g} m/s, too fast for an A1: check that it sends "
            "metres and tracks only one body"
        )
    return estimate


def _track(poses: Poses) -> Poses:
    """Return the poses from which a velocity can be computed.

    A system that has lost a body may repeat its last pose at new times. A pose without another one within ``WINDOW``
    has no slope.
    """
    pose = np.concatenate((poses.position, poses.quaternion), axis=1)
    poses = _select(poses, (np.diff(pose, axis=0, prepend=np.nan) != 0.0).any(axis=1))
    first, last = around(poses.times)
    return _select(poses, last - first > 1)


def _select(poses: Poses, chosen: NDArray[np.bool_]) -> Poses:
    return Poses(*(column[chosen] for column in poses))


def _slope(times: FloatArray, values: FloatArray) -> FloatArray:
    """Return (n,) slopes of straight lines through the values within ``WINDOW`` around each time."""
    first, last = around(times)
    t, v = times - times[0], values - values[0]

    def total(column: FloatArray) -> FloatArray:
        summed = np.concatenate(([0.0], np.cumsum(column)))
        sums: FloatArray = summed[last] - summed[first]
        return sums

    n = (last - first).astype(float)
    mean_t, mean_v = total(t) / n, total(v) / n
    spread = total(t * t) / n - mean_t**2
    slope: FloatArray = np.divide(
        total(t * v) / n - mean_t * mean_v, spread, out=np.zeros_like(t), where=spread > 1e-12
    )
    return slope


def _base(quaternion: FloatArray, heading: float) -> tuple[FloatArray, FloatArray]:
    """Return (n, 3, 3) attitudes of the base and its (n,) yaw [rad], from the body's attitudes and its heading."""
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    body = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    c, s = np.cos(heading), np.sin(heading)
    attitude = body @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return attitude, np.unwrap(np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0]))
