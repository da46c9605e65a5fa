"""Ratios and means over groups of one kind: one quantity and one statistic, in all experiments of one kind of motion.

A variance of a few runs is known badly. In N_g independent numbers of every group, and in all tests, it is known well:

    f = (ν + Σ_t m_t N_g q) / (ν + Σ_t m_t N_g),    q = Σ_t m_t N_g v_t / Σ_t m_t N_g w_t

v_t and w_t are means over a group of two variances, and m_t the degrees of freedom of the first in one number. A ratio
of sums has no bias where w_t is estimated, too, as a mean of ratios has.

Shapes: n_p observables of experiment p.
Source: Gelman et al., *Bayesian Data Analysis*, 3rd ed., §2.6 (ν).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.hierarchical import DEGREES
from s2r_spec.diagnose.inference.observation import Observation


@dataclass(frozen=True)
class Kinds:
    """The groups of several experiments, by kind.

    Attributes:
        kind, test, size: (G,) number of the kind, number of the experiment, and N_g of every group.
        places: of the observables of every group, in its experiment.
        shape: n_p of every experiment.
    """

    kind: NDArray[np.int64]
    test: NDArray[np.int64]
    size: FloatArray
    places: tuple[NDArray[np.int64], ...]
    shape: tuple[int, ...]

    @classmethod
    def of(cls, observations: Sequence[Observation]) -> Kinds:
        """Return those of observations; each is one experiment."""
        names = [(one.response.experiment.protocol, name) for one in observations for name, _ in one.parts]
        numbers = {name: n for n, name in enumerate(dict.fromkeys(names))}
        return cls(
            np.array([numbers[name] for name in names], dtype=np.int64),
            np.array([t for t, one in enumerate(observations) for _ in one.parts], dtype=np.int64),
            np.concatenate([*(one.effective for one in observations), np.zeros(0)]),
            tuple(places for one in observations for _, places in one.parts),
            tuple(one.observed.size for one in observations),
        )

    def ratios(
        self, above: Sequence[FloatArray], below: Sequence[FloatArray], free: Sequence[float]
    ) -> list[FloatArray]:
        """Return (n_p,) f of the kind of every observable, from (n_p,) two variances; those that are NaN do not count.

        ``free`` has the degrees of freedom of the first, in every experiment.
        """
        number = self.size * np.asarray(free, dtype=float)[self.test]
        v, w = (self._group_means(own, above) for own in (above, below))
        number = np.where(np.isfinite(v), number, 0.0)
        v, w = (self._sums(number * np.nan_to_num(x)) for x in (v, w))
        free_of = self._sums(number)
        ratio = np.divide(v, w, out=np.ones_like(v), where=w > 0.0)
        return self._spread((DEGREES + free_of * ratio) / (DEGREES + free_of))

    def means(self, values: Sequence[FloatArray]) -> list[FloatArray]:
        """Return (n_p,) the mean over the kind of every observable, from (n_p,) values."""
        each = self._group_means(values, values)
        return self._spread(self._sums(self.size * each) / self._sums(self.size))

    def _group_means(self, values: Sequence[FloatArray], known: Sequence[FloatArray]) -> FloatArray:
        """Return (G,) means over the numbers of a group that are known; NaN for none."""
        found = []
        for t, places in zip(self.test.tolist(), self.places, strict=True):
            own, there = values[t][places], np.isfinite(known[t][places])
            found.append(float(own[there].mean()) if there.any() else np.nan)
        return np.array(found)

    def _sums(self, each: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self.kind, each), dtype=float)

    def _spread(self, by_kind: FloatArray) -> list[FloatArray]:
        found = [np.ones(n) for n in self.shape]
        for t, kind, places in zip(self.test.tolist(), self.kind.tolist(), self.places, strict=True):
            found[t][places] = by_kind[kind]
        return found
