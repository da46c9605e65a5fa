"""Which effects could be told apart at all: known from the simulator alone, before any real test."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.evidence import Design

FloatArray = NDArray[np.float64]

FORM = 0.1
"""An effect's law is believed up to this part of its signature."""
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


def isolability(design: Design) -> Isolability:
    """Return how far any two effects are apart at these tests.

    D²_ab = min over θ_b of (μ_a − μ_b)ᵀ V⁻¹ (μ_a − μ_b), with scatter, the background of all
    other effects, numerics and a form error of a tenth of μ_a in V.
    """
    c = design.candidates
    count = len(c.effects)
    sigma = np.zeros((count, count))
    visible = np.zeros(count)
    for a in range(count):
        mine = np.flatnonzero(c.effect == a)
        # The typical size, on either side of nominal and along each of its parameters: the easiest to see.
        typical = mine[np.abs(np.abs(c.coordinate[mine]) - 1.0) < 0.35]
        typical = typical if len(typical) else mine[[int(np.abs(c.coordinate[mine]).argmax())]]
        rows = []
        for place in typical:
            mu = c.mu[place]
            root = 1.0 / np.sqrt(design.spectrum + FORM**2 * float(mu @ mu) / len(mu))
            away = ((c.mu - mu) * root) ** 2
            distance = np.sqrt(np.minimum.reduceat(away.sum(axis=1), c.starts))
            nominal = float(np.sqrt(((mu * root) ** 2).sum()))
            rows.append((nominal, np.minimum(distance, nominal)))
        rows.sort(key=lambda row: row[0])
        visible[a] = rows[-1][0]
        sigma[a] = np.min([row[1] for row in rows if row[0] > 0.3 * visible[a]], axis=0)
        sigma[a, a] = 0.0
    return Isolability(c.effects, sigma, visible)
