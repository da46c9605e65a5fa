"""Random functions of an exact RKHS norm: finite sums of kernel sections."""

from __future__ import annotations

import numpy as np

from s2r_spec.certify.kernels import Kernel
from s2r_spec.certify.search import Search
from s2r_spec.space import Space


class RandomFunction:
    """J = Σ a_j k(·, x_j) with ‖J‖² = aᵀKa = norm²."""

    def __init__(
        self, kernel: Kernel, space: Space, norm: float, rng: np.random.Generator, sections: int = 12
    ):
        self.kernel = kernel
        self.centres = rng.uniform(space.lower, space.upper, (sections, space.dim))
        weights = rng.normal(size=sections)
        gram = kernel.gram(self.centres, self.centres)
        self.weights = weights * norm / np.sqrt(weights @ gram @ weights)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return self.kernel.gram(np.atleast_2d(points), self.centres) @ self.weights


def run(search: Search, function: RandomFunction, noise: float, rng: np.random.Generator) -> None:
    """Answer the search's questions until it is done."""
    while not search.done:
        for query in search.ask():
            mean = function(search.space.vector(query.point))[0]
            search.tell(query, mean + noise * rng.normal(size=query.replicates))
