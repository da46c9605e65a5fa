"""Every prior number of a diagnosis that is not of one group: how large effects are, and how many there are.

    θ_k ~ (1 − π_k) N(0, σ_bg²) + π_k N(0, σ_slab²),   half-normal where the range has one side

Units: typical sizes. An effect with several parameters shares its π among them; where predictions decide, it is that of
the effect (:meth:`SizePrior.log_odds`). A *dependent* parameter, such as the place of a payload, has no spike: it is
N(0, σ_slab²), for it is no cause by itself.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray

BACKGROUND = 0.07
"""Prior: σ_bg, standard deviation of an effect that nobody added, in typical sizes. A real robot differs a little from
its model in everything: by 5 % of a large effect, which is up to 1.6 typical sizes."""
SLAB = 0.6
"""Prior: σ_slab, standard deviation of an effect that is a cause."""
ACTIVE = 0.05
"""Prior: probability π that one effect of the catalogue is a cause."""
NAMED = 0.25
"""Definition: an effect at least this large, in typical sizes, is to be named."""
UNNAMED = NAMED / 2.0
"""Definition: an effect below this size must not be named; between both either is right."""
SURE = 0.95
"""Level: posterior probability of a size of at least ``UNNAMED`` from which an effect may be named. Raising it makes
more of them *possible*."""
LIKELY = 0.5
"""Level: posterior probability of a size of at least ``NAMED`` from which an effect may be named. Raising it names
fewer effects whose size is near ``NAMED``."""
POSSIBLE = 0.05
"""Level: posterior probability from which an effect is possible; below it, it is ruled out."""


@dataclass(frozen=True)
class SizePrior:
    """Prior of all parameters.

    Attributes:
        effect: (K,) number of the effect of each parameter.
        low, high: (K,) ends of the ranges in typical sizes.
        probability: (K,) π_k; 0 for a dependent parameter.
    """

    effect: NDArray[np.int64]
    low: FloatArray
    high: FloatArray
    probability: FloatArray

    @classmethod
    def of(
        cls, effects: list[str], low: FloatArray, high: FloatArray, dependent: NDArray[np.bool_] | None = None
    ) -> SizePrior:
        """Return the prior of parameters, by the names of their effects; ``dependent`` (K,) are no cause alone."""
        names = list(dict.fromkeys(effects))
        number = np.array([names.index(name) for name in effects], dtype=np.int64)
        alone = np.ones(len(effects)) if dependent is None else 1.0 - dependent
        return cls(number, low, high, ACTIVE * alone / np.bincount(number, alone)[number])

    @property
    def causes(self) -> NDArray[np.int64]:
        """Numbers of the parameters that can be a cause."""
        return np.flatnonzero(self.probability > 0.0)

    def effects(self, members: Iterable[int]) -> dict[int, tuple[int, ...]]:
        """Return effect → its parameters of a set."""
        found: dict[int, tuple[int, ...]] = {}
        for k in members:
            found[int(self.effect[k])] = (*found.get(int(self.effect[k]), ()), k)
        return found

    def log_odds(self, members: tuple[int, ...]) -> float:
        """Return log P(A)/P(∅) of a set, in which all choices of an effect's parameters are equally probable.

        What makes one joint rub mostly makes all joints rub.
        """
        found = 0.0
        for effect in self.effects(members):
            choices = 2.0 ** int((self.probability[self.effect == effect] > 0.0).sum()) - 1.0
            found += np.log(ACTIVE / (1.0 - ACTIVE) / choices)
        return float(found)

    def deviation(self, active: tuple[int, ...] = ()) -> FloatArray:
        """Return (K,) the standard deviation of every size, where these parameters are the causes."""
        wide = (self.probability == 0.0) | np.isin(np.arange(self.low.size), active)
        return np.where(wide, SLAB, BACKGROUND)

    @property
    def one_sided(self) -> NDArray[np.bool_]:
        """(K,) whether the range begins or ends at nominal."""
        return np.asarray((self.low > -1e-9) | (self.high < 1e-9))
