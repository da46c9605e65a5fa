"""Means of |ρ_real − E ρ_sim| over rollouts, and the part of them that an improved simulator closes.

Data: differences (n,) of rollouts, with the number of each one's test. Estimators: means; their 95 % intervals by a
bootstrap over whole tests. Units: those of ρ; a share has none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.gap import DRAWS, LEVEL

GONE = 0.8
"""Level: part of a gap, where it shows, from which on it is closed. A gap has a share if it exceeds the floor by the
rest, a fifth of it. Higher, more laws that are off are *none of these*."""


@dataclass(frozen=True, order=True)
class Share:
    """An estimate with its interval.

    Attributes:
        estimate: the estimate of a share.
        low: the lower end of the 95 % interval.
        high: the upper end of the 95 % interval.
    """

    estimate: float
    low: float
    high: float

    @property
    def gone(self) -> bool:
        """Whether a gap of which this is closed is nearly gone, and surely smaller."""
        return self.estimate >= GONE and self.low > 0.0

    @classmethod
    def of(cls, draws: FloatArray) -> Share:
        """Return the first number, with the interval of the others, which are resampled."""
        return cls(float(draws[0]), *np.quantile(draws[1:], [LEVEL / 2, 1.0 - LEVEL / 2]).tolist())


@dataclass(frozen=True)
class Gap:
    """|ρ_real − E ρ_sim| over rollouts, in the unit of ρ.

    Attributes:
        mean: over the rollouts.
        low: of the mean's 95 % interval, rollouts of one test resampled together.
        high: of it.
        worst: largest over the tests, of the mean at each.
    """

    mean: float
    low: float
    high: float
    worst: float


def share_closed(
    before: FloatArray, after: FloatArray, groups: NDArray[np.intp], floor: float
) -> Share | None:
    """Return the part of the gap above the floor that is closed, of (n,) differences; None for no such gap."""
    least = (1.0 - GONE) * floor
    b, a = _resample(np.abs([before, after]), groups)
    return Share.of((b - a) / np.maximum(b - floor, least + 1e-12)) if b[0] > floor + least else None


def gap(differences: FloatArray, groups: NDArray[np.intp]) -> Gap:
    """Return the mean of |differences| (n,) with an interval; ``groups`` (n,) has the number of each one's test."""
    worst = np.abs(np.bincount(groups, differences) / np.bincount(groups)).max()
    mean = Share.of(_resample(np.abs(differences)[None], groups)[0])
    return Gap(mean.estimate, mean.low, mean.high, float(worst))


def _resample(values: FloatArray, groups: NDArray[np.intp]) -> FloatArray:
    """Return (q, 1 + DRAWS) the means of (q, n) values, and those of resampled tests; of rollouts for a single test."""
    rng = np.random.default_rng(np.random.SeedSequence(0))
    units = groups if groups.any() else np.arange(groups.size)
    member = units == np.arange(units.max() + 1)[:, None]
    picks = rng.integers(len(member), size=(DRAWS, len(member)))
    draws = (values @ member.T)[:, picks].sum(axis=2) / member.sum(axis=1)[picks].sum(axis=1)
    return np.column_stack([values.mean(axis=1), draws])
