"""Outcomes so far, merged: equal points are one point with more rollouts, which loses nothing."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


@dataclass(frozen=True)
class Samples:
    """(u,) distinct grid points with their number of rollouts and the sum of their outcomes."""

    at: IndexArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    counts: FloatArray = field(default_factory=lambda: np.zeros(0))
    sums: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        return len(self.at)

    @property
    def means(self) -> FloatArray:
        """(u,) mean outcomes."""
        return self.sums / self.counts

    def add(self, place: int, count: int, total: float) -> Samples:
        """Return the samples with ``count`` more outcomes at a grid point, which sum to ``total``."""
        same = self.at == place
        if same.any():
            return Samples(self.at, self.counts + count * same, self.sums + total * same)
        return Samples(
            np.append(self.at, place), np.append(self.counts, float(count)), np.append(self.sums, total)
        )
