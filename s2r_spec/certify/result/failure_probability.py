"""The failure probability at the worst test: a bound on it, and with it on a quantile of ρ.

E ρ may be positive while one rollout in ten fails. The indicator of ρ < level is 0 or 1, so its noise is
½-sub-Gaussian for every probability (Hoeffding's lemma). R is proven here and need not be declared. One
assumption remains: the probability, as a function of the test, has a bounded norm.

The rollouts may come from a search for the worst E ρ. Its tests depend only on earlier outcomes, and the
bound asks no more of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.errors import UsageError
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.search.search import Search
from s2r_spec.space import Space

R = 0.5
"""Definition: sub-Gaussian proxy of a number in [0, 1]."""
FINEST = 0.02
"""Tolerance: ε of the search, which only decides how finely the box is divided."""


@dataclass(frozen=True)
class FailureProbability:
    """The largest probability of ρ < level over the test space lies in [lower, upper].

    Attributes:
        level: the level of ρ, in the unit of ρ.
        lower: a bound at some test.
        upper: a bound at every test; so at every test the ``upper`` quantile of ρ is at least ``level``.
        seen: rollouts with ρ < level.
        rollouts: all of them.
        B: bound on the norm of the probability.
        B_low: the smallest norm compatible with the rollouts.
        worst: the test where the upper bound is largest.
        refused: the reason why there is no bound, else "".
    """

    level: float
    lower: float
    upper: float
    seen: int
    rollouts: int
    B: float
    B_low: float
    worst: dict[str, float]
    refused: str


def bound_failure_probability(
    space: Space,
    tests: Iterable[tuple[Mapping[str, float], Sequence[float]]],
    levels: Sequence[float],
    *,
    kernel: Kernel,
    B: float,
    delta: float,
) -> list[FailureProbability]:
    """Bound the probability of ρ < level for levels that were chosen before the rollouts were looked at.

    Args:
        space: the test space.
        tests: (point, (replicates,) values of ρ), every rollout that was run.
        levels: the levels of ρ, in its unit; δ is shared equally among them, so that all bounds hold at once.
        kernel: the kernel of the probability as a function of the test.
        B: bound on its norm.
        delta: all bounds together are wrong with at most this probability.

    Raises:
        UsageError: a setting is out of its range, or there is no level or no rollout.
    """
    rollouts = [(point, np.asarray(values, dtype=np.float64)) for point, values in tests]
    if not levels or not rollouts:
        raise UsageError("a bound on a probability needs a level and at least one rollout")
    bounds = []
    for level in levels:
        search = Search(space, kernel=kernel, B=B, R=R, delta=delta / len(levels), epsilon=min(FINEST, B))
        failed = [(point, (values < level).astype(np.float64)) for point, values in rollouts]
        search.observe(failed, final=True)
        certificate = search.certificate()
        bound = FailureProbability(
            level=level,
            lower=max(0.0, certificate.lower),
            upper=min(1.0, certificate.upper),
            seen=int(sum(values.sum() for _, values in failed)),
            rollouts=certificate.rollouts,
            B=B,
            B_low=certificate.B_low,
            worst=search.suggestion,
            refused=certificate.reason if certificate.label is Label.REFUSED else "",
        )
        bounds.append(bound)
    return bounds
