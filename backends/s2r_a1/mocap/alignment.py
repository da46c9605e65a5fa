"""The offset between the clocks of motion capture and of the robot, and the error of the heading.

Data: attitudes R_i of the base at times t_i on the clock of motion capture [s], from the tracked body's poses and its
stated heading; the robot's gyroscope ω_g(t) on the robot's clock.
Unknown: the offset o between the two clocks, in every rollout; the error ψ of the stated heading of the body.
Model: the mean angular velocities of the body over windows of 50 ms, m_i (n, 3) [rad/s] in base axes, are

    m_i = R_z(−ψ) ω_g(t_i + o) + b + e_i,   e_i ~ N(0, σ² I),   b a constant, σ unknown

Estimator: ψ, b and σ have closed forms, and the offset a flat prior from 2 s before the arrival of the poses to 0.03 s
after it. With RSS(o) the residual sum of squares and ν = 3 × (duration / 50 ms) independent numbers, the posterior is
p(o) ∝ RSS(o)^(−ν/2) on a grid of 1 ms. Its mean is the offset, its standard deviation the error. All three axes count,
because a straight walk hardly turns, but rolls and pitches in every step. The Bayes factor compares the model with no
relation, m_i = b + e_i. If it or the error is beyond its level, there is no velocity (:class:`MocapError`).

Source: Gaussian likelihood with σ profiled out, Gelman et al., Bayesian Data Analysis, section 3.2 and chapter 7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_a1.mocap.poses import MocapError, Poses
from s2r_a1.wire import FloatArray

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
LEAST = 40
"""A tolerance: smallest number of poses of a rollout, 0.2 s at 200 Hz."""


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


def around(times: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return for each time the indices of the first time within ``WINDOW`` around it, and of the first after it."""
    reach = WINDOW / 2 * (1 + 1e-9)
    return np.searchsorted(times, times - reach), np.searchsorted(times, times + reach, side="right")


def align(poses: Poses, attitude: FloatArray, gyro: Gyro) -> Alignment:
    """Return the alignment of poses, with (n, 3, 3) attitudes of the base by the stated heading, and a gyroscope.

    Raises:
        MocapError: the poses do not follow the gyroscope, come too late, or are too noisy.
    """
    from scipy.spatial.transform import Rotation  # slow to load, and not needed for velocity=onboard

    first, after = around(poses.times)
    way = Rotation.from_matrix(attitude[first]).inv() * Rotation.from_matrix(attitude[after - 1])
    start, stop = poses.times[first], poses.times[after - 1]
    tracked = way.as_rotvec() / (stop - start)[:, None]
    arrival = float(np.median(poses.arrived - poses.times))
    lags = np.arange(-SEARCH, EARLY + STEP / 2, STEP)
    angle = gyro.angle(STEP)
    begin, end = ((one + arrival + lags[0] - gyro.times[0]) / STEP for one in (start, stop))
    share = (start[-1] - start[0]) / (len(start) - 1) / WINDOW
    fits = []
    for place in range(len(lags)):
        # Windows outside the gyroscope's recording do not count; both ends of the windows rise.
        own = slice(
            np.searchsorted(begin + place, 0.0), np.searchsorted(end + place, len(angle) - 1.0, "right")
        )
        turned = _at(angle, end[own] + place) - _at(angle, begin[own] + place)
        fits.append(_fit(tracked[own], turned / (stop - start)[own, None], share))
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
    """Return (n, 3) values at (n,) places between the rows of (k, 3) values, from 0 to k − 1."""
    row = np.minimum(places.astype(np.intp), len(values) - 2)
    here, after = values.take(row, axis=0), values.take(row + 1, axis=0)
    between: FloatArray = here + (places - row)[:, None] * (after - here)
    return between


class _Fit(NamedTuple):
    """The fit at one offset: log Bayes factor against no relation, correlation, and heading error [deg]."""

    log_bayes: float
    correlation: float
    turned: float


def _fit(tracked: FloatArray, measured: FloatArray, share: float) -> _Fit:
    """Fit (n, 3) angular velocities of the body by the gyroscope's.

    ``share`` is the number of independent windows for a pose.
    """
    if len(tracked) < LEAST:
        return _Fit(-np.inf, 0.0, 0.0)
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
