"""Which effects could be told apart at all: known from the simulator alone, before any real test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.evidence import ALLOWED, FORM, GROUND
from s2r_spec.diagnose.models import Surrogate

FloatArray = NDArray[np.float64]

APART = 3.0
"""Effects less than so many standard deviations apart are confounded."""


@dataclass(frozen=True)
class Isolability:
    """Distances between effects, each at its typical size, from the nearest that the other can imitate.

    Attributes:
        effects: names.
        sigma: (K, K) in standard deviations; row: the true effect, column: what it is mistaken for.
        visible: (K,) distance of each from the nominal simulator.
    """

    effects: tuple[str, ...]
    sigma: FloatArray
    visible: FloatArray

    def confounded(self, effect: str) -> tuple[str, ...]:
        """Return the effects that cannot be told from this one, itself first."""
        k = self.effects.index(effect)
        near = np.minimum(self.sigma[k], self.sigma[:, k]) < APART
        return (effect, *(name for i, name in enumerate(self.effects) if near[i] and i != k))

    def to_json(self) -> Mapping[str, object]:
        """Return names and the matrix."""
        return {
            "effects": list(self.effects),
            "sigma": [[round(float(v), 2) for v in row] for row in self.sigma],
            "visible": [round(float(v), 2) for v in self.visible],
            "apart": APART,
        }


def isolability(
    surrogate: Surrogate,
    scatter: FloatArray,
    noise: FloatArray,
    nuisances: FloatArray,
    temperature: float,
) -> Isolability:
    """Return how far any two effects are apart at these tests.

    D²_ab = min over c_b of (μ_a − c_b μ_b)ᵀ V⁻¹ (μ_a − c_b μ_b), with scatter, the background of all other
    effects, numerics and a form error of a tenth of μ_a in V. Of several parameters of an effect the pair
    that is hardest to tell apart counts, among those of a that can be seen at all.

    Args:
        surrogate: the bank at these tests.
        scatter: (q, q) covariance of the functions' coefficients, in units of one rollout's.
        noise: (k, k) covariance of one rollout's components.
        nuisances: (v, q, k) what is no cause.
        temperature: by which evidence is divided before it is believed; distances shrink by its root.
    """
    catalogue = surrogate.catalogue
    lines = np.flatnonzero(~catalogue.based)
    typical = [surrogate.secant(int(k), 1.0 if catalogue.upper[k] > 0 else -1.0) for k in lines]
    columns = np.array([t.ravel() for t in typical])
    owner = catalogue.owner[lines]
    both = (catalogue.lower[lines] < 0) & (catalogue.upper[lines] > 0)
    count = len(catalogue.effects)
    sigma = np.full((count, count), np.inf)
    visible = np.zeros(count)
    apart: list[tuple[int, float, FloatArray]] = []
    for a in range(len(columns)):
        v = (
            np.outer(np.diag(scatter), np.diag(noise)) + FORM**2 * (typical[a] ** 2).sum(axis=0) + GROUND**2
        ).ravel()
        back = ALLOWED * columns[owner != owner[a]]
        back = np.concatenate([back, nuisances.reshape(len(nuisances), columns.shape[1])])
        # Woodbury: the background is of low rank.
        u = back / np.sqrt(v)
        inner = np.linalg.inv(np.eye(len(u)) + u @ u.T)
        w = columns / np.sqrt(v)
        gram = w @ w.T - (w @ u.T) @ inner @ (u @ w.T)
        own = max(float(gram[a, a]), 0.0)
        others = np.maximum(np.diag(gram), 1e-12)
        # Two effects of one sign each are alike only if they push the same way.
        along = np.where(both | both[a], gram[a], np.maximum(gram[a], 0.0))
        left = np.maximum(own - along**2 / others, 0.0)
        apart.append((int(owner[a]), own, left))
        visible[owner[a]] = max(visible[owner[a]], np.sqrt(own))
    for a, own, left in apart:
        if np.sqrt(own) >= 0.3 * visible[a]:
            nearest = np.full(count, np.inf)
            np.minimum.at(nearest, owner, left)
            sigma[a] = np.minimum(sigma[a], np.sqrt(nearest))
    sigma[np.diag_indices(count)] = 0.0
    return Isolability(catalogue.effects, sigma / np.sqrt(temperature), visible / np.sqrt(temperature))
