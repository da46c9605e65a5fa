"""Robustness of a checked formula: one walk over its nodes, for any representation of signals.

An :class:`Algebra` defines the representation and its minimum, window and until operators: samples
(:mod:`s2r_spec.robustness.sampled`), curves in continuous time (:mod:`s2r_spec.robustness.dense`), torch tensors
(:mod:`s2r_spec.robustness.tensor`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace
from functools import reduce
from typing import Generic, Literal, TypeVar

from s2r_spec.lang import formula as f

S = TypeVar("S")
Witness = Literal["open", "closed"]


class Algebra(ABC, Generic[S]):
    """The operations on robustness signals from which the language's operators are built.

    With ``past`` the window of an instant t is t − interval, else t + interval.
    """

    @abstractmethod
    def truth(self, value: bool) -> S:
        """Return +inf or −inf at every instant."""

    @abstractmethod
    def flag(self, node: f.Flag) -> S:
        """Return +inf where a boolean signal is true, −inf where it is not."""

    @abstractmethod
    def margin(self, node: f.Comparison) -> S:
        """Return the robustness of a predicate."""

    @abstractmethod
    def negative(self, x: S) -> S:
        """Return −x."""

    @abstractmethod
    def scale(self, x: S, factor: float) -> S:
        """Return factor · x, factor > 0."""

    @abstractmethod
    def least(self, x: S, y: S) -> S:
        """Return the smaller of both at each instant."""

    def greatest(self, x: S, y: S) -> S:
        """Return the greater of both at each instant."""
        return self.negative(self.least(self.negative(x), self.negative(y)))

    @abstractmethod
    def always(self, x: S, interval: f.Interval, past: bool) -> S:
        """Return the infimum over the window; +inf where the window is empty."""

    def eventually(self, x: S, interval: f.Interval, past: bool) -> S:
        """Return the supremum over the window; −inf where the window is empty."""
        return self.negative(self.always(self.negative(x), interval, past))

    @abstractmethod
    def until(self, left: S, right: S, interval: f.Interval, past: bool) -> S:
        """Return sup over witnesses t' in the window of min(right(t'), inf of left on [t, t'))."""

    @abstractmethod
    def step(self, x: S, node: f.AdjacentSample) -> S:
        """Return the next or previous sample's x; −inf where there is none."""

    @abstractmethod
    def rise(self, x: S) -> S:
        """Return min(x now, −x just before); −inf at the first instant."""


class WithEdges(Algebra[S]):
    """An algebra whose edges may be of two signals."""

    @abstractmethod
    def edge(self, now: S, before: S, earlier: float = math.inf) -> S:
        """Return min(now, −before just before); ``earlier`` is the value before the first instant."""

    def rise(self, x: S) -> S:
        """Return min(x, −x just before)."""
        return self.edge(x, x)


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
                return algebra.rise(now if node.operator == "rise" else algebra.negative(now))
            case _:
                raise AssertionError(node)

    def _until(self, node: f.Until) -> S:
        algebra, within = self.algebra, node.interval
        left, right = self(node.left), self(node.right)
        match node.operator:
            case "until" | "since":
                return self._witnessed(left, right, within, past=node.operator == "since")
            case "release":
                return algebra.negative(
                    self._witnessed(algebra.negative(left), algebra.negative(right), within, past=False)
                )
            case "unless":
                stays = algebra.always(left, up_to(within), False)
                return algebra.greatest(stays, self._witnessed(left, right, within, past=False))

    def _witnessed(self, left: S, right: S, within: f.Interval, past: bool) -> S:
        if self.witness == "closed":
            right = self.algebra.least(left, right)
        return self.algebra.until(left, right, within, past)


def up_to(within: f.Interval) -> f.Interval:
    """Return the interval from now to the end of another one."""
    return replace(within, low=0.0, low_closed=True)
