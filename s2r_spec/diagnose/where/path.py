"""ρ along the straight path from a simulated to a real trace, and what every sample adds on the way.

    a(t, c) = ∫₀¹ ∂ρ/∂x_{t,c}(x_λ) · (x_real − x_sim)_{t,c} dλ,     x_λ = (1 − λ) x_sim + λ x_real

(Aumann and Shapley, *Values of Non-Atomic Games*, 1974; Sundararajan et al., Axiomatic
Attribution for Deep Networks, 2017). ρ is a minimum and maximum of margins, so
that the path falls into pieces on each of which one predicate at one sample decides;
ρ's change over a piece is that margin's. Pieces are found by where the margins cross,
so that the parts add up to Δρ to rounding, not to the width of a step.

Booleans change half way. What ρ jumps by there, or where a sign or a count changes, has
no gradient; it is given to the channels that make it jump when they change alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.where.align import Aligned, Evaluated
from s2r_spec.diagnose.where.gradient import margin_gradient
from s2r_spec.lang import formula as f
from s2r_spec.robustness.deciding import Step, descend

FloatArray = NDArray[np.float64]

_PIECES = 4
"""The path is looked at in so many parts at least: a minimum of maxima can return to a predicate."""
_NARROW = 1e-9
"""A change of ρ over less of the path than this is a jump."""
_EXACT = 1e-11
"""Agreement of two ways to the same number, relative to what they are made of."""
_NODES, _WEIGHTS = (
    0.5 + np.polynomial.legendre.leggauss(6)[0] / 2,
    np.polynomial.legendre.leggauss(6)[1] / 2,
)


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of the path on which one predicate decides.

    Attributes:
        steps: from the requirement down to the predicate.
        amount: what ρ changes by.
        credit: signal → (width, n), which add up to ``amount``.
        jump: whether ρ jumps here.
    """

    steps: tuple[Step, ...]
    amount: float
    credit: Mapping[str, FloatArray]
    jump: bool = False


@dataclass(frozen=True, eq=False)
class _Point:
    """ρ at a point of the path, and what decides it there; ``late`` if booleans are the real ones."""

    at: float
    late: bool
    algebra: Evaluated
    steps: tuple[Step, ...]
    rho: float


@dataclass(eq=False)
class Path:
    """The straight path between two aligned traces."""

    pair: Aligned
    _points: dict[tuple[float, bool], _Point] = field(default_factory=dict)
    _algebras: dict[tuple[float, bool], Evaluated] = field(default_factory=dict)

    @property
    def start(self) -> _Point:
        """The simulated trace."""
        return self._point(0.0, late=False)

    @property
    def end(self) -> _Point:
        """The real trace."""
        return self._point(1.0, late=True)

    def pieces(self) -> Iterator[Piece]:
        """Yield the pieces in order; none if ρ is infinite at an end or where booleans change."""
        before, after = self._point(0.5, late=False), self._point(0.5, late=True)
        if not all(np.isfinite(point.rho) for point in (self.start, before, after, self.end)):
            return
        for late in (False, True):
            edges = np.linspace(0.5 * late, 0.5 + 0.5 * late, _PIECES // 2 + 1).tolist()
            for a, b in pairwise(self._point(edge, late) for edge in edges):
                yield from self._between(a, b)
            if not late:
                yield from self._jump(before, after)

    def _signals(self, at: float, late: bool) -> dict[str, FloatArray]:
        pair = self.pair
        return {
            name: (pair.real[name] if late else other)
            if name in pair.flags
            else (1.0 - at) * other + at * pair.real[name]
            for name, other in pair.simulated.items()
        }

    def _algebra(self, at: float, late: bool) -> Evaluated:
        if (at, late) not in self._algebras:
            self._algebras[at, late] = self.pair.algebra(self._signals(at, late))
        return self._algebras[at, late]

    def _point(self, at: float, late: bool) -> _Point:
        if (at, late) not in self._points:
            algebra = self._algebra(at, late)
            rho = float(np.broadcast_to(algebra.walk(self.pair.formula), self.pair.times.shape)[0])
            steps = tuple(descend(self.pair.formula, algebra.walk, self.pair.clock))
            self._points[at, late] = _Point(at, late, algebra, steps, rho)
        return self._points[at, late]

    def value(self, step: Step, algebra: Evaluated) -> float:
        """Return factor · margin of a predicate at its sample."""
        assert isinstance(step.node, f.Comparison)
        margin = np.broadcast_to(algebra.walk(step.node), self.pair.times.shape)
        return step.factor * float(margin[step.sample])

    def _between(self, a: _Point, b: _Point, halved: bool = False) -> Iterator[Piece]:
        """Yield the pieces from one point to another; ``halved`` if a crossing has just cut off less than half.

        Of curved predicates straight lines may cross ever nearer to one end, so two cuts always halve the way.
        """
        middle = self._point((a.at + b.at) / 2, a.late)
        if not (isinstance(middle.steps[-1].node, f.Comparison) and np.isfinite(middle.rho)):
            return  # ρ is infinite on the way: what it does there is no number
        slack = _EXACT * max(1.0, abs(a.rho), abs(b.rho))
        step = middle.steps[-1]
        ends = [self.value(step, point.algebra) for point in (a, b)]
        if abs(ends[0] - a.rho) <= slack and abs(ends[1] - b.rho) <= slack:
            yield from self._one(middle.steps, a, b)
        elif b.at - a.at <= _NARROW:
            yield from self._jump(a, b)
        else:
            split = middle if halved else self._point(self._crossing(a, middle, b), a.late)
            for left, right in ((a, split), (split, b)):
                yield from self._between(left, right, right.at - left.at > (b.at - a.at) / 2)

    def _crossing(self, a: _Point, middle: _Point, b: _Point) -> float:
        """Return where what decides at one end and what decides at the other are alike, or else the middle."""
        for left, right in ((a, b), (a, middle), (middle, b)):
            if not all(isinstance(point.steps[-1].node, f.Comparison) for point in (left, right)):
                continue
            ahead = [
                self.value(left.steps[-1], point.algebra) - self.value(right.steps[-1], point.algebra)
                for point in (left, right)
            ]
            if ahead[0] == ahead[1]:
                continue
            part = ahead[0] / (ahead[0] - ahead[1])
            at = left.at + part * (right.at - left.at)
            if 1e-6 < part < 1.0 - 1e-6 and abs(at - middle.at) > 1e-6 * (b.at - a.at):
                return at
        return middle.at

    def _one(self, steps: tuple[Step, ...], a: _Point, b: _Point) -> Iterator[Piece]:
        """Yield the piece on which one predicate decides, halved until its gradient accounts for its change."""
        step = steps[-1]
        amount = self.value(step, b.algebra) - self.value(step, a.algebra)
        credit: dict[str, FloatArray] = {}
        nodes, weights = (_NODES, _WEIGHTS) if _curved(step.node) else (np.array([0.5]), np.array([1.0]))
        for at, weight in zip((a.at + (b.at - a.at) * nodes).tolist(), weights.tolist(), strict=True):
            assert isinstance(step.node, f.Comparison)
            gradient = margin_gradient(step.node, self._algebra(at, a.late).numbers, step.sample)
            for name, slope in gradient.items():
                way = step.factor * weight * (b.at - a.at) * slope
                credit[name] = credit.get(name, 0.0) + way * (
                    self.pair.real[name] - self.pair.simulated[name]
                )
        found = sum(float(part.sum()) for part in credit.values())
        size = sum(float(np.abs(part).sum()) for part in credit.values())
        if abs(found - amount) <= _EXACT * max(1.0, size, abs(a.rho), abs(b.rho)):
            yield Piece(steps, amount, credit)
        elif b.at - a.at <= _NARROW:
            yield from self._jump(a, b)
        else:
            middle = self._point((a.at + b.at) / 2, a.late)
            yield from self._one(steps, a, middle)
            yield from self._one(steps, middle, b)

    def _jump(self, a: _Point, b: _Point) -> Iterator[Piece]:
        """Yield what ρ changes by where it has no gradient, by channel: each changed alone."""
        amount = b.rho - a.rho
        steps = b.steps if isinstance(b.steps[-1].node, f.Comparison) else a.steps
        if amount == 0.0 or not np.isfinite(amount):
            return
        before, after = a.algebra.samples.signals, b.algebra.samples.signals
        changed = [name for name in before if not np.array_equal(before[name], after[name])]
        alone = np.array([abs(self.pair.rho({**before, name: after[name]}) - a.rho) for name in changed])
        alone = np.where(np.isfinite(alone), alone, 0.0)
        shares = alone / alone.sum() if alone.sum() else np.full(len(changed), 1.0 / max(1, len(changed)))
        credit = {}
        for name, share in zip(changed, shares.tolist(), strict=True):
            differs = (before[name] != after[name]).astype(float)
            near = np.zeros_like(differs)
            # of the samples that changed, the one nearest to where the verdict is decided
            rows, columns = np.nonzero(differs)
            nearest = np.argmin(np.abs(columns - steps[-1].sample))
            near[rows[nearest], columns[nearest]] = share * amount
            credit[name] = near
        yield Piece(steps, amount, credit, jump=True)


def _curved(node: f.Node) -> bool:
    """Return whether a number may change otherwise than on straight pieces when signals do."""
    match node:
        case f.Norm():
            return True
        case f.Elementary(function="sqrt") | f.Arithmetic(operator="^"):
            bends = _varies(node)
        case f.Arithmetic(operator="*"):
            bends = _varies(node.left) and _varies(node.right)
        case f.Arithmetic(operator="/"):
            bends = _varies(node.right)
        case _:
            bends = False
    return bends or any(map(_curved, f.children(node)))


def _varies(node: f.Node) -> bool:
    return any(isinstance(part, f.SignalValue) for part in f.walk(node))
