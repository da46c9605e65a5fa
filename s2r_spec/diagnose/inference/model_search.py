"""Posterior over sets of effects and over all sizes, in closed form from a Gaussian likelihood.

Data: a Gaussian likelihood of θ (K,), log p(y | θ) = mᵀθ − ½ θᵀLθ + const. (:mod:`.gauss_newton`). Unknown: the set A
of parameters that are causes, and θ. Model:

    θ_k | A ~ N(0, σ_slab²) for k in A, N(0, σ_bg²) else;   P(A) = Π_{k in A} π_k Π_{k not in A} (1 − π_k)

    log p(y | A) = ½ mᵀ Σ_A m + ½ log |Σ_A| − ½ log |P_A⁻¹|,   Σ_A = (L + P_A)⁻¹,   θ | y, A ~ N(Σ_A m, Σ_A)

P_A is the prior precision. A parameter whose range has one side has a half-normal prior, and its posterior is a
truncated normal. For each such parameter of A, the evidence against the empty set is multiplied by Φ(mean/deviation)
under A, and divided by that under the empty set.
Sets of up to three parameters are all scored, by low-rank updates of Σ_∅; the best ones grow while the evidence does.

A Gaussian likelihood holds near one point, so there are several, the *modes*, each for a set of causes. A set has
evidence and sizes of the mode whose causes are most like its own.

Units: θ in typical sizes. Shapes: K parameters, S sets.
Source: Mitchell & Beauchamp, *JASA* 83 (1988) 1023; Rasmussen & Williams, *Gaussian Processes*, §A.3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.hierarchical import Likelihood
from s2r_spec.diagnose.inference.prior import BACKGROUND, NAMED, SLAB, SizePrior

Set = tuple[int, ...]

ALL = 3
"""Budget: all sets of up to so many parameters are scored: 4,090 of 29 parameters. Four would be 27,841."""
GROWN = 20
"""Budget: sets that grow beyond that, the best first."""
KEPT = 1e-4
"""Tolerance: sets below this part of the best one's probability are left out of the posterior of sizes."""


@dataclass(frozen=True)
class ModelPosterior:
    """Posterior over sets, and over sizes given each.

    Attributes:
        sets: of parameters, the most probable first.
        probability: (S,) of each; they sum to 1.
        mean, deviation: (S, K) of the normal posterior of every size given the set, before it is truncated.
        prior: of the sizes.
        log_evidence: of the most probable set, up to a constant of the data.
        bounds: (2, S, K) low and high ends of every size given the set; without them those of the prior.
    """

    sets: tuple[Set, ...]
    probability: FloatArray
    mean: FloatArray
    deviation: FloatArray
    prior: SizePrior
    log_evidence: float
    bounds: FloatArray | None = None

    @property
    def ends(self) -> FloatArray:
        """(2, S, K) low and high ends of every size given the set."""
        if self.bounds is not None:
            return self.bounds
        return np.stack([np.broadcast_to(end, self.mean.shape) for end in (self.prior.low, self.prior.high)])

    def beyond(self, size: float = NAMED) -> FloatArray:
        """Return (E,) the probability that each effect has a parameter of at least this size."""
        below = self._cdf(size) - self._cdf(-size)  # (S, K)
        effects = int(self.prior.effect.max()) + 1
        within = np.ones((len(self.sets), effects))
        for k in self.prior.causes:
            within[:, self.prior.effect[k]] *= below[:, k]
        return np.asarray(1.0 - self.probability @ within)

    def quantile(self, level: float) -> FloatArray:
        """Return (K,) the quantile of every size, by bisection to 1e-4."""
        low, high = np.maximum(self.prior.low, -10.0) - 1e-6, np.minimum(self.prior.high, 10.0) + 1e-6
        for _ in range(20):
            middle = (low + high) / 2.0
            under = self.probability @ self._cdf(middle) < level
            low, high = np.where(under, middle, low), np.where(under, high, middle)
        return np.asarray((low + high) / 2.0)

    def _cdf(self, at: float | FloatArray) -> FloatArray:
        """Return (S, K) the distribution functions of the sizes, truncated to their ranges."""
        from scipy.special import ndtr

        def below(x: float | FloatArray) -> FloatArray:
            return np.asarray(ndtr((x - self.mean) / self.deviation))

        low, high = self.ends
        start, end = below(low), below(high)
        mass = np.maximum(end - start, 1e-12)
        inside = (below(np.clip(at, low, high)) - start) / mass
        at = np.broadcast_to(at, inside.shape)
        return np.where(at < low, 0.0, np.where(at >= high, 1.0, inside))


def posterior(likelihood: Likelihood, theta: FloatArray, prior: SizePrior) -> ModelPosterior:
    """Return the posterior over sets of parameters and over sizes; the likelihood around (K,) θ has no prior."""
    precision, moment = likelihood.information, likelihood.score + likelihood.information @ theta
    base = _Base(precision, moment, prior)
    scored: dict[Set, float] = {(): 0.0}
    causes = prior.causes.tolist()
    for size in range(1, min(ALL, len(causes)) + 1):
        every = list(combinations(causes, size))
        scored |= dict(zip(every, base.log_evidence(np.array(every)).tolist(), strict=True))
    best = [s for s in sorted(scored, key=lambda s: -scored[s])[:GROWN] if len(s) < len(causes)]
    while best:
        gained = set()
        for members in best:
            longer = [tuple(sorted((*members, k))) for k in causes if k not in members]
            for new, value in zip(longer, base.log_evidence(np.array(longer)).tolist(), strict=True):
                if new not in scored and value > scored[members]:
                    gained.add(new)
                scored[new] = value
        best = [s for s in sorted(gained, key=lambda s: -scored[s])[:GROWN] if len(s) < len(causes)]
    quadratic = float(likelihood.score @ theta), 0.5 * float(theta @ precision @ theta)
    constant = likelihood.value - quadratic[0] - quadratic[1] + base.constant
    return _of_probable(scored, base.sizes, prior, constant)


def _of_probable(
    scored: Mapping[Set, float],
    sizes: Callable[[Set], tuple[FloatArray, FloatArray]],
    prior: SizePrior,
    constant: float = 0.0,
) -> ModelPosterior:
    """Return the posterior over sets from the logarithm of each one's probability, without the improbable ones."""
    best = max(scored.values())
    probable = [s for s in scored if scored[s] - best >= np.log(KEPT)]
    sets = sorted(probable, key=lambda s: -scored[s])
    weight = np.exp(np.array([scored[s] for s in sets]) - best)
    mean, deviation = (np.array(each) for each in zip(*map(sizes, sets), strict=True))
    return ModelPosterior(tuple(sets), weight / weight.sum(), mean, deviation, prior, constant + best)


def nearest_mode(modes: Iterable[Set], members: Set) -> Set:
    """Return the mode with the fewest causes that differ from those of a set; the first of several."""
    return min(modes, key=lambda active: _distance(active, members))


def _distance(active: Set, members: Set) -> int:
    return len({*active} ^ {*members})


def combine(posteriors: Mapping[Set, ModelPosterior]) -> ModelPosterior:
    """Return the posterior over the sets of several modes (causes → posterior), for the same data and prior.

    Each mode has a likelihood of its own, which holds near it. So a set counts in the mode whose causes are most like
    its own. Where several are alike, it is the one in which its evidence is the largest. A set that its own mode finds
    improbable counts nowhere.
    """
    largest: dict[Set, tuple[float, ModelPosterior, int]] = {}
    for active, one in posteriors.items():
        evidence = one.log_evidence + np.log(one.probability / one.probability[0])
        for row, members in enumerate(one.sets):
            if _distance(active, members) > _distance(nearest_mode(posteriors, members), members):
                continue
            if members not in largest or evidence[row] > largest[members][0]:
                largest[members] = float(evidence[row]), one, row
    if not largest:  # every set is nearer to a mode that finds it improbable
        return max(posteriors.values(), key=lambda one: one.log_evidence)

    def sizes(members: Set) -> tuple[FloatArray, FloatArray]:
        _, one, row = largest[members]
        return one.mean[row], one.deviation[row]

    evidence = {members: value for members, (value, *_) in largest.items()}
    return _of_probable(evidence, sizes, next(iter(posteriors.values())).prior)


class _Base:
    """The posterior of the empty set, from which every other one is a low-rank update."""

    def __init__(self, precision: FloatArray, moment: FloatArray, prior: SizePrior) -> None:
        self.prior = prior
        deviation = prior.deviation()
        self.covariance = np.asarray(np.linalg.inv(precision + np.diag(1.0 / deviation**2)))
        self.mean = self.covariance @ moment
        self.constant = 0.5 * float(moment @ self.mean) + 0.5 * float(np.linalg.slogdet(self.covariance)[1])
        self.constant -= float(np.log(deviation).sum())
        self.change = 1.0 / SLAB**2 - 1.0 / BACKGROUND**2
        self.odds = np.log(np.maximum(prior.probability, 1e-300)) - np.log1p(-prior.probability)
        self.sign = np.where(prior.low > -1e-9, 1.0, -1.0)

    def log_evidence(self, sets: NDArray[np.int64]) -> FloatArray:
        """Return (S,) log p(y | A) + log P(A) of (S, n) sets of n parameters, less that of the empty set."""
        from scipy.special import log_ndtr

        size = sets.shape[1]
        covariance = self.covariance[sets[:, :, None], sets[:, None, :]]
        inner = np.eye(size) + self.change * covariance
        mean = self.mean[sets]
        solved = np.linalg.solve(inner, np.concatenate([mean[..., None], covariance], axis=2))
        gain = -0.5 * self.change * np.einsum("si,si->s", mean, solved[..., 0])
        gain -= 0.5 * np.linalg.slogdet(inner)[1]
        gain += size * np.log(BACKGROUND / SLAB) + self.odds[sets].sum(axis=1)
        # Given the set, mean and covariance of its own parameters are (1 + ΔΣ)⁻¹ times those of the empty set.
        deviation = np.sqrt(np.einsum("sii->si", solved[..., 1:]))
        before = self.mean / np.sqrt(np.diag(self.covariance))
        half = log_ndtr(self.sign[sets] * solved[..., 0] / deviation) - log_ndtr((self.sign * before)[sets])
        return np.asarray(gain + np.where(self.prior.one_sided[sets], half, 0.0).sum(axis=1))

    def sizes(self, members: Set) -> tuple[FloatArray, FloatArray]:
        """Return mean (K,) and deviation (K,) of the sizes given a set."""
        if not members:
            return self.mean, np.sqrt(np.diag(self.covariance))
        index = list(members)
        inner = np.eye(len(index)) + self.change * self.covariance[np.ix_(index, index)]
        gain = self.change * np.linalg.solve(inner, self.covariance[index]).T
        moved, shrunk = gain @ self.mean[index], gain @ self.covariance[index]
        return np.asarray(self.mean - moved), np.sqrt(np.diag(self.covariance - shrunk))
