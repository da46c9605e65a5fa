"""The kernel of E ρ over the test space, and the norm of E ρ in it, from the means of a pilot.

Data: means ȳ_i of m_i outcomes at n tests x_i. Unknown: the function J(x) = E y. Model, for one function:

    ȳ_i = J(x_i) + e_i,   e_i ~ N(0, s²/m_i),   J ~ GP(0, a k),   k of a family and of lengthscales ℓ, one an axis

The mean of J is 0, since the norm that a certificate bounds includes the level of J. Several functions share k, and
each has its own scale a. With q_a and L_a of :mod:`s2r_spec.certify.bound.confidence`, in units of s,

    ln p(ȳ | k, a) = −(L_a + q_a)/2 + const.

Estimator: ℓ and a at the maximum, for each family; ℓ lies between half of the distance of two tests, for no pilot
resolves less, and the range. A function drawn from a Gaussian process has no finite norm in the space of its own
kernel, but in that of a rougher one. So the kernel is one family rougher than the most likely one. Its ℓ is at most
``LONGEST`` times the distance of two tests: a longer one would state how smooth J is where the pilot has no test, for
the norm of a jump between two tests grows with ℓ/distance. The norm is the smallest one of a function whose squared
misfit is n or less, one for each mean. Units: ℓ in those of the axes, norm in that of the outcome.

Sources: Rasmussen & Williams (2006), section 5.4, for the marginal likelihood; Kanagawa, Hennig, Sejdinovic and
Sriperumbudur, *Gaussian processes and kernel methods* (2018), section 4, for the rougher space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.certify.bound.confidence import smallest_norm
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.space import Space

FAMILIES = ("matern32", "matern52", "rbf")
"""Definition: kernel families, the roughest first."""
LONGEST = 3.0
"""Level: largest lengthscale over the distance of neighbouring tests. ``benchmarks/certify/pilot.py`` prints B over the
norm that dense tests show, which falls with it, and the rollouts, which grow as it falls."""
LENGTHSCALES = 13
"""Budget: lengthscales that are compared on each axis, in equal ratios."""
SCALES = np.geomspace(1e-4, 1e6, 61)
"""Budget: prior scales a that are compared, over the mean square of ȳ."""
ROUNDS = 4
"""Budget: rounds over all axes until the lengthscales stay the same."""


@dataclass(frozen=True)
class Means:
    """Means of one function at the tests of a pilot.

    Attributes:
        points: (n, dim) tests.
        means: (n,)
        counts: (n,) outcomes of each mean.
        std: standard deviation of one outcome, > 0.
    """

    points: FloatArray
    means: FloatArray
    counts: FloatArray
    std: float

    def log_likelihood(self, kernel: Kernel) -> float:
        """Return the marginal likelihood's natural logarithm at the best scale a, up to a constant."""
        root, means = np.sqrt(self.counts), self.means / self.std
        gram = kernel.gram(self.points, self.points)
        eigenvalues, vectors = np.linalg.eigh(root[:, None] * gram * root)
        loads = (vectors.T @ (root * means)) ** 2
        scales = SCALES * float(np.mean(means**2))
        spread = 1 + scales[:, None] * np.clip(eigenvalues, 0, None)
        return float(-(np.log(spread) + loads / spread).sum(axis=1).min() / 2)

    def norm(self, kernel: Kernel) -> float:
        """Return the smallest norm of a function that fits the means as well as their noise allows, or |ȳ| needs."""
        gram = kernel.gram(self.points, self.points)
        least = smallest_norm(gram, self.counts, self.means / self.std, float(len(self.means)))
        return max(least * self.std, float(np.abs(self.means).max()))  # |J| ≤ ‖J‖


@dataclass(frozen=True)
class Surface:
    """The kernel of a pilot.

    Attributes:
        kernel: its family, with one lengthscale for each axis.
        likely: the most likely family.
        short: names of the axes along which J changes within the distance of two tests.
    """

    kernel: Kernel
    likely: str
    short: tuple[str, ...]


def fit_kernel(space: Space, functions: Sequence[Means], spacing: FloatArray) -> Surface:
    """Choose the kernel that the means support; ``spacing`` (dim,) is the distance of neighbouring tests."""
    widths = space.upper - space.lower
    lines = [np.geomspace(low, high, LENGTHSCALES) for low, high in zip(spacing / 2, widths, strict=True)]
    fits = {family: _best(family, functions, lines) for family in FAMILIES}
    likely = max(fits, key=lambda name: fits[name][0])
    family = FAMILIES[max(0, FAMILIES.index(likely) - 1)]
    lengthscales = tuple(np.minimum(fits[family][1], LONGEST * spacing).tolist())
    short = tuple(
        name for name, one, gap in zip(space.names, lengthscales, spacing, strict=True) if one < gap
    )
    return Surface(Kernel(family, lengthscales), likely, short)


def _best(
    family: str, functions: Sequence[Means], lines: Sequence[FloatArray]
) -> tuple[float, tuple[float, ...]]:
    """Return the largest log likelihood of a family, and its lengthscales; axis by axis, from three starts."""

    @cache
    def value(places: tuple[int, ...]) -> float:
        kernel = Kernel(family, tuple(float(line[at]) for line, at in zip(lines, places, strict=True)))
        return sum(one.log_likelihood(kernel) for one in functions)

    best: tuple[int, ...] = ()
    for start in (LENGTHSCALES // 3, LENGTHSCALES // 2, LENGTHSCALES - 1):
        places = (start,) * len(lines)
        for _ in range(ROUNDS):
            before = places
            for axis in range(len(lines)):
                each = [(*places[:axis], at, *places[axis + 1 :]) for at in range(LENGTHSCALES)]
                places = max(each, key=value)
            if places == before:
                break
        best = max(filter(None, (best, places)), key=value)
    return value(best), tuple(float(line[at]) for line, at in zip(lines, best, strict=True))
