"""Robustness of a checked formula: one walk over its nodes, for any representation of signals.

An :class:`Algebra` defines the representation and its minimum, window and until operators: samples
(:mod:`s2r_spec.robustness.sampled`), curves in continuous time (:mod:`s2r_spec.robustness.dense`), torch tensors
(:mod:`s2r_spec.robustness.tensor`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from typing import Generic, Literal, TypeVar

from s2r_spec.lang import formula as f

S = TypeVar("S")
Witness = Literal["open", "closed"]


@dataclass(frozen=True)
class Algebra(Generic[S]):
    """The operations on robustness signals from which the language's operators are built.

    Args:
        truth: +inf or −inf at every instant.
        flag: +inf where a boolean signal is true, −inf where it is not.
        margin: the robustness of a predicate.
        negative: −x.
        scale: factor · x, factor > 0.
        least: the smaller of both at each instant.
        greatest: the greater of both at each instant.
        always: the infimum over t + interval, or t − interval if ``past``; +inf where this window is empty.
        eventually: the supremum over the window; −inf where it is empty.
        until: sup over witnesses t' in the window of min(right(t'), inf of left on [t, t')).
        step: the next or previous sample's x; −inf where there is none.
        edge: min(now, −before just before); the last argument is the value before the first instant.
    """

    truth: Callable[[bool], S]
    flag: Callable[[f.Flag], S]
    margin: Callable[[f.Comparison], S]
    negative: Callable[[S], S]
    scale: Callable[[S, float], S]
    least: Callable[[S, S], S]
    greatest: Callable[[S, S], S]
    always: Callable[[S, f.Interval, bool], S]
    eventually: Callable[[S, f.Interval, bool], S]
    until: Callable[[S, S, f.Interval, bool], S]
    step: Callable[[S, f.AdjacentSample], S]
    edge: Callable[[S, S, float], S]


class Walk(Generic[S]):
    """Evaluates the formulas below one root.

    A node that is used in several places is evaluated once. :attr:`done` keeps the results for explanations.

    Args:
        algebra: representation of the signals.
        until: whether the left side of an until must hold before the witness only
            ("open", as in RTAMT's discrete time) or at the witness, too ("closed", as in Breach).
    """

    def __init__(self, algebra: Algebra[S], until: Witness = "open") -> None:
        self.algebra = algebra
        self.witness = until
        self.done: dict[int, S] = {}

    def __call__(self, node: f.Formula) -> S:
        """Return the robustness of ``node``, positive where it holds, in the unit of the node."""
        if id(node) not in self.done:
            self.done[id(node)] = self._formula(node)
        return self.done[id(node)]

    def _formula(self, node: f.Formula) -> S:
        algebra = self.algebra
        match node:
            case f.Named():
                return self(node.operand)
            case f.Comparison():
                return algebra.margin(node)
            case f.Flag():
                return algebra.flag(node)
            case f.Truth():
                return algebra.truth(node.value)
            case f.Not():
                return algebra.negative(self(node.operand))
            case f.Junction():
                fold = algebra.least if node.operator == "and" else algebra.greatest
                return reduce(fold, map(self, node.operands))
            case f.Implication():
                left, right = self(node.left), self(node.right)
                forward = algebra.greatest(algebra.negative(left), right)
                if node.operator == "->":
                    return forward
                return algebra.least(forward, algebra.greatest(left, algebra.negative(right)))
            case f.Rescale():
                return algebra.scale(self(node.operand), node.factor)
            case f.Temporal():
                over = algebra.always if node.operator in ("always", "historically") else algebra.eventually
                return over(self(node.operand), node.interval, node.operator in ("historically", "once"))
            case f.Until():
                return self._until(node)
            case f.AdjacentSample():
                return algebra.step(self(node.operand), node)
            case f.Edge():
                now = self(node.operand)
                now = now if node.operator == "rise" else algebra.negative(now)
                return algebra.edge(now, now, math.inf)
            case _:
                raise AssertionError(node)

    def _until(self, node: f.Until) -> S:
        algebra, within = self.algebra, node.interval
        left, right = self(node.left), self(node.right)
        match node.operator:
            case "until" | "since":
                return self._witnessed(left, right, within, node.operator == "since")
            case "release":
                left, right = algebra.negative(left), algebra.negative(right)
                return algebra.negative(self._witnessed(left, right, within, False))
            case "unless":
                stays = algebra.always(left, up_to(within), False)
                return algebra.greatest(stays, self._witnessed(left, right, within, False))

    def _witnessed(self, left: S, right: S, within: f.Interval, past: bool) -> S:
        if self.witness == "closed":
            right = self.algebra.least(left, right)
        return self.algebra.until(left, right, within, past)


def up_to(within: f.Interval) -> f.Interval:
    """Return the interval from now to the end of another one."""
    return replace(within, low=0.0, low_closed=True)
