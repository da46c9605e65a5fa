"""The law of a robot's motors, fitted to logged torques.

Data: of n ticks positions q, velocities q̇ and torques τ (n, J), and the targets T of a loop. Model:

    τ_k = κ_j (T_{k−d} − q_k) − δ_j q̇_k + c_j + ε,   κ, δ ~ N(stated, (GAINS · stated)²),   c ~ N(0, (OFFSET κ)²)

Estimator: κ, δ and c at the maximum, with σ of each joint in turn; of delays, lags and ages of the state the best one.
Units: those of τ. Shapes: n ticks, J joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from s2r_mujoco.arrays import FloatArray

SATURATED = 0.98
"""Tolerance: part of its limit from which on a torque says nothing of the target, or of the gains."""
DELAYS = range(4)
"""Budget: ticks by which a logged torque may be older than the target of its row."""
LAGS = (0.5, 1.0, 2.0, 5.0)
"""Budget: time constants of a lag of the targets, in ticks."""
AGES = (0.5, 1.0, 1.5, 2.0, 3.0)
"""Budget: ticks by which a logged state may be older than that of the motors."""
GAINS, OFFSET = 0.15, 0.02
"""Prior: relative deviation of a gain; deviation of an encoder's offset [rad or m]. Both as in the catalogue."""
ROUNDS = 3
"""Budget: rounds of gains and σ."""


@dataclass(frozen=True)
class Fit:
    """What targets leave of torques: (n, J), NaN at a limit; (J,) κ; and −log p(κ, δ, c)."""

    left: FloatArray
    kappa: FloatArray
    price: float


@dataclass(frozen=True, eq=False)
class Motors:
    """(n, J) positions, velocities and torques, and (J, 2) the stated gains, NaN where none are."""

    position: FloatArray
    speed: FloatArray
    torque: FloatArray
    stated: FloatArray

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """(n, J) whether a torque is below its limit; the target of the tick before the first is unknown."""
        free = np.abs(self.torque) < SATURATED * np.abs(self.torque).max(axis=0, initial=0.0)
        free[: DELAYS[-1]] = False
        return free & (free.sum(axis=0) > 3)

    @cached_property
    def prior(self) -> tuple[FloatArray, FloatArray]:
        """(J, 3) mean and precision of κ, δ and c; flat where no gains are stated."""
        known: NDArray[np.bool_] = np.asarray(np.isfinite(self.stated).all(axis=1))
        stated = np.where(known[:, None], self.stated, 0.0)
        deviation = np.column_stack([GAINS * stated, OFFSET * stated[:, 0]]) + 1e-9
        precision = np.where(known[:, None], deviation**-2, 1e-12)
        return np.column_stack([stated, np.zeros(len(stated))]), precision

    def fit(self, target: FloatArray) -> Fit:
        """Return what κ (T − q) − δ q̇ + c leaves of the torques below their limits, by (n, J) targets."""
        free = self.free
        x = np.stack([target - self.position, -self.speed, np.ones_like(target)], axis=2) * free[..., None]
        y, count = self.torque * free, np.maximum(free.sum(axis=0), 1)
        (mean, precision), gram = self.prior, np.einsum("njk,njl->jkl", x, x)
        moment, gains = np.einsum("njk,nj->jk", x, y), self.prior[0]
        for _ in range(ROUNDS):
            variance = ((y - np.einsum("njk,jk->nj", x, gains)) ** 2).sum(axis=0)[:, None] / count[
                :, None
            ] + 1e-12
            matrix = gram / variance[..., None] + precision[..., None] * np.eye(3)
            gains = np.linalg.solve(matrix, (moment / variance + precision * mean)[..., None])[..., 0]
        left = np.where(free, y - np.einsum("njk,jk->nj", x, gains), np.nan)
        price = 0.5 * float((precision * (gains - mean) ** 2).sum()) / len(mean)
        return Fit(left, gains[:, 0], price)

    def best(self, target: FloatArray, step: float, most: float) -> Fit:
        """Return the best fit of delays and lags of (n, J) targets.

        Where it leaves a mean square above ``most``, the logged state may be older than that of the motors. ``step`` is
        what the log rounds to.
        """

        def size(fit: Fit) -> float:
            return float(log_squares(fit.left, step).sum())

        sent = [_late(target, delay) for delay in DELAYS]
        best = min((self.fit(one) for one in sent), key=size)
        for one, other in pairwise(sent):  # with jitter, some ticks have the target of another tick
            best = min(best, self.fit(self._nearest(one, other)), key=size)
        best = min(best, *(self.fit(one) for one in _lagging(target)), key=size)
        if np.nanmean(best.left**2) > most:
            newer = [
                replace(self, position=_sooner(self.position, x), speed=_sooner(self.speed, x)) for x in AGES
            ]
            best = min(best, *(each.fit(one) for each in newer for one in sent[:2]), key=size)
        return best

    def _nearest(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Return (n, J) the targets of one or the other, whichever leaves less of the torques at a tick."""
        fit = self.fit(one)
        left = np.nan_to_num(fit.left)
        moved = np.where(np.isfinite(fit.left), fit.kappa * (other - one), 0.0)
        nearer = ((left - moved) ** 2).sum(axis=1) < (left**2).sum(axis=1)
        return np.where(nearer[:, None], other, one)


def _late(target: FloatArray, ticks: int) -> FloatArray:
    """Return (n, J) targets some ticks later; before the first target there is none, and it stands for it."""
    return target[np.maximum(np.arange(len(target)) - ticks, 0)]


def _sooner(state: FloatArray, ticks: float) -> FloatArray:
    """Return (n, J) the state that a log has some ticks later; at the end the last one stands for it."""
    whole, share = divmod(ticks, 1.0)
    rows = np.arange(len(state)) + int(whole)
    one, other = (state[np.minimum(rows + k, len(state) - 1)] for k in (0, 1))
    return np.asarray((1.0 - share) * one + share * other)


def _lagging(target: FloatArray) -> Iterator[FloatArray]:
    """Yield (n, J) targets with lags."""
    from scipy.signal import lfilter

    for ticks in LAGS:
        keep = np.exp(-1.0 / ticks)
        yield lfilter([1.0 - keep], [1.0, -keep], target, axis=0, zi=keep * target[:1])[0]


def log_squares(left: FloatArray, step: float) -> FloatArray:
    """Return (J',) the log of each joint's mean square, for joints of which something is known."""
    known = np.isfinite(left).sum(axis=0)
    squares = np.nansum(left**2, axis=0)[known > 0] / known[known > 0]
    return np.log(squares + step**2 + 1e-300)
