"""Robustness that is known only within bounds: a signal was silent, or has several values at one instant.

Data: a walk over an algebra (:mod:`s2r_spec.robustness.evaluate`), and for each predicate a lower and an upper margin.
They differ where the margin is not known: −inf and +inf where one of its signals has no valid value, and the least and
the greatest where a signal has several values with one stamp.

Unknown: ρ. Model: every operator is monotone in each of its margins, and negation turns them around. So the bounds of a
formula follow from the bounds of its predicates, and contain ρ for every value of what is not known. They need not be
tight, because predicates count as independent. The online monitor has the same model (docs/reference/language.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from s2r_spec.lang import formula as f
from s2r_spec.robustness.evaluate import Algebra

S = TypeVar("S")


class WithEdges(Algebra[S], Protocol[S]):
    """An algebra whose edges may be of two signals."""

    def edge(self, now: S, before: S) -> S:
        """Return min(now, −before just before)."""
        ...


@dataclass(frozen=True)
class Bounds(Generic[S]):
    """The bounds of a robustness signal at every instant."""

    lower: S
    upper: S


@dataclass(frozen=True)
class BoundedAlgebra(Generic[S]):
    """Robustness signals with bounds.

    Args:
        inner: the algebra of each bound.
        leaf: predicate, or use of a boolean signal → the bounds of its margin.
    """

    inner: WithEdges[S]
    leaf: Callable[[f.Comparison | f.Flag], Bounds[S]]

    def truth(self, value: bool) -> Bounds[S]:
        """Return +inf or −inf."""
        known = self.inner.truth(value)
        return Bounds(known, known)

    def flag(self, node: f.Flag) -> Bounds[S]:
        """Return the bounds of a boolean signal."""
        return self.leaf(node)

    def margin(self, node: f.Comparison) -> Bounds[S]:
        """Return the bounds of a predicate."""
        return self.leaf(node)

    def negative(self, x: Bounds[S]) -> Bounds[S]:
        """Return −x."""
        return Bounds(self.inner.negative(x.upper), self.inner.negative(x.lower))

    def scaled(self, x: Bounds[S], factor: float) -> Bounds[S]:
        """Return factor · x, factor > 0."""
        return Bounds(self.inner.scaled(x.lower, factor), self.inner.scaled(x.upper, factor))

    def least(self, x: Bounds[S], y: Bounds[S]) -> Bounds[S]:
        """Return the smaller of both."""
        return Bounds(self.inner.least(x.lower, y.lower), self.inner.least(x.upper, y.upper))

    def greatest(self, x: Bounds[S], y: Bounds[S]) -> Bounds[S]:
        """Return the greater of both."""
        return Bounds(self.inner.greatest(x.lower, y.lower), self.inner.greatest(x.upper, y.upper))

    def always(self, x: Bounds[S], interval: f.Interval, past: bool) -> Bounds[S]:
        """Return the infimum over the window."""
        return Bounds(self.inner.always(x.lower, interval, past), self.inner.always(x.upper, interval, past))

    def eventually(self, x: Bounds[S], interval: f.Interval, past: bool) -> Bounds[S]:
        """Return the supremum over the window."""
        return Bounds(
            self.inner.eventually(x.lower, interval, past), self.inner.eventually(x.upper, interval, past)
        )

    def until(self, left: Bounds[S], right: Bounds[S], interval: f.Interval, past: bool) -> Bounds[S]:
        """Return the robustness of the best witness."""
        return Bounds(
            self.inner.until(left.lower, right.lower, interval, past),
            self.inner.until(left.upper, right.upper, interval, past),
        )

    def step(self, x: Bounds[S], node: f.Step) -> Bounds[S]:
        """Return the next or previous sample's x."""
        return Bounds(self.inner.step(x.lower, node), self.inner.step(x.upper, node))

    def rise(self, x: Bounds[S]) -> Bounds[S]:
        """Return min(x now, −x just before)."""
        return Bounds(self.inner.edge(x.lower, x.upper), self.inner.edge(x.upper, x.lower))
