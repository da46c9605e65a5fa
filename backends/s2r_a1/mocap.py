"""The true velocity of a walk, from motion capture.

Data: poses of a rigid body on the robot, as JSON lines {"t", "x", "y", "z", "qw", "qx", "qy", "qz"} [s, m] over UDP on
this computer, on a clock of their own; the robot's gyroscope ω_g(t) on the robot's clock.
Unknown: the offset o between the two clocks, in every rollout; the error ψ of the stated heading of the body.
Model: the mean angular velocities of the body over windows of 50 ms, m_i (n, 3) [rad/s] in base axes, are

    m_i = R_z(−ψ) ω_g(t_i + o) + b + e_i,   e_i ~ N(0, σ² I),   b a constant, σ unknown

Estimator: ψ, b and σ have closed forms, and the offset a flat prior from 2 s before the arrival of the poses to 0.03 s
after it. With RSS(o) the residual sum of squares and ν = 3 × (duration / 50 ms) independent numbers, the posterior is
p(o) ∝ RSS(o)^(−ν/2) on a grid of 1 ms. Its mean is the offset, its standard deviation the error. All three axes count,
because a straight walk hardly turns, but rolls and pitches in every step. The Bayes factor compares the model with no
relation, m_i = b + e_i. If it or the error is beyond its level, there is no velocity (:class:`MocapError`).

Both the angular velocities and the velocity are slopes over the poses within 50 ms.
Source: Gaussian likelihood with σ profiled out, Gelman et al., Bayesian Data Analysis, section 3.2 and chapter 7.
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

WINDOW = 0.05
"""A tolerance [s]: width of the window for slopes, five poses at 100 Hz. It keeps 98 % of an oscillation at 2.5 Hz, the
trot's steps, and markers with 0.1 mm of noise give a velocity with 3 mm/s."""
SEARCH = 2.0
"""A budget [s]: longest delay of a pose; the robot stands and lies down for longer after a walk."""
EARLY = 0.03
"""A tolerance [s]: apparent arrival of a pose before it was taken, because states are delayed, too."""
STEP = 0.001
"""A tolerance [s]: step between two candidate offsets."""
UNRELATED = 1e-6
"""A level: largest posterior probability, at equal priors, that the poses are of another body."""
CLOCK_ERROR = 0.005
"""A tolerance [s]: largest standard deviation of the offset. At 1 m/s² the velocity is then off by 5 mm/s."""
DELAYED = 0.1
"""A level [s]: delay of the poses from which on the operator is informed."""
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
    """The robot's gyroscope over a whole recording, from standing up to standing again.

    Its beginning and end tell a delay of one step from none.

    Attributes:
        times: (m,) times on the robot's clock [s].
        rates: (m, 3) angular velocity in base axes [rad/s].
    """

    times: FloatArray
    rates: FloatArray

    def angle(self, step: float) -> FloatArray:
        """Return (k, 3) integrals of the rates [rad] up to times that are ``step`` [s] apart, from the first one on."""
        turns = np.diff(self.times)[:, None] * (self.rates[1:] + self.rates[:-1]) / 2.0
        angle = np.concatenate((np.zeros((1, 3)), np.cumsum(turns, axis=0)))
        times = np.arange(self.times[0], self.times[-1], step)
        return np.stack([np.interp(times, self.times, one) for one in angle.T], axis=1)


class Alignment(NamedTuple):
    """The alignment of motion capture with the robot.

    Attributes:
        offset: robot's time minus time of motion capture [s].
        error: standard deviation of the offset [s].
        correlation: correlation of the angular velocities at this offset.
        turned: estimated error of the stated heading [deg].
        delay: median time from a pose to its arrival [s].
    """

    offset: float
    error: float
    correlation: float
    turned: float
    delay: float


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
    alignment = _aligned(poses, attitude, gyro)
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
    first, last = _around(poses.times)
    return _select(poses, last - first > 1)


def _select(poses: Poses, chosen: NDArray[np.bool_]) -> Poses:
    return Poses(*(column[chosen] for column in poses))


def _around(times: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return for each time the indices of the first time within ``WINDOW`` around it, and of the first after it."""
    reach = WINDOW / 2 * (1 + 1e-9)
    return np.searchsorted(times, times - reach), np.searchsorted(times, times + reach, side="right")


def _aligned(poses: Poses, attitude: FloatArray, gyro: Gyro) -> Alignment:
    """Return the alignment of poses, with (n, 3, 3) attitudes of the base by the stated heading, and a gyroscope.

    Raises:
        MocapError: the poses do not follow the gyroscope, come too late, or are too noisy.
    """
    from scipy.spatial.transform import Rotation  # slow to load, and not needed for velocity=onboard

    first, after = _around(poses.times)
    way = Rotation.from_matrix(attitude[first]).inv() * Rotation.from_matrix(attitude[after - 1])
    start, stop = poses.times[first], poses.times[after - 1]
    tracked = way.as_rotvec() / (stop - start)[:, None]
    arrival = float(np.median(poses.arrived - poses.times))
    lags = np.arange(-SEARCH, EARLY + STEP / 2, STEP)
    angle = gyro.angle(STEP)
    begin, end = ((one + arrival + lags[0] - gyro.times[0]) / STEP for one in (start, stop))
    share = (start[-1] - start[0]) / (len(start) - 1) / WINDOW
    fits = [
        _fit(tracked, (_at(angle, end + lag) - _at(angle, begin + lag)) / (stop - start)[:, None], share)
        for lag in range(len(lags))
    ]
    log_bayes = np.array([fit.log_bayes for fit in fits])
    best = fits[int(log_bayes.argmax())]
    if np.isfinite(best.log_bayes):
        weight = np.exp(log_bayes - best.log_bayes)
    if not np.isfinite(best.log_bayes) or best.log_bayes + np.log(weight.mean()) < -np.log(UNRELATED):
        raise MocapError(
            "roll, pitch and yaw of motion capture do not follow the gyroscope (correlation "
            f"{best.correlation:.2f}): check that it tracks this robot, with z up, and that its poses are at most "
            f"{SEARCH:g} s late"
        )
    lag = float(np.average(lags, weights=weight))
    error = float(np.sqrt(np.average((lags - lag) ** 2, weights=weight)))
    if not lags[0] + CLOCK_ERROR < lag < lags[-1] - CLOCK_ERROR:  # a slope towards an offset beyond the end
        raise MocapError(
            f"the poses of motion capture come later than {SEARCH:g} s, or before they were taken, according to the "
            "gyroscope: send every pose at once"
        )
    if error > CLOCK_ERROR:
        raise MocapError(
            f"the clock of motion capture is known to ±{error * 1e3:.0f} ms only, and ±{CLOCK_ERROR * 1e3:g} ms are "
            f"needed: its poses are too noisy, or later than {SEARCH:g} s"
        )
    return Alignment(arrival + lag, error, best.correlation, best.turned, -lag)


def _at(values: FloatArray, places: FloatArray) -> FloatArray:
    """Return (n, 3) values at (n,) places between the rows of (k, 3) values; NaN beyond its ends."""
    row = np.clip(places.astype(np.intp), 0, len(values) - 2)
    share = places - row
    share[(share < 0.0) | (share > 1.0)] = np.nan
    between: FloatArray = values[row] + share[:, None] * (values[row + 1] - values[row])
    return between


class _Fit(NamedTuple):
    """The fit at one offset: log Bayes factor against no relation, correlation, and heading error [deg]."""

    log_bayes: float
    correlation: float
    turned: float


def _fit(tracked: FloatArray, measured: FloatArray, share: float) -> _Fit:
    """Fit (n, 3) angular velocities of the body by the gyroscope's, which are NaN outside its recording.

    ``share`` is the number of independent windows for a pose.
    """
    inside = np.isfinite(measured[:, 0])
    if np.count_nonzero(inside) < LEAST:
        return _Fit(-np.inf, 0.0, 0.0)
    tracked, measured = tracked[inside], measured[inside]
    tracked, measured = tracked - tracked.mean(axis=0), measured - measured.mean(axis=0)
    # About z, a rotation by ψ of the two other axes is a factor exp(iψ).
    across = np.vdot(tracked[:, 0] + 1j * tracked[:, 1], measured[:, 0] + 1j * measured[:, 1])
    product = float(abs(across) + tracked[:, 2] @ measured[:, 2])
    moved, turned = float(np.sum(tracked**2)), float(np.sum(measured**2))
    if moved <= 0.0 or turned <= 0.0:
        return _Fit(-np.inf, 0.0, 0.0)
    residual = max(moved + turned - 2.0 * product, np.finfo(float).eps * moved)
    return _Fit(
        1.5 * share * len(tracked) * float(np.log(moved / residual)),
        product / float(np.sqrt(moved * turned)),
        float(np.degrees(np.angle(across))),
    )


def _slope(times: FloatArray, values: FloatArray) -> FloatArray:
    """Return (n,) slopes of straight lines through the values within ``WINDOW`` around each time."""
    first, last = _around(times)
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
            "write it in metres, as in body=0.1:0:0.05"
        )
    return placing
