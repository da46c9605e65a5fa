"""Sample complexity: the fewest rollouts that any method needs for an interval of a given width."""

from __future__ import annotations

import math
from statistics import NormalDist


def sequential_lower_bound(R: float, epsilon: float, delta: float) -> float:
    """Return 2(R/ε)² kl(δ, 1−δ), the fewest rollouts that any method needs on average.

    A method whose interval is at most ε wide, and right with probability 1 − δ, distinguishes a best value of 0 from
    one of ε at a known point. With Gaussian noise of standard deviation R no test needs fewer rollouts (Wald). The
    bound applies for ε ≤ B, where both functions are in the class.
    """
    if delta >= 0.5:
        return 0.0
    return 2 * (R / epsilon) ** 2 * (1 - 2 * delta) * math.log((1 - delta) / delta)


def minimax(R: float, epsilon: float, delta: float) -> float:
    """Return (2 z_{1−δ} R/ε)², the rollouts for an interval of width ε at one known point with Gaussian noise."""
    return (2 * -NormalDist().inv_cdf(delta) * R / epsilon) ** 2
