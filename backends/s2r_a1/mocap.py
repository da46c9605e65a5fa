"""The true velocity of a walk, from motion capture.

Data: poses of a rigid body on the robot, as JSON lines {"t", "x", "y", "z", "qw", "qx", "qy", "qz"} [s, m] over UDP on
this computer; their clock is independent of the robot's. Unknown: the offset between the two clocks, in every rollout.
Model: the body and the robot's gyroscope have the same yaw rate, up to noise. Estimator: the offset with the
largest correlation, near the offset that the times of arrival suggest. A trot turns the body left and right once in
0.4 s, so the correlation has a peak. A pose cannot arrive before it was taken, which separates the peak from its
neighbours. If the peak is low, there is no velocity (:class:`MocapError`).

The yaw rate does not depend on the heading at which the body is mounted. So the rates about the other two axes, as
complex numbers, are compared with the gyroscope's: g = m exp(iψ), least squares over ψ, the error of the stated
heading. Both rates and the velocity are slopes of straight lines through the poses of 25 ms.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import radians
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_a1.datagrams import open_port
from s2r_a1.wire import FloatArray
from s2r_spec.errors import BackendError, UsageError

WINDOW = 0.025
"""A tolerance [s]: width of the window for slopes, five poses at 200 Hz."""
SEARCH = 0.15
"""A budget [s]: longest delay of a pose."""
EARLY = 0.03
"""A tolerance [s]: apparent arrival of a pose before it was taken, because states are delayed, too."""
STEP = 0.001
"""A tolerance [s]: step between two candidate offsets; a parabola refines the best."""
CORRELATED = 0.7
"""A level: smallest correlation of the two yaw rates for an accepted offset. A higher level refuses noisier mocap."""
TURNED = 10.0
"""A tolerance [deg]: error of the stated heading. Its cosine takes 1.5 % from the forward velocity, and its sine adds
17 % of the velocity to the left."""
LEAST = 40
"""A tolerance: smallest number of poses of a rollout, 0.2 s at 200 Hz."""
FASTEST = 3.3
"""A level [m/s]: speed that no A1 reaches, according to its manufacturer. Faster motion means wrong units or jumping
poses."""
FARTHEST = 1.0
"""A level [m]: largest distance of a body from the middle of the base of an A1, which is 0.6 m long."""
LARGEST = 65536
_NAMES = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")


class MocapError(BackendError):
    """Motion capture gives no velocity of a rollout; the message says why."""


@dataclass(frozen=True)
class Placing:
    """Pose, in base axes, of the tracked body: its origin [m], and the heading of its x axis to the left [deg]."""

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading: float = 0.0


class Poses(NamedTuple):
    """Poses from motion capture.

    Attributes:
        times: (n,) times on its own clock [s], increasing.
        arrived: (n,) times of arrival on the robot's clock [s].
        position: (n, 3) positions [m].
        quaternion: (n, 4) attitudes w, x, y, z.
    """

    times: FloatArray
    arrived: FloatArray
    position: FloatArray
    quaternion: FloatArray


class Gyro(NamedTuple):
    """The robot's gyroscope over a whole walk.

    Attributes:
        times: (m,) times on the robot's clock [s].
        rates: (m, 3) angular velocity in base axes [rad/s].
        yaw: (m,) rate of the heading [rad/s].
    """

    times: FloatArray
    rates: FloatArray
    yaw: FloatArray

    def mean(self, rates: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the means of (m,) rates over n intervals, from ``start`` to ``end`` (n,) [s]."""
        steps = np.diff(self.times) * (rates[1:] + rates[:-1]) / 2.0
        angle = np.concatenate(([0.0], np.cumsum(steps)))
        turned: FloatArray = np.interp(end, self.times, angle) - np.interp(start, self.times, angle)
        return turned / (end - start)


class Velocity(NamedTuple):
    """The base's velocity in its heading frame [m/s], and the alignment of the clocks.

    Attributes:
        forward: (n,) forward velocity [m/s].
        left: (n,) velocity to the left [m/s].
        offset: robot's time minus time of motion capture [s].
        correlation: correlation of the two yaw rates at this offset.
        turned: estimated error of the stated heading [deg].
    """

    forward: FloatArray
    left: FloatArray
    offset: float
    correlation: float
    turned: float


class Listener:
    """Collects poses on a port of this computer; ``refused`` counts lines that are not poses."""

    def __init__(self, port: int) -> None:
        """Open the port; raise MocapError if it cannot be opened."""
        self.refused = 0
        self._rows: list[tuple[float, ...]] = []
        self._socket = open_port(("127.0.0.1", port), MocapError, "the UDP port {} for motion capture")

    @property
    def port(self) -> int:
        """The UDP port."""
        return int(self._socket.getsockname()[1])

    def take(self, now: float) -> None:
        """Collect the poses that have arrived by this time of the robot [s]."""
        while True:
            try:
                data = self._socket.recv(LARGEST)
            except OSError:
                return
            for line in data.splitlines():
                row = _row(line)
                if row is None:
                    self.refused += 1
                elif not self._rows or row[0] > self._rows[-1][0]:
                    self._rows.append((*row, now))

    def poses(self) -> Poses:
        """Return all poses so far."""
        rows = np.array(self._rows).reshape(-1, 9)
        return Poses(rows[:, 0], rows[:, 8], rows[:, 1:4], rows[:, 4:8])

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


def velocity(poses: Poses, placing: Placing, gyro: Gyro, times: FloatArray) -> Velocity:
    """Return the base's velocity at (n,) ``times`` of the robot [s], from poses of the body during the whole walk.

    Raises:
        MocapError: there are too few poses, they do not cover the test, the rates do not correlate, the heading is
            wrong, or the velocity is impossible.
    """
    poses = _track(poses)
    if len(poses.times) < LEAST:
        raise MocapError(
            f"motion capture sent {len(poses.times)} valid poses, and {LEAST} are needed: check that it "
            "tracks the robot, and sends 100 poses per second to this port"
        )
    attitude, yaw = _base(poses.quaternion, radians(placing.heading))
    offset, correlation = _offset(poses, _slope(poses.times, yaw), gyro)
    own = poses.times + offset
    turned = _heading_error(attitude, own, gyro, placing.heading)
    if times[0] < own[0] - WINDOW or times[-1] > own[-1] + WINDOW:
        raise MocapError(
            "motion capture does not cover the whole rollout; check that it streams without a break"
        )
    # The poses just before and after the test count, too, because a gap may begin or end outside it.
    first, last = np.searchsorted(own, times[0]) - 1, np.searchsorted(own, times[-1], side="right")
    gap = float(np.max(np.diff(own[max(first, 0) : last + 1]), initial=0.0))
    if gap > 2.0 * WINDOW:
        raise MocapError(
            f"motion capture lost the robot for {gap:.3f} s, and at most {2.0 * WINDOW:g} s are allowed; check cameras "
            "and markers"
        )
    base = poses.position - attitude @ np.array(placing.position)
    vx, vy = (_slope(poses.times, base[:, axis]) for axis in (0, 1))
    forward, left = np.cos(yaw) * vx + np.sin(yaw) * vy, np.cos(yaw) * vy - np.sin(yaw) * vx
    estimate = Velocity(
        np.interp(times, own, forward), np.interp(times, own, left), offset, correlation, turned
    )
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
    first, last = _around(poses.times)
    return _select(poses, last - first > 1)


def _select(poses: Poses, chosen: NDArray[np.bool_]) -> Poses:
    return Poses(*(column[chosen] for column in poses))


def _around(times: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return for each time the indices of the first time within ``WINDOW`` around it, and of the first after it."""
    reach = WINDOW / 2 * (1 + 1e-9)
    return np.searchsorted(times, times - reach), np.searchsorted(times, times + reach, side="right")


def _offset(poses: Poses, rate: FloatArray, gyro: Gyro) -> tuple[float, float]:
    """Return the offset [s] with the largest correlation of a yaw rate (n,) with the gyroscope's, and the latter."""
    # The gyroscope's rate is smoothed like the other rate.
    times = gyro.times
    smooth = gyro.mean(gyro.yaw, times - WINDOW / 2, times + WINDOW / 2)
    guess = float(np.median(poses.arrived - poses.times))
    lags = np.arange(-SEARCH, EARLY + STEP / 2, STEP)
    score = np.array([_correlation(poses.times + guess + lag, rate, times, smooth) for lag in lags])
    best = int(np.argmax(score))
    # At an end there is no peak, only its slope.
    if not score[best] >= CORRELATED or not 0 < best < len(lags) - 1:
        raise MocapError(
            f"the yaw rate of motion capture does not follow the gyroscope (correlation {score[best]:.2f} < "
            f"{CORRELATED:g}): check body, axes (z up) and delay (at most {SEARCH:g} s)"
        )
    before, here, after = score[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    refined = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return guess + float(lags[best]) + refined * STEP, float(score[best])


def _heading_error(attitude: FloatArray, own: FloatArray, gyro: Gyro, heading: float) -> float:
    """Return the estimated error of the body's stated heading [deg]; raise MocapError if it exceeds ``TURNED``.

    ``attitude`` (n, 3, 3) are those of the base by the stated heading, at the robot's times ``own`` (n,) [s].
    """
    from scipy.spatial.transform import Rotation  # slow to load, and not needed for velocity=onboard

    first, end = _around(own)
    last = end - 1
    inside = (own[first] >= gyro.times[0]) & (own[last] <= gyro.times[-1])
    first, last = first[inside], last[inside]
    start, stop = own[first], own[last]
    way = Rotation.from_matrix(attitude[first]).inv() * Rotation.from_matrix(attitude[last])
    x, y, _ = (way.as_rotvec() / (stop - start)[:, None]).T
    tracked = x + 1j * y
    measured = gyro.mean(gyro.rates[:, 0], start, stop) + 1j * gyro.mean(gyro.rates[:, 1], start, stop)
    tracked, measured = tracked - tracked.mean(), measured - measured.mean()
    product, size = np.vdot(tracked, measured), float(np.linalg.norm(tracked) * np.linalg.norm(measured))
    if not abs(product) >= CORRELATED * size > 0.0:
        raise MocapError(
            "roll and pitch of motion capture do not follow the gyroscope: check that it tracks this robot, with z up"
        )
    turned = float(np.degrees(np.angle(product)))
    if abs(turned) > TURNED:
        raise MocapError(
            f"according to the gyroscope the tracked body points {turned:.0f}° to the left of heading={heading:g}: "
            f"write heading={(heading + turned + 180.0) % 360.0 - 180.0:.0f} if it is mounted so"
        )
    return turned


def _correlation(own: FloatArray, rate: FloatArray, times: FloatArray, gyro: FloatArray) -> float:
    """Return the correlation of two rates over their common time; −1 if that is too short."""
    both = (own >= times[0] + WINDOW) & (own <= times[-1] - WINDOW)
    if both.sum() < LEAST:
        return -1.0
    a, b = rate[both], np.interp(own[both], times, gyro)
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else -1.0


def _slope(times: FloatArray, values: FloatArray) -> FloatArray:
    """Return (n,) slopes of straight lines through the values within ``WINDOW`` around each time."""
    first, last = _around(times)
    t, v = times - times[0], values - values[0]

    def mean(column: FloatArray) -> FloatArray:
        summed = np.concatenate(([0.0], np.cumsum(column)))
        means: FloatArray = (summed[last] - summed[first]) / (last - first)
        return means

    spread, common = mean(t * t) - mean(t) ** 2, mean(t * v) - mean(t) * mean(v)
    slope: FloatArray = np.divide(common, spread, out=np.zeros_like(t), where=spread > 1e-12)
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


def _row(line: bytes) -> tuple[float, ...] | None:
    """Return the eight numbers of a line, or None if it is not a pose."""
    try:
        pose = json.loads(line)
        row = tuple(float(pose[name]) for name in _NAMES)
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return row if np.isfinite(row).all() and abs(np.linalg.norm(row[4:]) - 1.0) < 0.01 else None


def read_placing(body: str | None, heading: str | None) -> Placing:
    """Read a placing from texts such as ``0.1:0:0.05`` and ``90``.

    Raises:
        UsageError: a text has another form, or a number is impossible.
    """
    try:
        x, y, z = (float(part) for part in ("0:0:0" if body is None else body).split(":"))
        placing = Placing((x, y, z), 0.0 if heading is None else float(heading))
    except ValueError:
        raise UsageError(
            "body=X:Y:Z is the tracked body's position in base axes [m], and heading=DEGREES its x axis, "
            "left of the robot's; for example body=0.1:0:0.05,heading=90"
        ) from None
    if not np.isfinite([*placing.position, placing.heading]).all():
        raise UsageError("body and heading must be finite numbers, as in body=0.1:0:0.05,heading=90")
    if max(map(abs, placing.position)) > FARTHEST:
        raise UsageError(
            f"body = {body!r} is {max(map(abs, placing.position)):g} m from the middle of the base, beyond the robot; "
            "write it in metres, as in body=0.1:0:0.05"
        )
    return placing
