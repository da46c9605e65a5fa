"""How much of the difference between a machine and its simulator a set of effects leaves.

Data: for every group g of all experiments the mean squares of its residuals, E_g(0) of the nominal simulator and E_g of
the simulator with the set, each averaged over experiments of one kind of motion. Their unit is scatter, instruments and
small amounts of all effects. With effects of another author's laws, the part ρ0 of every response is in it, too.

    shown = Σ_g N_g max(log max(E_g(0), 1) − λ(N_g), 0) / Σ_g N_g
    left = Σ_g N_g log max(E_g, 1) / Σ_g N_g log max(E_g(0), 1)

N_g is the number of independent observables of a group in all experiments, and λ(n) is what scatter alone gives on
average: the mean of log max(χ²_n/n, 1). Innovations do not count: they show the law of a machine's noise, too. A
set is rejected by the size of what it leaves, not by a p-value: no real machine has exactly the laws of its simulator,
so with enough data every p-value is small.

Units: dimensionless. Shapes: G groups of all experiments, K parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_types import Count
from s2r_spec.base.json_values import Shown
from s2r_spec.diagnose.inference.hierarchical import LAW_SHARE
from s2r_spec.diagnose.inference.observation import Observation

QUARTER = 0.25
"""Level: part of the misfit that is left, from which on a set is rejected."""
SHOWS = 0.3
"""Level: mean logarithm of mean squares from which on a misfit shows: with less, what a set leaves is scatter. Chosen
on machines of `benchmarks/blind/development.py`, which are therefore validation."""


@dataclass(frozen=True)
class Misfit(Shown):
    """How much the most probable set leaves, at its sizes from all experiments.

    Attributes:
        experiments: number of experiments, tests and protocols.
        shown: misfit of the nominal simulator beyond scatter and background: mean logarithm of the mean squares.
        left: part of this misfit that the most probable set leaves.
    """

    experiments: Count
    shown: float
    left: float

    JSON = "experiments shown left rejected"

    @classmethod
    def of(cls, observations: Sequence[Observation], nominal: FloatArray, best: FloatArray) -> Misfit:
        """Return it from (G,) mean squares of the groups of all observations."""
        names = [(one.response.experiment.protocol, name) for one in observations for name, _ in one.parts]
        size = np.concatenate([one.effective for one in observations])
        motion = [name for name in dict.fromkeys(names) if name[1][1] != "innovation"]
        each = [np.array([own == name for own in names]) for name in motion]
        before, after = ([float(one[own].mean()) for own in each] for one in (nominal, best))
        number = np.array([size[own].sum() for own in each])
        chance = np.array([by_chance(float(n)) for n in number])
        logs, rest = (np.log(np.maximum(one, 1.0)) for one in (before, after))
        shown = float(number @ np.maximum(logs - chance, 0.0)) / max(float(number.sum()), 1.0)
        misfit = float(number @ logs)
        return cls(len(observations), shown, float(number @ rest) / misfit if misfit else 0.0)

    @property
    def rejected(self) -> bool:
        """Whether a misfit shows, and the set leaves more than a quarter of it."""
        return self.shown >= SHOWS and self.left > QUARTER


@lru_cache(1_000)
def by_chance(degrees: float) -> float:
    """Return λ, the mean of log max(χ²_n/n, 1) with n degrees of freedom: the integral of P(log χ²_n/n > x)."""
    from scipy.integrate import quad
    from scipy.stats import chi2

    return float(quad(lambda x: chi2.sf(degrees * np.exp(x), degrees), 0.0, 10.0)[0])


def energies(
    observations: Sequence[Observation], background: Sequence[FloatArray], theta: FloatArray
) -> FloatArray:
    """Return (G,) the mean square that (K,) sizes leave in each group, in units of scatter, background and laws.

    Laws of another author may leave the part ρ0 of every response, wherever in its group.
    """
    found = []
    for one, small in zip(observations, background, strict=True):
        square = one.residual(theta) ** 2
        law = LAW_SHARE**2 * one.squares(theta)
        known = one.noise + small
        found += [float((square[own] / (known[own] + law[own].mean())).mean()) for _, own in one.parts]
    return np.array(found)
