"""Outcomes of a search so far. Equal points are merged into one point with more rollouts, which loses nothing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.base.magnitude import LARGEST
from s2r_spec.certify.bound import confidence

IndexArray = NDArray[np.intp]


@dataclass(frozen=True)
class OutcomeSamples:
    """(u,) distinct points with their number of rollouts and the sum of their outcomes."""

    at: IndexArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    counts: FloatArray = field(default_factory=lambda: np.zeros(0))
    sums: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        return len(self.at)

    @property
    def means(self) -> FloatArray:
        """(u,) mean outcomes."""
        return self.sums / self.counts

    def add(self, place: int, count: int, total: float) -> OutcomeSamples:
        """Return the samples with ``count`` more outcomes at a point, which sum to ``total``."""
        same = self.at == place
        if same.any():
            return OutcomeSamples(self.at, self.counts + count * same, self.sums + total * same)
        return OutcomeSamples(
            np.append(self.at, place), np.append(self.counts, float(count)), np.append(self.sums, total)
        )


@dataclass(frozen=True)
class Outcomes:
    """All outcomes in units of R, with the statistics of the test of R.

    Attributes:
        samples: the outcomes by point.
        rollouts: number of outcomes.
        scatter: sum of squared deviations of replicates from the mean of their query, in units of R².
        degrees: replicates beyond the first of each query, the degrees of freedom of ``scatter``.
        log_e: natural logarithm of the largest e-value against R so far.
        history: (scatter, degrees) after each query.
    """

    samples: OutcomeSamples = field(default_factory=OutcomeSamples)
    rollouts: int = 0
    scatter: float = 0.0
    degrees: int = 0
    log_e: float = 0.0
    history: tuple[tuple[float, int], ...] = ()

    def add(self, place: int, values: FloatArray) -> Outcomes:
        """Return the outcomes with (replicates,) more values at a point."""
        scatter = self.scatter + float(((values - values.mean()) ** 2).sum())
        degrees = self.degrees + len(values) - 1
        return replace(
            self,
            samples=self.samples.add(place, len(values), float(values.sum())),
            rollouts=self.rollouts + len(values),
            scatter=scatter,
            degrees=degrees,
            log_e=max(self.log_e, confidence.noise_e_value(scatter, degrees)),
            history=(*self.history, (scatter, degrees)),
        )


def as_outcomes(outcomes: ArrayLike, what: str) -> FloatArray:
    """Return (replicates,) outcomes of a query or test as float64; a number is an array of one.

    Raises:
        UsageError: they are not a list of finite numbers, or have less precision than float64.
    """
    if getattr(outcomes, "dtype", None) in (np.float32, np.float16):
        raise UsageError(
            f"the outcomes of {what} are {np.asarray(outcomes).dtype}: a certificate needs float64"
        )
    try:
        array = np.asarray(outcomes)
    except Exception as error:  # rows of different lengths, or an array on a device
        raise UsageError(f"the outcomes of {what} are not a list of numbers: {error}") from None
    if array.dtype.kind not in "biuf":
        raise UsageError(f"the outcomes of {what} are {outcomes!r:.60}; they must be a list of numbers")
    values = np.atleast_1d(array.astype(np.float64))
    if values.ndim != 1:
        raise UsageError(f"the outcomes of {what} have shape {values.shape}; they must be a list of numbers")
    if not np.isfinite(values).all():
        raise UsageError(
            f"outcome {int(np.argmin(np.isfinite(values)))} of {what} is not a finite number; "
            f"a fall or a crash must be given the value that was declared for it"
        )
    if (np.abs(values) > LARGEST).any():
        raise UsageError(f"an outcome of {what} is beyond {LARGEST:g}, which double precision cannot square")
    return values
