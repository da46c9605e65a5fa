"""Which set of effects predicts a test best that it was not fitted to?

Data: of T tests t of one kind of motion the observables y_tg (n_g,), in groups g of one quantity and one statistic.
Unknown: the set A of parameters that are causes, and θ (K,). Model:

    y_tg = F_tg(θ) + s_g u_tg ε_tg,   ε_tg: N_g independent N(0, 1),   s_g² ~ Inv-χ²(ν, 1)
    θ_k ~ N(0, σ_slab²) for k in A,   θ_k ~ N(0, σ_bg²) and |θ_k| ≤ 1/8 else

F is the simulator, linear around runs at the estimate. N_g here is the number M_g of :mod:`.independence`. u_tg is the
error that scatter and instruments make. s_g is one number of this machine: how far it is from the simulator's laws in
this group, in all tests. A group that no set can follow has a large s_g, for every set. An effect below an eighth is no
cause, so a set without k holds it there.

Score of a set, with θ and s_g from all tests but t:

    ℓ_t(A) = Σ_g log p(y_tg | y_−t, A),   a Student's t of N_g numbers, scale s_g u_tg, ν + Σ_{t' ≠ t} N_g degrees

Left-out tests do not show an error of the laws, which is the same in all of them. In the laws of another author, effect
j has another shape in every kind κ of group: an error of ρ θ_j J_g,jj^½, of any direction among the r_κ in which the
effects move this kind. Along a step D of sizes it adds the variance Q_D to the score, which has the variance J_D:

    Q_D = ρ² Σ_j θ_j² O_Dj²,   O_Dj² = Σ_κ (Σ_{g in κ} (J_g,DD J_g,jj)^½)²/r_κ,   J_D = Σ_g J_g,DD
    r_κ = K²/Σ_jk C_κ,jk²,   C_κ: correlations of Σ_{g in κ} J_g;   ρ² ~ Inv-χ²(ν, ρ0²)

A better set has the score S more than a worse one, D apart. S = z²/2J_D, if z ~ N(0, J_D) is the score of the worse
set along D. With errors of its laws z has the variance J_D + Q_D, so with q = Q_D/J_D this much is left of S:

    S' = −log E_ρ [(1 + q)^−½ exp(−S/(1 + q))]

θ_j are those of the worse set's causes: its laws may be wrong, and no error of a law makes an effect of none. J_g is
that of the better set, and D has what is a cause in one of them. The tail of ρ is long: no difference of scores proves
more than that the law of no effect is far off. P(A) has π for each effect of A, and all choices of its parameters are
equally probable: what makes one joint rub mostly makes all joints rub. The probability of a set is its mean weight ∝
P(A) exp Σ_t w_t ℓ'_t(A) over Bayesian bootstrap weights w of the tests, where ℓ' differ from the best set's ℓ by the
part S'/S. So a set that one test alone prefers, or that tests disagree about, is not sure. One test of another motion,
such as one with a gust, can still hide an effect: it makes s_g large in all others.

Within a set, θ has the covariance of the fit and three errors that more tests do not lower:

    Σ_A + diag(jackknife_k + σ_c² + ρ0² θ_k² + ρ0² Σ_{j ≠ k} θ_j² O_kj²/J_kk²)

The jackknife leaves out one group in all tests at a time: it grows where quantities disagree about a size, since the
machine's law is another one. σ_c and ρ0 θ_k are errors of size of another author's laws (:mod:`.hierarchical`), which
leave no residual.

Units: θ in typical sizes; s dimensionless; ℓ in nats. Shapes: T tests, G groups of all tests, K parameters.
Source: Vehtari, Gelman & Gabry, *Statistics and Computing* 27 (2017) 1413 (leave-one-out); Yao, Vehtari, Simpson &
Gelman, *Bayesian Analysis* 13 (2018) 917 (weights); Bretherton et al., *Journal of Climate* 12 (1999) 1990 (r_κ);
Efron & Tibshirani, *An Introduction to the Bootstrap* (1993), ch. 11.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.hierarchical import DEGREES, LAW_SHARE, SHARED, TINY, Groups, score_left
from s2r_spec.diagnose.inference.misfit import energies
from s2r_spec.diagnose.inference.model_search import KEPT, ModelPosterior, Set
from s2r_spec.diagnose.inference.observation import Observation
from s2r_spec.diagnose.inference.prior import UNNAMED, SizePrior

DRAWS = 2_000
"""Budget: bootstrap weights of the tests; they give a probability to 0.01."""
ROUNDS = 4
"""Budget: rounds of the fixed point of scales and sizes in a fit."""
STEPS = 6
"""Budget: most Gauss–Newton steps of a fit."""
CLOSE = 0.005
"""Tolerance: a fit ends where no size moves further, in typical sizes."""
TRIES = 5
"""Budget: rounds of :func:`bounded` that may change many variables at once, and do not help."""
PIVOTS = 1_000
"""Budget: most rounds of :func:`bounded`; random problems of 45 variables take 7."""
NEAR = 1e-9
"""Tolerance: a size this near to a bound lies on it, in typical sizes."""
FIRST = 0.7
"""Tolerance: part of the first step that is taken, since the scales still move."""


@dataclass(frozen=True)
class Tests:
    """All groups of all tests, linear around (K,) θ.

    Attributes:
        theta: the point.
        groups: of all tests.
        test, kind: (G,) number of the test and of the quantity and statistic of every group.
    """

    theta: FloatArray
    groups: Groups
    test: NDArray[np.int64]
    kind: NDArray[np.int64]

    @classmethod
    def of(cls, observations: Sequence[Observation], theta: FloatArray) -> Tests:
        """Return the groups of observations at (K,) θ; each observation is one test."""
        zero = [np.zeros(one.observed.size) for one in observations]
        groups = Groups.joined([one.groups(theta, own) for one, own in zip(observations, zero, strict=True)])
        names = [name for one in observations for name, _ in one.parts]
        numbers = {name: n for n, name in enumerate(dict.fromkeys(names))}
        test = [t for t, one in enumerate(observations) for _ in one.parts]
        return cls(theta, groups, np.array(test), np.array([numbers[name] for name in names]))

    def energy(self, step: FloatArray) -> FloatArray:
        """Return (G,) the mean square of every group after (D,) a step, in u²."""
        g = self.groups
        change = np.einsum("i,gij,j->g", step, g.gram, step, optimize=True) - 2.0 * g.moment @ step
        return np.asarray(np.maximum(g.energy + change, 0.0))

    def scales(self, used: NDArray[np.bool_], step: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (kinds,) s_g² at the mode and its degrees of freedom, from the groups that are used."""
        size = np.where(used, self.groups.size, 0.0)
        count = int(self.kind.max()) + 1
        free = np.asarray(DEGREES + np.bincount(self.kind, size, count))
        return np.asarray((DEGREES + np.bincount(self.kind, size * self.energy(step), count)) / free), free

    def step(self, used: NDArray[np.bool_], scales: FloatArray, prior: SetPrior) -> FloatArray:
        """Return (D,) the step to the most probable sizes within their bounds, from the groups that are used."""
        weight = np.where(used, self.groups.size / scales[self.kind], 0.0)
        gram, moment = np.tensordot(weight, self.groups.gram, 1), weight @ self.groups.moment
        more = moment.size - self.theta.size
        precision = np.concatenate([prior.precision, np.ones(more)])
        here = np.concatenate([self.theta, np.zeros(more)])
        free_step = np.full(more, np.inf)
        low = np.concatenate([prior.low - self.theta, -free_step])
        high = np.concatenate([prior.high - self.theta, free_step])
        return bounded(gram + np.diag(precision), moment - precision * here, low, high)

    def fitted(
        self, used: NDArray[np.bool_], prior: SetPrior, scales: FloatArray | None = None, rounds: int = ROUNDS
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (D,) the step, and (kinds,) scales and their degrees of freedom, at their joint mode."""
        scales = np.ones(int(self.kind.max()) + 1) if scales is None else scales
        for _ in range(rounds):
            step = self.step(used, scales, prior)
            scales, free = self.scales(used, step)
        return step, scales, free

    def left_out(self, prior: SetPrior, scales: FloatArray) -> FloatArray:
        """Return (T,) ℓ_t, from (kinds,) scales of all tests."""
        from scipy.special import gammaln

        found = []
        for t in range(int(self.test.max()) + 1):
            own = self.test == t
            step, s2, free = self.fitted(~own, prior, scales, 2)
            s, f = s2[self.kind[own]], free[self.kind[own]]
            n, energy = self.groups.size[own], self.energy(step)[own]
            density = gammaln((f + n) / 2.0) - gammaln(f / 2.0) - 0.5 * n * np.log(np.pi * f * s)
            density -= 0.5 * n * self.groups.volume[own] + 0.5 * (f + n) * np.log1p(n * energy / (f * s))
            found.append(float(density.sum()))
        return np.array(found)

    def information(self, scales: FloatArray) -> Information:
        """Return every group's information about the sizes, under (kinds,) scales."""
        weight = self.groups.size / scales[self.kind]
        effects = self.theta.size
        each = np.asarray(weight[:, None, None] * self.groups.gram[:, :effects, :effects])
        return Information(each, self.kind)

    def variance(self, prior: SetPrior, step: FloatArray, scales: FloatArray) -> FloatArray:
        """Return (K,) the variance of every size: of the fit, by the jackknife over groups, and by other laws."""
        effects = self.theta.size
        weight = self.groups.size / scales[self.kind]
        precision = np.tensordot(weight, self.groups.gram, 1)
        law = self.information(scales).law_variances(self.theta + step[:effects])
        precision[range(effects), range(effects)] += prior.precision
        precision[range(effects, len(precision)), range(effects, len(precision))] += 1.0
        fit = np.diag(np.linalg.inv(precision))[:effects]
        return np.asarray(fit + self.disagreement(prior, scales) + SHARED**2 + law)

    def disagreement(self, prior: SetPrior, scales: FloatArray) -> FloatArray:
        """Return (K,) the variance of every size by the jackknife over groups."""
        without = [self.step(self.kind != kind, scales, prior) for kind in range(scales.size)]
        count, sizes = len(without), np.array(without)[:, : self.theta.size]
        return np.asarray((count - 1) / count * ((sizes - sizes.mean(axis=0)) ** 2).sum(axis=0))


@dataclass(frozen=True)
class Information:
    """What the groups of all tests say about the sizes.

    Attributes:
        each: (G, K, K) information J_g.
        kind: (G,) number of the quantity and statistic of every group.
    """

    each: FloatArray
    kind: NDArray[np.int64]

    def along(self, direction: FloatArray) -> FloatArray:
        """Return (G,) J_g,DD along (K,) a step of sizes."""
        found = np.einsum("i,gij,j->g", direction, self.each, direction, optimize=True)
        return np.asarray(np.maximum(found, 0.0))

    def overlaps(self, along: FloatArray) -> FloatArray:
        """Return (K,) O_D,k² = Σ_κ (Σ_g∈κ (J_g,DD J_g,kk)^½)²/r_κ, with (G,) J_g,DD."""
        own = np.sqrt(np.maximum(np.einsum("gii->gi", self.each), 0.0)) * np.sqrt(along)[:, None]
        return np.asarray(
            sum(own[self.kind == kind].sum(axis=0) ** 2 / r for kind, r in enumerate(self.ranks))
        )

    @cached_property
    def ranks(self) -> FloatArray:
        """(kinds,) r_κ, in how many directions the effects move each kind."""
        found = []
        for kind in range(int(self.kind.max(initial=-1)) + 1):
            total = self.each[self.kind == kind].sum(axis=0)
            size = np.sqrt(np.maximum(np.diag(total), 0.0))
            seen = size > TINY * size.max(initial=0.0)
            correlations = (total / np.outer(size, size).clip(TINY))[np.ix_(seen, seen)]
            found.append(seen.sum() ** 2 / (correlations**2).sum() if seen.any() else 1.0)
        return np.array(found)

    def law_variances(self, theta: FloatArray) -> FloatArray:
        """Return (K,) the variance of every size by laws of another author, at (K,) sizes."""
        own = np.maximum(np.einsum("gii->gi", self.each), 0.0)
        others = (
            np.array([self.overlaps(each) for each in own.T])
            / np.maximum(own.sum(axis=0), TINY)[:, None] ** 2
        )
        np.fill_diagonal(others, 1.0)
        return np.asarray(LAW_SHARE**2 * others @ theta**2)


def part_left(better: Candidate, worse: Candidate) -> float:
    """Return S'/S: the part of a difference of scores of two sets that errors of the worse one's laws leave."""
    score = float((better.score - worse.score).sum())
    theta = np.zeros_like(worse.theta)
    theta[list(worse.members)] = worse.theta[list(worse.members)]
    apart = np.zeros_like(theta)
    causes = sorted({*better.members, *worse.members})
    apart[causes] = (worse.theta - better.theta)[causes]
    each = better.information.along(apart)
    if not (score > 0.0 and each.sum() > 0.0):
        return 1.0
    error = float(theta**2 @ better.information.overlaps(each)) / float(each.sum())
    return score_left(score, error) / score


@dataclass(frozen=True)
class SetPrior:
    """Prior of the sizes given a set: (K,) precision, and bounds low and high."""

    precision: FloatArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, prior: SizePrior, members: Set) -> SetPrior:
        """Return that of a set: what is no cause lies below an eighth."""
        small = (prior.probability > 0.0) & ~np.isin(np.arange(prior.low.size), members)
        low = np.where(small, np.maximum(prior.low, -UNNAMED), prior.low)
        high = np.where(small, np.minimum(prior.high, UNNAMED), prior.high)
        return cls(1.0 / prior.deviation(members) ** 2, low, high)


def bounded(precision: FloatArray, moment: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return (D,) the minimum of ½ xᵀPx − mᵀx within bounds, by block principal pivoting.

    A variable is free or at a bound. All that are in a wrong place change it at once, while their number falls. Then
    they change it one by one, which ends for every positive definite P.

    Source: Júdice & Pires, *Computers & Operations Research* 21 (1994) 587.
    """
    place, near = np.zeros(moment.size), NEAR * np.sqrt(np.diag(precision))
    fewest, left = moment.size + 1, TRIES
    for _ in range(PIVOTS):
        free = place == 0.0
        x = np.where(place < 0.0, low, np.where(place > 0.0, high, 0.0))
        rest = moment[free] - precision[np.ix_(free, ~free)] @ x[~free]
        x[free] = np.linalg.solve(precision[np.ix_(free, free)], rest)
        below, above = x < low - NEAR, x > high + NEAR
        wrong = np.where(free, below | above, place * (moment - precision @ x) < -near)
        number = int(wrong.sum())
        if not number:
            break
        fewest, left = (number, TRIES) if number < fewest else (fewest, left - 1)
        if left < 0:
            wrong = np.arange(moment.size) == np.flatnonzero(wrong)[-1]
        place = np.where(wrong, above.astype(float) - below, place)
    return np.clip(x, low, high)


@dataclass(frozen=True)
class Candidate:
    """A set, fitted around runs of the simulator at its estimate.

    Attributes:
        members: the causes.
        theta, deviation: (K,) sizes and their standard deviations.
        score: (T,) log predictive density of each test, from the others.
        energy: (G,) mean square of each group, in units of scatter and background.
        information: of each group about the sizes.
    """

    members: Set
    theta: FloatArray
    deviation: FloatArray
    score: FloatArray
    energy: FloatArray
    information: Information


def fitted(
    observations: Sequence[Observation],
    background: Sequence[FloatArray],
    start: FloatArray,
    prior: SizePrior,
    members: Set,
) -> Candidate:
    """Return the candidate of a set, from observations of tests that are corrected by runs near (K,) a start.

    ``background`` has the (n_t,) variance of every test's observables by small amounts of all effects.
    """
    own = SetPrior.of(prior, members)
    theta = np.clip(start, own.low, own.high)
    for number in range(STEPS):
        tests = Tests.of(observations, theta)
        step, *_ = tests.fitted(np.ones(tests.test.size, dtype=bool), own)
        new = np.clip(theta + step[: theta.size] * (FIRST if number == 0 else 1.0), own.low, own.high)
        moved, theta = np.abs(new - theta).max(initial=0.0), new
        if moved < CLOSE:
            break
    tests = Tests.of(observations, theta)
    energy = energies(observations, background, theta)
    step, scales, _ = tests.fitted(np.ones(tests.test.size, dtype=bool), own)
    deviation, score = np.sqrt(tests.variance(own, step, scales)), tests.left_out(own, scales)
    return Candidate(members, theta, deviation, score, energy, tests.information(scales))


def weighted(candidates: Mapping[Set, Candidate], prior: SizePrior) -> ModelPosterior:
    """Return the posterior over the candidates' sets by their predictions."""
    sets = list(candidates)
    best = max(candidates.values(), key=lambda one: float(one.score.sum()))
    each = np.array(
        [best.score + part_left(best, one) * (one.score - best.score) for one in candidates.values()]
    )
    each = each[:, np.argsort(each.sum(axis=0), kind="stable")]  # so that the order of tests changes no draw
    rng = np.random.default_rng(np.random.SeedSequence(0))
    tests = each.shape[1]
    weights = tests * rng.dirichlet(np.ones(tests), DRAWS)
    logs = weights @ each.T + [prior.log_odds(members) for members in sets]
    chance = np.exp(logs - logs.max(axis=1, keepdims=True))
    probability = (chance / chance.sum(axis=1, keepdims=True)).mean(axis=0)
    order = [n for n in np.argsort(-probability, kind="stable") if probability[n] >= KEPT * probability.max()]
    chosen = [candidates[sets[n]] for n in order]
    return ModelPosterior(
        tuple(one.members for one in chosen),
        probability[order] / probability[order].sum(),
        np.array([one.theta for one in chosen]),
        np.array([one.deviation for one in chosen]),
        prior,
        float(each.sum(axis=1).max()),
        np.stack(
            [(own.low, own.high) for own in (SetPrior.of(prior, one.members) for one in chosen)], axis=1
        ),
    )
