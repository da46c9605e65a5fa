"""How few rollouts could do, whatever the method."""

from __future__ import annotations

import math
from statistics import NormalDist


def sequential_lower_bound(R: float, epsilon: float, delta: float) -> float:
    """Return 2(R/ε)² kl(δ, 1−δ): no method, however clever, needs fewer rollouts on average.

    Any procedure whose interval is at most ε wide and right with probability 1 − δ
    tells a best value of 0 from one of ε at a known point; with Gaussian noise of
    standard deviation R that takes this many (Wald). It applies for ε ≤ B, where
    both are in the class.
    """
    if delta >= 0.5:
        return 0.0
    return 2 * (R / epsilon) ** 2 * (1 - 2 * delta) * math.log((1 - delta) / delta)


def minimax(R: float, epsilon: float, delta: float) -> float:
    """Return (2 z_{1−δ} R/ε)²: an interval of fixed width ε at one known point, known Gaussian noise."""
    return (2 * -NormalDist().inv_cdf(delta) * R / epsilon) ** 2
