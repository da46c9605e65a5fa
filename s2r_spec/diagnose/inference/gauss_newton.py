"""Joint estimate of all effects: a search over the points of the library, then Gauss–Newton steps.

Data and the shape u of their error: :mod:`.observation`. Unknown: θ (K,) in typical sizes. Model and likelihood:
:mod:`.hierarchical`. Prior in the fit: θ_k ~ N(0, σ_slab²) within its range. Around a mode it is N(0, σ_bg²) for
parameters that are not its causes.

Since u depends on θ, it is fixed within a Gauss–Newton step (a quasi-likelihood; McCullagh & Nelder, *Generalized
Linear Models*, ch. 9). Two first estimates are compared under the larger of their u, and modes under its posterior
mean. Gauss–Newton goes on from the first estimate (:mod:`.search`), with the variances of all groups at their mode at
every step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.hierarchical import (
    ROUNDS,
    Groups,
    Likelihood,
    Variances,
    form_error,
    form_ratio,
    shared_error,
)
from s2r_spec.diagnose.inference.observation import Problem
from s2r_spec.diagnose.inference.prior import SLAB
from s2r_spec.diagnose.inference.search import search

STEPS = 12
"""Budget: most Gauss–Newton steps of a fit."""
CLOSE = 0.002
"""Tolerance: the fit ends when no parameter moves further, in typical sizes."""
FIRST = 0.7
"""Tolerance: part of the first two steps that is taken, since the variances still move."""


@dataclass(frozen=True)
class Errors:
    """Errors of the model in a fit. They grow with the sizes of effects, and are fixed within a fit.

    An estimate that lowered its own error by being small would be drawn to 0.

    Attributes:
        variances: (n_p,) of the responses in u, for every experiment. Fits whose evidence is compared have the same.
        sizes: (K,) at which the law errors are.
    """

    variances: Sequence[FloatArray]
    sizes: FloatArray

    @classmethod
    def at(cls, problem: Problem, theta: FloatArray, deviation: FloatArray | None = None) -> Errors:
        """Return the errors at (K,) sizes ± deviations."""
        return cls(problem.errors(theta, deviation), np.abs(theta))


@dataclass(frozen=True)
class Fit:
    """The estimate under one prior.

    Attributes:
        theta: (K,) estimate of every parameter.
        errors: of the model.
        groupwise: likelihood of θ around the estimate, by secants, with the errors of each group alone.
        groups, variances: of all experiments, in their order, at the estimate.
        kinds: of motion, of each of these groups: "" for a test of the specification, or the protocol.
    """

    theta: FloatArray
    errors: Errors
    groupwise: Likelihood
    groups: Groups
    kinds: tuple[str, ...]
    variances: Variances

    @cached_property
    def likelihood(self) -> Likelihood:
        """The likelihood of θ around the estimate, with all errors; the prior is not in it."""
        own, sizes = self.groupwise, self.errors.sizes
        form = form_error(sizes, self._by_group, self.kinds, own.information)
        return own.with_form_error(form).with_shared_error(self.shared)

    def form_ratio(self, difference: FloatArray) -> float:
        """Return Q_D/J_D at ρ = 1, of two predictions with (G,) this mean squared difference in each group, in u."""
        apart = self.groups.size / self.variances.noise * difference
        return form_ratio(apart, self.errors.sizes, self._by_group, self.kinds)

    @cached_property
    def _by_group(self) -> FloatArray:
        """(G, K, K) information of every group, with its own law error."""
        return self.groups.information(self.errors.sizes, self.variances)

    @cached_property
    def shared(self) -> FloatArray:
        """(K,) variance of the error of size that all groups share."""
        sizes = self.errors.sizes
        return shared_error(sizes, self.groups.disagreement(sizes, self.variances))


def fit(
    problem: Problem,
    start: FloatArray | None = None,
    deviation: FloatArray | None = None,
    errors: Errors | None = None,
) -> Fit:
    """Return the joint estimate.

    Args:
        problem: data and prior.
        start: (K,) first estimate; the search finds one without it.
        deviation: (K,) prior standard deviation of every size in the fit; without it, that of a cause.
        errors: of the model; without them, those at the start, of law at the larger of the start and ``deviation``.
    """
    observations, prior = problem.observations, problem.prior
    effects = prior.low.size
    deviation = np.full(effects, SLAB) if deviation is None else deviation
    theta = search(problem) if start is None else np.clip(start, prior.low, prior.high)
    if errors is None:
        wide = np.maximum(np.abs(theta), deviation)
        errors = Errors(problem.errors(theta), wide)
    components = Variances.prior(sum(len(one.parts) for one in observations))
    groups = _group(problem, theta, errors)
    for step in range(STEPS):
        components = groups.variances(errors.sizes, components, 2 if step == 0 else 1)
        total = groups.likelihood(errors.sizes, components)
        moved = _step(total, theta, deviation) * (FIRST if step < 2 else 1.0)
        new = np.clip(theta + moved, prior.low, prior.high)
        if np.abs(new - theta).max(initial=0.0) < CLOSE:
            break
        theta = new
        groups = _group(problem, theta, errors)
    # The evidence of two fits can be compared only where their variances have settled.
    components = groups.variances(errors.sizes, components, ROUNDS)
    secants = _group(problem, theta, errors, secants=True).likelihood(errors.sizes, components)
    kinds = tuple(one.response.experiment.protocol for one in observations for _ in one.parts)
    return Fit(theta, errors, secants.without_variants(effects), groups, kinds, components)


def _group(problem: Problem, theta: FloatArray, errors: Errors, secants: bool = False) -> Groups:
    pairs = zip(problem.observations, errors.variances, strict=True)
    return Groups.joined([one.groups(theta, own, secants) for one, own in pairs])


def _step(total: Likelihood, theta: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return (K,) the Gauss–Newton step of θ; the variants' amounts start from 0 at every step."""
    effects = theta.size
    precision = np.ones(len(total.score))
    precision[:effects] = 1.0 / deviation**2
    gradient = total.score.copy()
    gradient[:effects] -= theta / deviation**2
    return np.asarray(np.linalg.solve(total.information + np.diag(precision), gradient)[:effects])
