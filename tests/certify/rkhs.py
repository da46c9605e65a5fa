"""Random functions of an exact RKHS norm: finite sums of kernel sections."""

from __future__ import annotations

import numpy as np

from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.search.search import Search
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


def near_zero(
    kernel: Kernel, space: Space, norm: float, most: float, rng: np.random.Generator
) -> RandomFunction:
    """Return a random function of this norm over an interval, whose maximum is near 0: at most about ``most`` away."""
    function, knots = RandomFunction(kernel, space, 1.0, rng), space.grid((25,))
    level = np.linalg.solve(kernel.gram(knots, knots) + 1e-8 * np.eye(25), np.ones(25))  # of a constant 1
    shift = function(space.grid((501,))).max() - rng.uniform(-most, most) / norm
    function.centres = np.concatenate([function.centres, knots])
    function.weights = np.concatenate([function.weights, -shift * level])
    gram = kernel.gram(function.centres, function.centres)
    function.weights *= norm / np.sqrt(function.weights @ gram @ function.weights)
    return function
