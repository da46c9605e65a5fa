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
from s2r_spec.robustness.evaluate import Algebra

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


def bounded_algebra(
    inner: Algebra[S], leaf: Callable[[f.Comparison | f.Flag], RhoBounds[S]]
) -> Algebra[RhoBounds[S]]:
    """Return the operations on robustness signals with bounds.

    Args:
        inner: the algebra of each bound.
        leaf: predicate, or use of a boolean signal → the bounds of its margin.
    """

    def each(change: Callable[..., S]) -> Callable[..., RhoBounds[S]]:
        """Return a monotone function of bounds."""
        return lambda x, *rest: replace(x, lower=change(x.lower, *rest), upper=change(x.upper, *rest))

    def both(change: Callable[..., S]) -> Callable[..., RhoBounds[S]]:
        """Return a function of two bounds that is monotone in both."""
        return lambda x, y, *rest: RhoBounds(
            change(x.lower, y.lower, *rest), change(x.upper, y.upper, *rest), x.unseen or y.unseen
        )

    def truth(value: bool) -> RhoBounds[S]:
        known = inner.truth(value)
        return RhoBounds(known, known)

    def edge(now: RhoBounds[S], before: RhoBounds[S], earlier: float) -> RhoBounds[S]:
        upper = inner.edge(now.upper, before.lower, -math.inf if before.unseen else earlier)
        return RhoBounds(inner.edge(now.lower, before.upper, earlier), upper, before.unseen)

    return Algebra(
        truth=truth,
        flag=leaf,
        margin=leaf,
        negative=lambda x: replace(x, lower=inner.negative(x.upper), upper=inner.negative(x.lower)),
        scale=each(inner.scale),
        least=both(inner.least),
        greatest=both(inner.greatest),
        always=each(inner.always),
        eventually=each(inner.eventually),
        until=both(inner.until),
        step=each(inner.step),
        edge=edge,
    )
