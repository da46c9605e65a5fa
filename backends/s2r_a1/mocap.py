"""The true velocity of a walk, from motion capture.

Data: poses of a rigid body on the robot, as JSON lines {"t", "x", "y", "z", "qw", "qx", "qy", "qz"} [s, m] over UDP
on this machine; its clock has nothing to do with the robot's. Unknown: the offset between the two clocks, anew for
every rollout. Model: the yaw rate of the body is that of the robot's gyroscope, but for noise. Estimator: the offset
at which their correlation is largest, near to the one that the times of arrival suggest. A trot turns the body to and
fro once in 0.4 s, so that it has a peak. No pose comes before it was taken, which tells that peak from its neighbours;
poses must come within 0.15 s. Where it is low, nothing is said (:class:`MocapError`).

The yaw rate is the same whichever way the body looks. So the rates about the other two axes, as complex numbers, are
held against the gyroscope's: g = m exp(iψ), least squares over ψ, the angle by which the stated heading is wrong.

Both rates, and the velocity, are slopes of a straight line through the poses of 25 ms.
"""

from __future__ import annotations

import json
import socket
from dataclasses import dataclass
from math import radians
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import BackendError, UsageError

FloatArray = NDArray[np.float64]

WINDOW = 0.025
"""A tolerance [s]: width over which slopes are taken: five poses at 200 Hz. Twice as much lowers the noise of the
velocity by 2.8, and takes 2 % from a motion of 10 Hz instead of 0.5 %."""
SEARCH = 0.15
"""A budget [s]: how long a pose may be on its way. Twice as much finds the wrong period of the trot."""
EARLY = 0.03
"""A tolerance [s]: by which a pose may seem to come before it was taken, as the states are on their way, too.
Twice as much finds the wrong period where poses are 0.34 s late, and not only from 0.37 s on."""
STEP = 0.001
"""A tolerance [s]: between two offsets that are tried; a parabola refines the best."""
CORRELATED = 0.7
"""A level: the least correlation of the two yaw rates at which an offset is accepted. Higher refuses noisier mocap."""
TURNED = 10.0
"""A tolerance [deg]: by which the stated heading may be wrong. Its cosine takes 1.5 % from the velocity ahead, and its
sine adds 17 % of the velocity to the left. Twice as much makes them 6 % and 34 %."""
LEAST = 40
"""A tolerance: poses that a rollout needs, 0.2 s at 200 Hz; twice as many refuse a fall right after t = 0."""
FASTEST = 3.3
"""A level [m/s]: speed that no A1 reaches, by its maker. Beyond it numbers are no metres, or poses jump; twice as much
lets jumps of 8 cm pass."""
FARTHEST = 1.0
"""A level [m]: how far from the base's middle a body on an A1 can be, which is 0.6 m long. Twice as much lets pass
inches that are taken for metres."""
LARGEST = 65536
_NAMES = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")


class MocapError(BackendError):
    """Motion capture gives no velocity of a rollout; the sentence says why."""


@dataclass(frozen=True)
class Placing:
    """How the body that motion capture tracks is mounted.

    Attributes:
        position: of its origin in base axes [m].
        heading: of its x axis, from the robot's to the left [deg].
    """

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading: float = 0.0


class Poses(NamedTuple):
    """What motion capture said.

    Attributes:
        times: (n,) by its own clock [s], increasing.
        arrived: (n,) by the robot's clock [s].
        position: (n, 3) [m].
        quaternion: (n, 4) w, x, y, z.
    """

    times: FloatArray
    arrived: FloatArray
    position: FloatArray
    quaternion: FloatArray


class Gyro(NamedTuple):
    """What the robot's gyroscope said of a whole walk.

    Attributes:
        times: (m,) by the robot's clock [s].
        rates: (m, 3) base axes [rad/s].
        yaw: (m,) rates of the heading [rad/s].
    """

    times: FloatArray
    rates: FloatArray
    yaw: FloatArray

    def mean(self, rates: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the means of (m,) rates between (n,) times [s] and others."""
        steps = np.diff(self.times) * (rates[1:] + rates[:-1]) / 2.0
        angle = np.concatenate(([0.0], np.cumsum(steps)))
        means: FloatArray = (np.interp(end, self.times, angle) - np.interp(start, self.times, angle)) / (
            end - start
        )
        return means


class Velocity(NamedTuple):
    """The base's velocity in its heading frame [m/s], and how its time was found.

    Attributes:
        forward: (n,).
        left: (n,).
        offset: to add to the time of motion capture [s], for the robot's.
        correlation: of the two yaw rates there.
        turned: angle [deg] by which the stated heading seems to be wrong.
    """

    forward: FloatArray
    left: FloatArray
    offset: float
    correlation: float
    turned: float


class Listener:
    """Takes in poses on a port of this machine, from when it is made.

    Attributes:
        refused: lines that were no poses.
    """

    def __init__(self, port: int) -> None:
        """Open the port.

        Raises:
            MocapError: it is not to be had.
        """
        self.refused = 0
        self._rows: list[tuple[float, ...]] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", port))
        except OSError as error:
            self._socket.close()
            raise MocapError(
                f"the UDP port {port} for motion capture cannot be opened: {error.strerror}; end the program that "
                "holds it, or name another port"
            ) from None

    @property
    def port(self) -> int:
        """The UDP port."""
        return int(self._socket.getsockname()[1])

    def take(self, now: float) -> None:
        """Take in what has arrived by this time of the robot [s]."""
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
        """Free the port."""
        self._socket.close()


def velocity(poses: Poses, placing: Placing, gyro: Gyro, times: FloatArray) -> Velocity:
    """Return the base's velocity at (n,) times of the robot [s].

    Args:
        poses: of the body.
        placing: how it is mounted.
        gyro: of the whole walk.
        times: at which the velocity is wanted.

    Raises:
        MocapError: there are too few poses, they do not cover the test, the rates do not correlate, the heading is
            wrong, or no robot is as fast.
    """
    poses = _tracked(poses)
    if len(poses.times) < LEAST:
        raise MocapError(
            f"motion capture sent {len(poses.times)} usable poses, and {LEAST} are needed: check that it "
            "sees the robot, and sends 100 poses a second to this port"
        )
    attitude, yaw = _base(poses.quaternion, radians(placing.heading))
    offset, correlation = _offset(poses, _slope(poses.times, yaw), gyro)
    own = poses.times + offset
    turned = _turned(attitude, own, gyro, placing.heading)
    if times[0] < own[0] - WINDOW or times[-1] > own[-1] + WINDOW:
        raise MocapError(
            "motion capture does not cover the whole rollout; check that it streams without a break"
        )
    # The poses right before and right after the test count, too: a gap may begin or end outside of it.
    first, last = np.searchsorted(own, times[0]) - 1, np.searchsorted(own, times[-1], side="right")
    gap = float(np.max(np.diff(own[max(first, 0) : last + 1]), initial=0.0))
    if gap > 2.0 * WINDOW:
        raise MocapError(f"motion capture lost the robot for {gap:.3f} s; {2.0 * WINDOW:g} s are allowed")
    base = poses.position - attitude @ np.array(placing.position)
    vx, vy = (_slope(poses.times, base[:, axis]) for axis in (0, 1))
    forward, left = np.cos(yaw) * vx + np.sin(yaw) * vy, np.cos(yaw) * vy - np.sin(yaw) * vx
    seen = Velocity(np.interp(times, own, forward), np.interp(times, own, left), offset, correlation, turned)
    speed = float(np.hypot(seen.forward, seen.left).max())
    if speed > FASTEST:
        raise MocapError(
            f"by motion capture the robot moves at {speed:.3g} m/s, which no A1 can: check its unit, metres, and "
            "that it tracks one body only"
        )
    return seen


def _tracked(poses: Poses) -> Poses:
    """Return the poses that tell a velocity.

    A system that has lost a body may send its last pose again and again, at new times. A pose without another one
    within ``WINDOW`` has no slope.
    """
    pose = np.concatenate((poses.position, poses.quaternion), axis=1)
    moved = np.diff(pose, axis=0, prepend=np.nan) != 0.0
    poses = _those(poses, np.logical_or.reduce(moved, axis=1))
    first, last = _around(poses.times)
    return _those(poses, last - first > 1)


def _those(poses: Poses, chosen: NDArray[np.bool_]) -> Poses:
    return Poses(*(column[chosen] for column in poses))


def _around(times: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first of the times within ``WINDOW`` around each, and the first after them."""
    reach = WINDOW / 2 * (1 + 1e-9)
    return np.searchsorted(times, times - reach), np.searchsorted(times, times + reach, side="right")


def _offset(poses: Poses, rate: FloatArray, gyro: Gyro) -> tuple[float, float]:
    """Return the offset [s] at which a yaw rate (n,) follows the gyroscope's best, and their correlation there.

    Raises:
        MocapError: they do not correlate.
    """
    # The gyroscope's rate is smoothed as the other is.
    times = gyro.times
    smooth = gyro.mean(gyro.yaw, times - WINDOW / 2, times + WINDOW / 2)
    guess = float(np.median(poses.arrived - poses.times))
    lags = np.arange(-SEARCH, EARLY + STEP / 2, STEP)
    score = np.array([_correlation(poses.times + guess + lag, rate, times, smooth) for lag in lags])
    best = int(np.argmax(score))
    if (
        not score[best] >= CORRELATED or not 0 < best < len(lags) - 1
    ):  # at an end there is no peak, only its slope
        raise MocapError(
            f"the yaw rate of motion capture does not follow the gyroscope (correlation {score[best]:.2f} < "
            f"{CORRELATED:g}): check body, axes (z up) and delay (at most {SEARCH:g} s)"
        )
    before, here, after = score[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    refined = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return guess + float(lags[best]) + refined * STEP, float(score[best])


def _turned(attitude: FloatArray, own: FloatArray, gyro: Gyro, heading: float) -> float:
    """Return the angle [deg] by which the stated heading of the body seems to be wrong.

    Args:
        attitude: (n, 3, 3) of the base, by the stated heading.
        own: (n,) times of it, by the robot's clock [s].
        gyro: of the walk.
        heading: as stated [deg].

    Raises:
        MocapError: roll and pitch rates do not correlate, or it is wrong by more than ``TURNED``.
    """
    from scipy.spatial.transform import Rotation  # takes a while to load, and onboard walks go without

    first, end = _around(own)
    last = end - 1
    inside = (own[first] >= gyro.times[0]) & (own[last] <= gyro.times[-1])
    first, last = first[inside], last[inside]
    start, stop = own[first], own[last]
    way = Rotation.from_matrix(attitude[first]).inv() * Rotation.from_matrix(attitude[last])
    x, y, _ = (way.as_rotvec() / (stop - start)[:, None]).T
    seen, felt = (
        x + 1j * y,
        gyro.mean(gyro.rates[:, 0], start, stop) + 1j * gyro.mean(gyro.rates[:, 1], start, stop),
    )
    seen, felt = seen - seen.mean(), felt - felt.mean()
    both, size = np.vdot(seen, felt), float(np.linalg.norm(seen) * np.linalg.norm(felt))
    if not abs(both) >= CORRELATED * size > 0.0:
        raise MocapError(
            "roll and pitch of motion capture do not follow the gyroscope: check that it tracks this robot, with z up"
        )
    turned = float(np.degrees(np.angle(both)))
    if abs(turned) > TURNED:
        raise MocapError(
            f"by the gyroscope the tracked body looks {turned:.0f}° to the left of heading={heading:g}: "
            f"write heading={(heading + turned + 180.0) % 360.0 - 180.0:.0f} if it is mounted so"
        )
    return turned


def _correlation(own: FloatArray, rate: FloatArray, times: FloatArray, gyro: FloatArray) -> float:
    """Return the correlation of two rates where their times overlap; −1 where too few do."""
    both = (own >= times[0] + WINDOW) & (own <= times[-1] - WINDOW)
    if both.sum() < LEAST:
        return -1.0
    a, b = rate[both], np.interp(own[both], times, gyro)
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0.0 else -1.0


def _slope(times: FloatArray, values: FloatArray) -> FloatArray:
    """Return (n,) slopes of the straight lines through the values within ``WINDOW`` around each time."""
    first, last = _around(times)
    t, v = times - times[0], values - values[0]

    def total(column: FloatArray) -> FloatArray:
        summed = np.concatenate(([0.0], np.cumsum(column)))
        found: FloatArray = summed[last] - summed[first]
        return found

    n = (last - first).astype(float)
    mean_t, mean_v = total(t) / n, total(v) / n
    spread = total(t * t) / n - mean_t**2
    slope: FloatArray = np.divide(
        total(t * v) / n - mean_t * mean_v, spread, out=np.zeros_like(t), where=spread > 1e-12
    )
    return slope


def _base(quaternion: FloatArray, heading: float) -> tuple[FloatArray, FloatArray]:
    """Return (n, 3, 3) attitudes of the base and its (n,) yaw [rad], from those of a body that looks elsewhere."""
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
    """Return the eight numbers of a line, or None if it is no pose."""
    try:
        pose = json.loads(line)
        row = tuple(float(pose[name]) for name in _NAMES)
    except (ValueError, TypeError, KeyError, RecursionError):
        return None
    return row if np.isfinite(row).all() and abs(np.linalg.norm(row[4:]) - 1.0) < 0.01 else None


def read_placing(body: str | None, heading: str | None) -> Placing:
    """Return a placing from texts such as ``0.1:0:0.05`` and ``90``.

    Raises:
        UsageError: they are none.
    """
    placing = Placing()
    try:
        if body is not None:
            x, y, z = (float(part) for part in body.split(":"))
            placing = Placing((x, y, z))
        if heading is not None:
            placing = Placing(placing.position, float(heading))
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
            "it is in metres, as in body=0.1:0:0.05"
        )
    return placing
