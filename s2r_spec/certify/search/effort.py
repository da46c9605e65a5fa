"""Rollouts until a search reaches its ε, from the best design of its tests and not from simulated searches.

Data: none, for nothing has run. Known: the declaration (space, kernel, B, R, δ, ε). Unknown: the objective J, given by
its values on a grid of u points and its norm S. Units: R² = 1 and J in units of R. Model: m_j rollouts at grid
point j, real numbers ≥ 0, so that K is (u, u), M = diag(m), and the noise of a mean has variance 1/m_j. With the
notation of :mod:`s2r_spec.certify.bound.confidence`, the expected evidence of prior scale c is

    E L_c = Σ_i ln(1 + cλ_i),    E q_c = jᵀ(cK + M⁻¹)⁻¹j + u − d_c,    d_c = Σ_i cλ_i/(1 + cλ_i),

with λ_i the eigenvalues of M^½KM^½; a J of norm S that is flat on the grid has S²/c in place of the first term of q_c.
The mode turns the evidence into multipliers w_a, and w(z) = min_a w_a v_a(z) is the half-width of the band at z. The
search has ended when no test can exceed the best lower bound, at z*, by more than ε:

    w(z*) ≤ θε',    w(z) ≤ (1 − θ)ε' + J(z*) − J(z) for every z,    ε' = (1 − h)ε,

where cells may hide the share h. Estimator: the smallest Σ m_j that satisfies this, by multiplicative updates
m_j ← m_j (w(z_j) / allowed_j)^p. A box of many lengthscales is a number of equal parts whose gains of information add
up, so only one part is computed.

Sources: Silvey, Titterington and Torsney, *An algorithm for optimal designs on a design space* (1978), for the updates;
Srinivas, Krause, Kakade and Seeger (2010) for the information gain of a design.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.certify.bound.confidence import SampleEvidence
from s2r_spec.certify.bound.confidence_set import LADDER, TOLERANCE
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.modes import MODES, Mode
from s2r_spec.certify.bound.posterior import VARIANCE_ROUNDING
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.space import Space

GRID = 160
"""Budget: most grid points."""
SPACING = 2.0
"""Tolerance: grid spacing over the side of a cell that hides the share ``TOLERANCE`` of ε."""
UPDATES = 25
"""Budget: most updates of a design."""
STEP = 1.3
"""Tolerance: power of an update. 2 would be exact for independent points; neighbours share their rollouts."""
CONVERGED = 0.05
"""Tolerance: the largest excess of a half-width over its allowance, as a share, in a finished design."""
MOST = 1e80
"""Tolerance: most rollouts at a grid point. Squares of much larger numbers would overflow."""
LEAST = 1e-6
"""Tolerance: rollouts at a grid point without any."""


@dataclass(frozen=True)
class Objective:
    """A possible J on the grid, in units of R: (u,) ``values`` and how far they are below J(z*), ≥ 0.

    ``norm`` is S, for a J that is flat on the grid but has a norm; 0 if ``values`` say it all.
    """

    below: FloatArray
    values: FloatArray
    norm: float = 0.0

    @classmethod
    def flat(cls, points: int, norm: float) -> Objective:
        """Return a J of this norm that is equally large at every grid point."""
        return cls(np.zeros(points), np.zeros(points), norm)

    @classmethod
    def of(cls, values: FloatArray) -> Objective:
        """Return the J with these values at the grid points."""
        return cls(values.max() - values, values)


@dataclass(frozen=True)
class DesignRegion:
    """A box in the middle of the test space, with (u, dim) grid points and their (u, u) Gram matrix.

    ``number`` says how many such boxes the test space has (real number ≥ 1).
    """

    space: Space
    points: FloatArray
    gram: FloatArray
    number: float

    @classmethod
    def of(cls, space: Space, kernel: Kernel, relative: float) -> DesignRegion:
        """Return the part that a grid of ``GRID`` points resolves, at least a lengthscale; ``relative`` is ε/B."""
        lengthscales = kernel.lengthscales(space.dim)
        wide = (space.upper - space.lower) / lengthscales
        spacing = float((SPACING * kernel.sides_for(TOLERANCE * relative, space.dim) / lengthscales)[0])
        fits = np.minimum(wide, _longest_side(wide, spacing))
        counts = np.maximum(2, np.ceil(np.minimum(fits / spacing, GRID - 1)).astype(int) + 1)
        while counts.prod() > GRID and counts.max() > 2:
            counts[counts.argmax()] -= 1
        middle, half = (space.lower + space.upper) / 2, fits / wide * (space.upper - space.lower) / 2
        ends = zip((middle - half).tolist(), (middle + half).tolist(), strict=True)
        part = Space.of(dict(zip(space.names, ends, strict=True)))
        points = part.grid(tuple(int(count) for count in counts))
        log_number = float(np.log(wide / fits).sum())
        return cls(part, points, kernel.gram(points, points), float(np.exp(min(log_number, 600.0))))


def _longest_side(wide: FloatArray, spacing: float) -> float:
    """Return the longest side of a part whose grid has at most ``GRID`` points, or 1; all in lengthscales."""
    low, high = 0.0, float(wide.max())
    for _ in range(60):
        side = (low + high) / 2
        count = np.prod(np.ceil(np.minimum(wide, side) / spacing) + 1)
        low, high = (side, high) if count <= GRID else (low, side)
    # With many parameters the grid is coarser than it should be.
    return high if high == wide.max() else max(low, 1.0)


@dataclass(frozen=True)
class _Expected:
    eigenvalues: FloatArray
    loads: FloatArray
    cross: FloatArray
    region: DesignRegion
    objective: Objective

    @classmethod
    def of(cls, region: DesignRegion, rollouts: FloatArray, objective: Objective) -> _Expected:
        root = np.sqrt(rollouts)
        eigenvalues, vectors = np.linalg.eigh(root[:, None] * region.gram * root)
        loads = (vectors.T @ (root * objective.values)) ** 2
        cross = ((region.gram * root) @ vectors) ** 2
        return cls(np.clip(eigenvalues, 0, None), loads, cross, region, objective)

    def evidence(self, scales: FloatArray) -> SampleEvidence:
        """Return the expected evidence of all parts for (A,) scales."""
        grown = scales[:, None] * self.eigenvalues
        fit = (self.loads / (1 + grown)).sum(axis=1) + self.objective.norm**2 / scales
        noise = (1 / (1 + grown)).sum(axis=1)
        return SampleEvidence(
            self.region.number * np.log1p(grown).sum(axis=1), fit + self.region.number * noise
        )

    def deviation(self, scales: FloatArray) -> FloatArray:
        """Return (A, u) posterior standard deviations at the grid points for (A,) scales."""
        weight = 1 / (1 / scales[:, None] + self.eigenvalues)
        variance = scales[:, None] * (1 - weight @ self.cross.T)
        return np.asarray(np.sqrt(np.clip(variance, VARIANCE_ROUNDING * scales[:, None], None)))


@dataclass(frozen=True)
class Effort:
    """The declaration as the design sees it, in units of R; ``norms`` has shape (rungs,)."""

    region: DesignRegion
    mode: Mode
    norms: FloatArray
    delta: float
    epsilon: float

    @classmethod
    def of(cls, settings: SearchSettings) -> Effort:
        """Return the declaration of a search."""
        norms = np.array(LADDER) * settings.B / settings.R
        mode = MODES[settings.mode](settings.kernel, norms)
        region = DesignRegion.of(settings.space, settings.kernel, settings.epsilon / settings.B)
        return cls(region, mode, norms[:1], settings.delta, settings.epsilon / settings.R)

    def rollouts(self, objective: Objective, share: float) -> float:
        """Return the fewest rollouts of a design that reaches ε; ``share`` is θ, the share of ε below J(z*)."""
        target = (1 - TOLERANCE) * self.epsilon
        allowed = (1 - share) * target + objective.below
        best = int(objective.below.argmin())
        allowed[best] = min(allowed[best], share * target)
        design = np.full(len(allowed), 1 / max(target, MOST**-0.5) ** 2 + 1.0)
        for _ in range(UPDATES):
            data = _Expected.of(self.region, design, objective)
            total = self.region.number * float(design.sum())
            bound = self.mode.bound(data, round(total), self.norms, self.delta)
            half = np.nanmin(bound.widths[0][:, None] * data.deviation(bound.scales), axis=0)
            half = np.minimum(half, self.norms[0])  # |J| ≤ B without any rollout
            excess = half / allowed
            # Settled: the rollouts lie where the half-width is at its allowance.
            settled = design @ np.abs(excess - 1) <= CONVERGED * design.sum()
            if excess.max() <= 1 + CONVERGED and settled:
                break
            design = np.clip(design * excess**STEP, LEAST, MOST)
        return self.region.number * float(design.sum())
