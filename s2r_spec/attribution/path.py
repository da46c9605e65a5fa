"""The straight path from a simulated to a real trace, and the part of Δρ that each sample adds along it.

Data: samples x_sim and x_real of both traces, (channels, n). Quantity: the part a(t, c) of Δρ of sample t of channel c,
the integrated gradient

    a(t, c) = ∫₀¹ ∂ρ/∂x_{t,c}(x_λ) · (x_real − x_sim)_{t,c} dλ,     x_λ = (1 − λ) x_sim + λ x_real.

ρ consists of minima and maxima of margins. So the path has pieces on which one predicate at one sample decides, and ρ
changes there by as much as the margin of that predicate. Pieces end where two margins cross. Therefore the parts add up
to Δρ up to rounding.

Booleans change at λ = ½. A jump of ρ there, or at the change of a sign or a count, has no gradient. It is divided among
the channels in proportion to the jump of ρ when each of them changes alone.

Units: a in the unit of ρ, λ dimensionless. Source: Aumann and Shapley, *Values of Non-Atomic Games*, 1974;
Sundararajan, Taly and Yan, "Axiomatic Attribution for Deep Networks", ICML 2017.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from s2r_spec.attribution.align import Aligned, Evaluated
from s2r_spec.attribution.gradient import margin_gradient
from s2r_spec.base.arrays import FloatArray
from s2r_spec.lang import formula as f
from s2r_spec.robustness.deciding import DescentStep, descend

_PIECES = 4
"""Budget: least number of pieces, because a minimum of maxima can return to a predicate."""
_NARROW = 1e-9
"""Tolerance: a change of ρ over less than this part of the path is a jump."""
_EXACT = 1e-11
"""Tolerance: relative difference of two computations of one number."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)
_NODES, _WEIGHTS = 0.5 + _NODES / 2, _WEIGHTS / 2
"""Definition: nodes and weights of Gauss's rule on [0, 1], exact for polynomials of degree 11."""


@dataclass(frozen=True, eq=False)
class PathPiece:
    """A part of the path on which one predicate decides.

    Attributes:
        steps: from the requirement down to the predicate.
        amount: the change of ρ.
        credit: signal → (width, n) parts of the change, which add up to ``amount``.
    """

    steps: tuple[DescentStep, ...]
    amount: float
    credit: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class _Point:
    """ρ at a point of the path, and the steps to the predicate that decides it; ``late`` if booleans are real."""

    at: float
    late: bool
    algebra: Evaluated
    steps: tuple[DescentStep, ...]
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

    def pieces(self) -> Iterator[PathPiece]:
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

    def _algebra(self, at: float, late: bool) -> Evaluated:
        if (at, late) not in self._algebras:
            pair = self.pair
            signals = {
                name: (pair.real[name] if late else other)
                if name in pair.flags
                else (1.0 - at) * other + at * pair.real[name]
                for name, other in pair.simulated.items()
            }
            self._algebras[at, late] = pair.algebra(signals)
        return self._algebras[at, late]

    def _point(self, at: float, late: bool) -> _Point:
        if (at, late) not in self._points:
            algebra = self._algebra(at, late)
            rho = float(np.broadcast_to(algebra.walk(self.pair.formula), self.pair.times.shape)[0])
            steps = tuple(descend(self.pair.formula, algebra.walk, self.pair.clock))
            self._points[at, late] = _Point(at, late, algebra, steps, rho)
        return self._points[at, late]

    def value(self, step: DescentStep, algebra: Evaluated) -> float:
        """Return factor · margin of a predicate at its sample."""
        assert isinstance(step.node, f.Comparison)
        margin = np.broadcast_to(algebra.walk(step.node), self.pair.times.shape)
        return step.factor * float(margin[step.sample])

    def _between(self, a: _Point, b: _Point, halved: bool = False) -> Iterator[PathPiece]:
        """Yield the pieces from one point to another; ``halved`` if the last cut at a crossing left more than half.

        The crossings of curved predicates may come ever nearer to one end, so every second cut is at the middle.
        """
        middle = self._point((a.at + b.at) / 2, a.late)
        if not (isinstance(middle.steps[-1].node, f.Comparison) and np.isfinite(middle.rho)):
            return  # ρ is infinite on the way, so its change is no number
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
        """Return where the margins that decide at both ends cross, or else the middle."""
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

    def _one(self, steps: tuple[DescentStep, ...], a: _Point, b: _Point) -> Iterator[PathPiece]:
        """Yield a piece on which one predicate decides, halved until the gradient agrees with the change."""
        step = steps[-1]
        amount = self.value(step, b.algebra) - self.value(step, a.algebra)
        credit: dict[str, FloatArray] = {}
        nodes, weights = (_NODES, _WEIGHTS) if _is_curved(step.node) else (np.array([0.5]), np.array([1.0]))
        for at, weight in zip((a.at + (b.at - a.at) * nodes).tolist(), weights.tolist(), strict=True):
            assert isinstance(step.node, f.Comparison)
            gradient = margin_gradient(step.node, self._algebra(at, a.late).numbers, step.sample)
            for name, slope in gradient.items():
                way = step.factor * weight * (b.at - a.at) * slope
                credit[name] = credit.get(name, 0.0) + way * (
                    self.pair.real[name] - self.pair.simulated[name]
                )
        credited = sum(float(part.sum()) for part in credit.values())
        size = sum(float(np.abs(part).sum()) for part in credit.values())
        if abs(credited - amount) <= _EXACT * max(1.0, size, abs(a.rho), abs(b.rho)):
            yield PathPiece(steps, amount, credit)
        elif b.at - a.at <= _NARROW:
            yield from self._jump(a, b)
        else:
            middle = self._point((a.at + b.at) / 2, a.late)
            yield from self._one(steps, a, middle)
            yield from self._one(steps, middle, b)

    def _jump(self, a: _Point, b: _Point) -> Iterator[PathPiece]:
        """Yield the jump of ρ, divided among the channels by the jump that each makes alone."""
        amount = b.rho - a.rho
        steps = b.steps if isinstance(b.steps[-1].node, f.Comparison) else a.steps
        if amount == 0.0 or not np.isfinite(amount):
            return
        before, after = a.algebra.numbers.signals, b.algebra.numbers.signals
        changed = [name for name in before if not np.array_equal(before[name], after[name])]
        alone = np.array([abs(self.pair.rho({**before, name: after[name]}) - a.rho) for name in changed])
        alone = np.where(np.isfinite(alone), alone, 0.0)
        shares = alone / alone.sum() if alone.sum() else np.full(len(changed), 1.0 / max(1, len(changed)))
        credit = {}
        for name, share in zip(changed, shares.tolist(), strict=True):
            differs = (before[name] != after[name]).astype(float)
            near = np.zeros_like(differs)
            # the changed sample nearest to the one that decides ρ
            rows, columns = np.nonzero(differs)
            nearest = np.argmin(np.abs(columns - steps[-1].sample))
            near[rows[nearest], columns[nearest]] = share * amount
            credit[name] = near
        yield PathPiece(steps, amount, credit)


def _is_curved(node: f.Node) -> bool:
    """Return whether a number is no piecewise linear function of the signals."""
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
    return bends or any(map(_is_curved, f.children(node)))


def _varies(node: f.Node) -> bool:
    return any(isinstance(part, f.SignalValue) for part in f.walk(node))
