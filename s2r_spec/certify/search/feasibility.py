"""Searches that would be refused whatever their rollouts show: this is known before the first one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from s2r_spec.certify.bound.coverage import MOST_ROLLOUTS, long_axes
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.rounding import at_least, at_most
from s2r_spec.certify.bound.sample_complexity import sequential_lower_bound
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.bound.tiling import MOST_POINTS
from s2r_spec.space import Space


@dataclass(frozen=True)
class Obstacles:
    """Why no certificate is possible, each in one sentence; "" if there is no such reason.

    Attributes:
        constant: the declaration alone says that a parameter has no effect; this refuses recordings, too.
        too_many: the search would take more tests or rollouts than there can be.
    """

    constant: str
    too_many: str

    @classmethod
    def of(cls, settings: SearchSettings) -> Obstacles:
        """Return the obstacles of a declared search."""
        fewest = sequential_lower_bound(settings.R, settings.epsilon, settings.delta)
        too_many = _too_many_tests(settings)
        if settings.budget is None and fewest > MOST_ROLLOUTS:
            enough = at_most(settings.epsilon * math.sqrt(fewest / MOST_ROLLOUTS))
            too_many = (
                f"epsilon = {settings.epsilon:g} takes at least {fewest:.0e} rollouts for R = {settings.R:g}, by "
                f"any method; declare an epsilon of at least {enough}, or give a budget"
            )
        return cls(_constant(settings), too_many)

    @property
    def any(self) -> str:
        """The first reason why no certificate is possible; "" if none applies."""
        return self.constant or self.too_many


def tests_apart(space: Space, kernel: Kernel) -> float:
    """Return the number of tests that fit in the box one lengthscale apart; a certificate needs about as many."""
    cells = np.maximum(1.0, (space.upper - space.lower) / kernel.lengthscales(space.dim))
    return float(10 ** min(300.0, np.log10(cells).sum()))


def log_rollouts(tests: float, spread: int, batch: float) -> float:
    """Return log10 of the rollouts that a search has run when it has visited this many tests.

    A batch holds ``spread`` tests and 2 · spread rollouts, or the share ``batch`` of all so far if that is more.
    """
    batches = max(1.0, tests / spread)
    even = min(batches, 1 / batch)
    return math.log10(2 * spread * even) + (batches - even) * math.log10(1 + batch)


def _constant(settings: SearchSettings) -> str:
    """Return a sentence if kernel and B leave the outcome no room to change by ε along a parameter, else ""."""
    space, kernel, B = settings.space, settings.kernel, settings.B
    change = B * kernel.change(space.upper - space.lower)
    for axis in long_axes(space, kernel):
        if change[axis] <= settings.epsilon:
            name, unit = space.axes[axis].name, space.axes[axis].unit
            length = kernel.lengthscales(space.dim)[axis]
            times = at_most(length / space.axes[axis].width)
            return (
                f"the lengthscale of {name} is {length:g} {unit}".rstrip()
                + f", {times} times its range; B = {B:g} then lets {name} change the outcome by at most "
                f"{at_most(change[axis])}, and epsilon is {settings.epsilon:g}; check the unit of the lengthscale, or "
                f"declare a smaller epsilon or a lengthscale below {at_least(length * change[axis] / settings.epsilon)}"
            )
    return ""


def _too_many_tests(settings: SearchSettings) -> str:
    """Return a sentence if a certificate takes more tests than s2r holds, or their rollouts are too many, else ""."""
    space, kernel = settings.space, settings.kernel
    tests = tests_apart(space, kernel)
    if tests > MOST_POINTS:
        limit = f"s2r holds {MOST_POINTS:,}"
    elif settings.budget is None and log_rollouts(tests, settings.spread, settings.batch) > math.log10(
        MOST_ROLLOUTS
    ):
        limit = f"that would take more than {MOST_ROLLOUTS:.0e} rollouts"
    else:
        return ""
    cells = (space.upper - space.lower) / kernel.lengthscales(space.dim)
    axis = space.axes[int(cells.argmax())]
    length = kernel.lengthscales(space.dim)[cells.argmax()]
    about = f"{float(f'{tests:.1g}'):,.0f}" if tests < 1e12 else f"{tests:.0e}"
    return (
        f"the lengthscale of {axis.name} is {length:g} {axis.unit}".rstrip()
        + f", and its range {cells.max():.3g} times that: about {about} tests are needed, one lengthscale apart, "
        f"and {limit}; check the unit of the lengthscale"
    )
