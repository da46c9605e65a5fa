"""Cases made from the bank, from which the networks and the detector of unknown causes learn.

A case is one, two or three effects of random size, or none, with what a real
machine adds: laws of another form, a little of every other effect, numerics that
differ, more scatter than the simulator has. No real data and no label enter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import BACKGROUND
from s2r_spec.diagnose.layout import Layout
from s2r_spec.diagnose.signatures import Curve, Signatures

FloatArray = NDArray[np.float64]

KINDS = {0: 0.1, 1: 0.45, 2: 0.33, 3: 0.12}
"""Number of effects → how often."""
FORM = 0.15
"""Form error of an effect's signature, as a part of it."""
SMALLEST = 0.15
"""Effects are drawn log-uniformly from this part of their typical size to the end of their range."""
GROUNDS = (0.1, 4.0)
"""Error of everything, log-uniform between these, in units of the features' scale: some simulators are
nearly right, and of others every number is a little off."""
CHANNELS = 3
"""Channels, at most, that are simply not what the simulator says; in half of the cases none is."""
OFF = (0.5, 8.0)
"""By how much, log-uniform, in units of the features' scale."""
OTHERS = 4
"""Signatures of other effects that are mixed into the form error of one."""


@dataclass(frozen=True)
class Case:
    """One practice case.

    Attributes:
        coefficients: (q, k) of the functions of the test.
        effects: places of the effects in the list of effects.
        alone: (q, k) what they do, without background, numerics and scatter.
    """

    coefficients: FloatArray
    effects: tuple[int, ...]
    alone: FloatArray


class Practice:
    """Draws cases from one bank."""

    def __init__(self, signatures: Signatures) -> None:
        self._curves = signatures.curves
        self._numerics = signatures.numerics
        self.effects = tuple(dict.fromkeys(c.line.effect for c in signatures.curves))
        self._lines = [
            [i for i, c in enumerate(signatures.curves) if c.line.effect == name] for name in self.effects
        ]
        self._root = np.linalg.cholesky(signatures.noise + 1e-9 * np.eye(signatures.size))
        sides = [[s for s in (-1, 1) if (c.coordinates * s > 0).any()] for c in signatures.curves]
        self._sides = sides
        self._ends = [
            {s: float((c.coordinates * s).max()) for s in of}
            for c, of in zip(self._curves, sides, strict=True)
        ]
        # (lines, 2, m, k): change per unit of coordinate, near nominal, below and above.
        self._slopes = np.stack([_slopes(c) for c in signatures.curves])
        self._knots = [_knots(c) for c in signatures.curves]
        self._interactions = self._typical_interactions(signatures)
        self._axes = signatures.axes
        self._channels = _by_channel(signatures)

    def draw(self, rng: np.random.Generator, layout: Layout, stranger: bool = False) -> Case:
        """Draw one case; a ``stranger`` is an effect that no line has."""
        m, k = self._curves[0].change.shape[1:]
        trend = np.linspace(-1.0, 1.0, m)
        if stranger:
            chosen: list[int] = []
            total = self._strange(rng, trend)
        else:
            count = min(int(rng.choice(list(KINDS), p=list(KINDS.values()))), len(self.effects))
            chosen = sorted(int(i) for i in rng.choice(len(self.effects), size=count, replace=False))
            total = np.zeros((m, k))
            sizes: dict[int, float] = {}
            for effect in chosen:
                whole, sizes[effect] = self._whole(rng, effect, trend)
                total += self._altered(rng, whole, trend)
            for place, a in enumerate(chosen):
                for b in chosen[place + 1 :]:
                    if (a, b) in self._interactions:
                        total += (
                            min(sizes[a] * sizes[b], 1.5) * rng.uniform(0.5, 1.2) * self._interactions[a, b]
                        )
        alone = layout.through @ total
        for change in self._numerics:
            total = total + rng.normal() * change
        ground = GROUNDS[0] * (GROUNDS[1] / GROUNDS[0]) ** rng.random()
        total = total + self._background(rng) + ground * rng.normal(size=(1, k))
        total = total + self._doubtful(rng) * (1.0 + 0.3 * rng.normal() * trend[:, None])
        spread = layout.root * np.sqrt(rng.uniform(1.0, 3.0))
        scatter = spread @ rng.normal(size=(len(spread), k)) @ self._root.T
        return Case(layout.through @ total + scatter, tuple(chosen), alone)

    def _doubtful(self, rng: np.random.Generator) -> FloatArray:
        """Return (1, k): a few channels that are off, some kinds of statistics of them together."""
        total = np.zeros(self._axes.shape[1])
        for _ in range(int(rng.integers(CHANNELS + 1)) if rng.random() < 0.5 else 0):
            size = OFF[0] * (OFF[1] / OFF[0]) ** rng.random()
            for columns in self._channels[int(rng.integers(len(self._channels)))]:
                if rng.random() < 0.5:
                    total[columns] += 0.7 * size * (rng.normal() + rng.normal(size=len(columns)))
        found: FloatArray = (self._axes @ total)[None]
        return found

    def _background(self, rng: np.random.Generator) -> FloatArray:
        """Return (m, k): a little of everything."""
        amount = BACKGROUND * rng.uniform(0.5, 3.0) * rng.normal(size=len(self._curves))
        total: FloatArray = np.zeros(self._slopes.shape[2:])
        for i, a in enumerate(amount):
            if self._curves[i].line.base:
                continue
            side = int(np.sign(a)) if int(np.sign(a)) in self._sides[i] else self._sides[i][0]
            total += abs(a) * side * self._slopes[i, (side + 1) // 2]
        return total

    def _whole(self, rng: np.random.Generator, effect: int, trend: FloatArray) -> tuple[FloatArray, float]:
        """Return (m, k) of an effect at random values, and how large it is."""
        mine = self._lines[effect]
        free = [i for i in mine if not self._curves[i].line.base]
        most, total = 0.0, np.zeros_like(self._slopes[0, 0])
        for i in self._some(rng, free):
            coordinate = self._coordinate(rng, i)
            wandering = 1.0 + 0.5 * FORM * rng.normal() + 0.5 * FORM * rng.normal() * trend
            total = total + change_at(self._knots[i], coordinate * wandering)
            most = max(most, coordinate, key=abs)
        for i in mine:
            if self._curves[i].line.base:
                side = int(rng.choice(self._sides[i]))
                turned = side * self._ends[i][side] * float(rng.random())
                total = total + most * change_at(self._knots[i], np.full(len(trend), turned))
        return total, abs(most)

    @staticmethod
    def _some(rng: np.random.Generator, mine: list[int]) -> list[int]:
        """Return one line of an effect, or sometimes all of them."""
        if len(mine) == 1 or rng.random() < 0.6:
            return [int(rng.choice(mine))]
        return mine

    def _coordinate(self, rng: np.random.Generator, line: int) -> float:
        side = int(rng.choice(self._sides[line]))
        end = self._ends[line][side]
        return side * SMALLEST * (end / SMALLEST) ** float(rng.random()) if end > SMALLEST else side * end

    def _altered(self, rng: np.random.Generator, change: FloatArray, trend: FloatArray) -> FloatArray:
        """Return (m, k): an effect as a machine would have it, of much the same but not the same law."""
        strength = FORM * rng.uniform(0.3, 1.5)
        # The error is in what the effect touches, and a little in what others touch.
        own = change * (1.0 + strength * rng.normal(size=(1, change.shape[1])))
        return own + 0.5 * strength * _length(change) * self._mixture(rng, OTHERS, trend)

    def _mixture(self, rng: np.random.Generator, count: int, trend: FloatArray) -> FloatArray:
        """Return (m, k) of about unit length: random signatures and a random direction."""
        m, k = self._curves[0].change.shape[1:]
        total = (
            rng.normal(size=(1, k)) / np.sqrt(k) + 0.5 * rng.normal(size=(1, k)) / np.sqrt(k) * trend[:, None]
        )
        for i in rng.choice(len(self._curves), size=min(count, len(self._curves)), replace=False):
            other = self._curves[i].change[int(rng.integers(len(self._curves[i].coordinates)))]
            total = total + 0.5 * rng.normal() * other / max(_length(other), 1e-9)
        return np.broadcast_to(total, (m, k))

    def _strange(self, rng: np.random.Generator, trend: FloatArray) -> FloatArray:
        """Return (m, k): a signature that is torn from several, each component by itself."""
        like, _ = self._whole(rng, int(rng.integers(len(self.effects))), trend)
        size = _length(like)
        mixed = self._mixture(rng, 6, trend) * (
            1.0 + 0.7 * rng.normal(size=(1, self._curves[0].change.shape[2]))
        )
        return size * mixed / max(_length(mixed), 1e-9)

    def _typical_interactions(self, signatures: Signatures) -> dict[tuple[int, int], FloatArray]:
        """Return pair of effects → (m, k) of what two typical ones do beyond the sum."""
        bank = signatures.bank
        out = {}
        for (i, j), block in zip(bank.pairs, signatures.interactions, strict=True):
            a, b = (self.effects.index(bank.lines[x].effect) for x in (i, j))
            nearest = np.abs(np.arange(len(bank.tests))[:, None] - np.array(bank.pair_tests)).argmin(axis=1)
            out[min(a, b), max(a, b)] = block[nearest]
        return out


def _by_channel(signatures: Signatures) -> list[list[NDArray[np.intp]]]:
    """Return, for every channel, the kept columns of each kind of statistic."""
    names = [f for f, kept in zip(signatures.bank.features.names(), signatures.kept[1:], strict=True) if kept]
    shift = int(signatures.kept[0])
    found: dict[str, dict[str, list[int]]] = {}
    for column, name in enumerate(names):
        found.setdefault(name.block, {}).setdefault(name.statistic, []).append(column + shift)
    return [[np.array(c, dtype=np.intp) for c in kinds.values()] for kinds in found.values()]


def _length(change: FloatArray) -> float:
    return float(np.sqrt((change**2).sum(axis=1).mean()))


def _knots(curve: Curve) -> tuple[FloatArray, FloatArray]:
    at = np.append(curve.coordinates, 0.0)
    values = np.concatenate([curve.change, np.zeros_like(curve.change[:1])])
    order = np.argsort(at)
    return at[order], values[order]


def _slopes(curve: Curve) -> FloatArray:
    out = np.zeros((2, *curve.change.shape[1:]))
    for place, side in enumerate((-1, 1)):
        mine = np.flatnonzero(curve.coordinates * side > 0)
        if len(mine):
            near = mine[np.abs(curve.coordinates[mine]).argmin()]
            out[place] = curve.change[near] / curve.coordinates[near]
    return out


def change_at(knots: tuple[FloatArray, FloatArray], coordinate: FloatArray) -> FloatArray:
    """Return (m, k) change of a line at coordinates (m,), by linear interpolation with 0 at nominal."""
    at, values = knots
    high = np.clip(np.searchsorted(at, coordinate), 1, len(at) - 1)
    part = np.clip((coordinate - at[high - 1]) / (at[high] - at[high - 1]), 0.0, 1.0)[:, None]
    tests = np.arange(values.shape[1])
    found: FloatArray = values[high - 1, tests] * (1.0 - part) + values[high, tests] * part
    return found
