"""Robustness that is known only within bounds: a signal was silent, or has several values at one instant.

Data: a walk over an algebra (:mod:`s2r_spec.robustness.evaluate`), and for each predicate a lower and an upper margin.
They differ where the margin is not known: −inf and +inf where one of its signals has no valid value, and the least and
the greatest where a signal has several values with one stamp.

Unknown: ρ. Model: every operator is monotone in each of its margins, and negation turns them around. So the bounds of a
formula follow from the bounds of its predicates, and contain ρ for every value of what is not known. They need not be
tight, because predicates count as independent. The online monitor has the same model (docs/reference/language.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from s2r_spec.lang import formula as f
from s2r_spec.robustness.evaluate import Algebra, WithEdges

S = TypeVar("S")


@dataclass(frozen=True)
class RhoBounds(Generic[S]):
    """The bounds of a robustness signal at every instant.

    Args:
        lower: the least.
        upper: the greatest.
        unseen: whether it reads a signal whose first message is at the first instant, in a log that began before: then
            nobody knows whether it was true just before.
    """

    lower: S
    upper: S
    unseen: bool = False


@dataclass(frozen=True)
class BoundedAlgebra(Algebra[RhoBounds[S]], Generic[S]):
    """Robustness signals with bounds.

    Args:
        inner: the algebra of each bound.
        leaf: predicate, or use of a boolean signal → the bounds of its margin.
    """

    inner: WithEdges[S]
    leaf: Callable[[f.Comparison | f.Flag], RhoBounds[S]]

    def truth(self, value: bool) -> RhoBounds[S]:
        """Return +inf or −inf."""
        known = self.inner.truth(value)
        return RhoBounds(known, known)

    def flag(self, node: f.Flag) -> RhoBounds[S]:
        """Return the bounds of a boolean signal."""
        return self.leaf(node)

    def margin(self, node: f.Comparison) -> RhoBounds[S]:
        """Return the bounds of a predicate."""
        return self.leaf(node)

    def negative(self, x: RhoBounds[S]) -> RhoBounds[S]:
        """Return −x."""
        return replace(x, lower=self.inner.negative(x.upper), upper=self.inner.negative(x.lower))

    def scale(self, x: RhoBounds[S], factor: float) -> RhoBounds[S]:
        """Return factor · x, factor > 0."""
        return _each(x, lambda one: self.inner.scale(one, factor))

    def least(self, x: RhoBounds[S], y: RhoBounds[S]) -> RhoBounds[S]:
        """Return the smaller of both."""
        return _both(x, y, self.inner.least)

    def greatest(self, x: RhoBounds[S], y: RhoBounds[S]) -> RhoBounds[S]:
        """Return the greater of both."""
        return _both(x, y, self.inner.greatest)

    def always(self, x: RhoBounds[S], interval: f.Interval, past: bool) -> RhoBounds[S]:
        """Return the infimum over the window."""
        return _each(x, lambda one: self.inner.always(one, interval, past))

    def eventually(self, x: RhoBounds[S], interval: f.Interval, past: bool) -> RhoBounds[S]:
        """Return the supremum over the window."""
        return _each(x, lambda one: self.inner.eventually(one, interval, past))

    def until(
        self, left: RhoBounds[S], right: RhoBounds[S], interval: f.Interval, past: bool
    ) -> RhoBounds[S]:
        """Return the robustness of the best witness."""
        return _both(left, right, lambda x, y: self.inner.until(x, y, interval, past))

    def step(self, x: RhoBounds[S], node: f.AdjacentSample) -> RhoBounds[S]:
        """Return the next or previous sample's x."""
        return _each(x, lambda one: self.inner.step(one, node))

    def rise(self, x: RhoBounds[S]) -> RhoBounds[S]:
        """Return min(x now, −x just before)."""
        lower = self.inner.edge(x.lower, x.upper)
        if not x.unseen:
            return RhoBounds(lower, self.inner.edge(x.upper, x.lower))
        return RhoBounds(lower, self.inner.edge(x.upper, x.lower, -math.inf), True)


def _each(x: RhoBounds[S], change: Callable[[S], S]) -> RhoBounds[S]:
    """Return a monotone function of bounds."""
    return replace(x, lower=change(x.lower), upper=change(x.upper))


def _both(x: RhoBounds[S], y: RhoBounds[S], change: Callable[[S, S], S]) -> RhoBounds[S]:
    """Return a function of two bounds that is monotone in both."""
    return RhoBounds(change(x.lower, y.lower), change(x.upper, y.upper), x.unseen or y.unseen)
