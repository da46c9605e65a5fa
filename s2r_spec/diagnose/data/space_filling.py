"""Tests that represent a space of tests. Coordinates are parts of each parameter's range."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from s2r_spec.diagnose.simulator.bench import Test
from s2r_spec.space import Space

TESTS = 10
"""Budget: recorded tests whose runs give sizes. More of them lower the scatter, but not the errors of the simulator's
laws, which are larger."""


def spread(space: Space, count: int, seed: int) -> list[dict[str, float]]:
    """Return tests that fill the space: the first points of a scrambled Sobol sequence.

    A space without parameters has one test, which returns ``count`` times.
    """
    from scipy.stats import qmc

    points = np.zeros((count, 0))
    if space.dim:
        power = max(count - 1, 1).bit_length()
        points = qmc.Sobol(space.dim, scramble=True, rng=seed).random_base2(power)[:count]
    return [space.point(point) for point in space.at(points)]


def star(space: Space) -> list[dict[str, float]]:
    """Return the middle of the space, and both ends of each parameter with the others in the middle."""
    unit = 0.5 + 0.5 * np.concatenate([np.zeros((1, space.dim)), np.eye(space.dim), -np.eye(space.dim)])
    return [space.point(point) for point in space.at(unit)]


def representative(tests: Iterable[Test], space: Space, most: int = TESTS) -> list[dict[str, float]]:
    """Return the tests that the library simulates: the first one in the middle, then each as far away as possible.

    This is greedy k-centre (Gonzalez, 1985): no test is more than twice as far from these as with the best choice. The
    order of the tests changes nothing.
    """
    places = {tuple(space.vector(test).tolist()): dict(test) for test in tests}
    keys = sorted(places)
    points = np.array(keys).reshape(len(keys), space.dim)
    unit = (points - space.lower) / (space.upper - space.lower)
    chosen: list[int] = []
    distance = -np.linalg.norm(unit - 0.5, axis=1)
    while len(chosen) < min(most, len(keys)):
        chosen.append(int(np.argmax(distance)))
        apart = np.linalg.norm(unit - unit[chosen[-1]], axis=1)
        distance = apart if len(chosen) == 1 else np.minimum(distance, apart)
    return [places[keys[place]] for place in chosen]
