"""Which effects could be told apart, and from which size on: by the simulator alone, at the tests that were run.

The machine says no more than how it scatters.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.evidence import ALLOWED, FORM, GROUND
from s2r_spec.diagnose.models import Surrogate

FloatArray = NDArray[np.float64]

APART = 3.0
"""Effects less than so many standard deviations apart are confounded."""
SIZES = np.geomspace(1.0, 1.0 / 32.0, 16)
"""Parts of a line's reach at which it is asked whether it could be told from everything else."""
ALIKE = (0.38, 0.43)
"""Laws that are a fifth off can meet where effects differ by less than the first part of themselves: a lag of second
order lies halfway from a delay to one of first order. From the second part on effects are of two kinds. Delay and lag,
mass and motor gain of the machines of the blind check lie below, and are exchanged as often as not
(``benchmarks/blind/kin.py``); an arm's torque constant and the mass of its forearm, which are told apart, about the
second."""


SAME = 0.02
"""Effects of which the nearest imitation leaves less than this part are one and the same to every channel."""
SEEN = 0.1
"""Standard deviations from nominal, from which on an effect has a law that another may be of one kind with."""


@dataclass(frozen=True)
class Least:
    """The values of a parameter from which on its effect differs from all that any other effect can imitate.

    Attributes:
        effect: its name.
        parameter: its name.
        unit: of the values.
        nominal: the value that does nothing.
        below: at this value and less it could be told from every other; None if at none in the bank.
        above: the same at this value and more.
    """

    effect: str
    parameter: str
    unit: str
    nominal: float
    below: float | None
    above: float | None

    def to_json(self) -> dict[str, Any]:
        """Return the fields."""
        return asdict(self)


@dataclass(frozen=True)
class Isolability:
    """Distances between effects, each at its typical size, from the nearest that the other can imitate.

    Attributes:
        effects: names.
        sigma: (K, K) in standard deviations; row: the true effect, column: what it is mistaken for.
        visible: (K,) distance of each from the nominal simulator.
        differs: (K, K) the part of the true effect that the nearest imitation leaves: no matter how little scatters.
        least: from which size on each parameter's effect is :data:`APART` from all others.
    """

    effects: tuple[str, ...]
    sigma: FloatArray
    visible: FloatArray
    differs: FloatArray
    least: tuple[Least, ...] = ()

    @property
    def kin(self) -> FloatArray:
        """Return (K, K) from 0 to 1: how far effects are of one kind, so that a law a bit off makes one the other."""
        near = np.minimum(self.differs, self.differs.T)
        found: FloatArray = np.clip((ALIKE[1] - near) / (ALIKE[1] - ALIKE[0]), 0.0, 1.0)
        found[np.diag_indices(len(found))] = 0.0
        # Of what cannot be seen at its typical size no law is known.
        seen = self.visible > SEEN
        return found * np.outer(seen, seen)

    @property
    def alike(self) -> NDArray[np.bool_]:
        """Return (K, K): which effects cannot be told apart, by these data or by any; nothing is like itself."""
        found: NDArray[np.bool_] = (np.minimum(self.sigma, self.sigma.T) < APART) | (self.kin == 1.0)
        return found & ~np.eye(len(found), dtype=np.bool_)

    def same(self, one: Collection[int], other: Collection[int]) -> bool:
        """Return whether two sets of places are told apart by nothing: one effect is exchanged for another like it."""
        mine, its = set(one) - set(other), set(other) - set(one)
        if not len(mine) == len(its) == 1:
            return False
        (a,), (b,) = mine, its
        return bool(min(self.differs[a, b], self.differs[b, a]) < SAME)

    def confounded(self, effect: str) -> tuple[str, ...]:
        """Return the effects that cannot be told from this one, itself first."""
        near = self.alike[self.effects.index(effect)]
        return (effect, *(self.effects[i] for i in np.flatnonzero(near)))

    def kinds(self, effects: Collection[str]) -> tuple[tuple[str, str], ...]:
        """Return the pairs of these that are of one kind, in catalogue order."""
        pairs = zip(*np.nonzero(np.triu(self.kin == 1.0)), strict=True)
        named = ((self.effects[a], self.effects[b]) for a, b in pairs)
        return tuple(pair for pair in named if set(pair) <= set(effects))

    def to_json(self) -> Mapping[str, object]:
        """Return names, the matrix and the least sizes."""
        return {
            "effects": list(self.effects),
            "sigma": [[round(float(v), 2) for v in row] for row in self.sigma],
            "visible": [round(float(v), 2) for v in self.visible],
            "apart": APART,
            "differs": [[round(float(v), 3) for v in row] for row in self.differs],
            "least": [one.to_json() for one in self.least],
        }


def isolability(
    surrogate: Surrogate,
    scatter: FloatArray,
    noise: FloatArray,
    nuisances: FloatArray,
    temperature: float,
) -> Isolability:
    """Return how far any two effects are apart at these tests, and from which size on each could be told.

    D²_ab = min over c_b of (μ_a − c_b μ_b)ᵀ V⁻¹ (μ_a − c_b μ_b), with scatter, the background of all other
    effects, numerics and a form error of a tenth of μ_a in V. Of several parameters of an effect the pair
    that is hardest to tell apart counts, among those of a that can be seen at all. For the least size a little of
    a itself is in V, too: no machine is without it, and it is no cause.

    Args:
        surrogate: the bank at these tests.
        scatter: (q, q) covariance of the functions' coefficients, in units of one rollout's.
        noise: (k, k) covariance of one rollout's components.
        nuisances: (v, q, k) what is no cause.
        temperature: by which evidence is divided before it is believed; distances shrink by its root.
    """
    distances = _Distances(surrogate, scatter, noise, nuisances, temperature)
    owner = distances.owner
    count = len(surrogate.catalogue.effects)
    sigma, differs = np.full((count, count), np.inf), np.ones((count, count))
    visible = np.zeros(count)
    # Of an effect that can go either way the hardest to tell counts.
    typical = [
        [distances.of(a, np.sign(end), little=False) for end in distances.ends(a)] for a in range(len(owner))
    ]
    for a, found in enumerate(typical):
        visible[owner[a]] = max(visible[owner[a]], *(own for own, _, _ in found))
    for a, found in enumerate(typical):
        for own, others, parts in found:
            if own >= 0.3 * visible[owner[a]]:
                np.minimum.at(sigma[owner[a]], owner, others)
                np.minimum.at(differs[owner[a]], owner, parts)
    sigma[np.diag_indices(count)] = differs[np.diag_indices(count)] = 0.0
    least = tuple(_least(distances, a) for a in range(len(owner)))
    return Isolability(surrogate.catalogue.effects, sigma, visible, differs, least)


class _Distances:
    """How far one parameter's effect, at a size, is from nothing and from all that each other parameter can imitate."""

    def __init__(
        self,
        surrogate: Surrogate,
        scatter: FloatArray,
        noise: FloatArray,
        nuisances: FloatArray,
        temperature: float,
    ) -> None:
        catalogue = surrogate.catalogue
        self.surrogate = surrogate
        self.temperature = temperature
        self.lines = np.flatnonzero(~catalogue.based)
        self.owner = catalogue.owner[self.lines]
        self.both = (catalogue.lower[self.lines] < 0) & (catalogue.upper[self.lines] > 0)
        self.typical = np.array(
            [surrogate.along(int(k), 1.0 if catalogue.upper[k] > 0 else -1.0).ravel() for k in self.lines]
        )
        nuisances = nuisances.reshape(len(nuisances), self.typical.shape[1])
        self.background = np.concatenate([ALLOWED * self.typical, nuisances])  # (lines + variants, q·k)
        self.floor = np.outer(np.diag(scatter), np.diag(noise)) + GROUND**2

    def ends(self, a: int) -> tuple[float, ...]:
        """Return how far the bank goes along a parameter's coordinate, on one side of nominal or on both."""
        catalogue, k = self.surrogate.catalogue, self.lines[a]
        return tuple(float(end) for end in (catalogue.lower[k], catalogue.upper[k]) if end)

    def of(self, a: int, coordinate: float, little: bool) -> tuple[float, FloatArray, FloatArray]:
        """Return the distance from nothing, and (lines,) from each other one; infinite from its own effect's.

        The last are the latter as (lines,) parts of what there is without the other. ``little`` says that a little of
        the effect itself is no cause.
        """
        mine = self.owner == self.owner[a]
        seen = self.surrogate.along(int(self.lines[a]), coordinate)
        root = 1.0 / np.sqrt((self.floor + FORM**2 * (seen**2).sum(axis=0)).ravel())
        # Woodbury: the background is of low rank.
        u, w, one = self.background * root, self.typical * root, seen.ravel() * root
        if little:
            u[a] = ALLOWED / abs(coordinate) * one  # as it acts at this size, and not at its typical one
        else:
            u[: len(mine)][mine] = 0.0
        inner = np.linalg.inv(np.eye(len(u)) + u @ u.T)
        w_u, one_u = w @ u.T, u @ one
        own = max(float(one @ one - one_u @ inner @ one_u), 0.0)
        along = w @ one - w_u @ inner @ one_u
        others = np.maximum((w**2).sum(axis=1) - ((w_u @ inner) * w_u).sum(axis=1), 1e-12)
        # An effect of one sign imitates only what pushes its way.
        along = np.where(self.both, along, np.maximum(along, 0.0))
        left = np.maximum(own - along**2 / others, 0.0)
        # Without the imitation in the background (Sherman–Morrison), or that would take its own part of the effect.
        whole = own + ALLOWED**2 * along**2 / np.maximum(1.0 - ALLOWED**2 * others, 1e-12)
        part = np.where(mine, np.inf, np.sqrt(left / np.maximum(whole, 1e-12)))
        left = np.where(mine, np.inf, left)
        return float(np.sqrt(own / self.temperature)), np.sqrt(left / self.temperature), part


def _least(distances: _Distances, a: int) -> Least:
    line = distances.surrogate.catalogue.curves[distances.lines[a]].line
    found: dict[bool, float | None] = {False: None, True: None}
    for end in distances.ends(a):
        for size in SIZES * end:
            own, others, _ = distances.of(a, float(size), little=True)
            if min(own, float(others.min())) < APART:
                break
            value = line.value(float(size))
            found[value > line.nominal] = value
    return Least(line.effect, line.parameter, line.unit, line.nominal, found[False], found[True])
