"""The algebra that turns a formula into terms, which compute its robustness sample by sample."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from s2r_spec.lang import formula as f
from s2r_spec.robustness.evaluate import Algebra, Walk, Witness
from s2r_spec.robustness.numbers import MARGIN, no_value
from s2r_spec.robustness.online.clock import Component, InstantNumber, OnlineClock
from s2r_spec.robustness.online.spans import ANY, Span, Spans
from s2r_spec.robustness.online.tape import InstantSource, Tape
from s2r_spec.robustness.online.terms import AdjacentSample, Leaf, Least, Negative, Rise, Scaled, Term
from s2r_spec.robustness.online.timed import Always, Until
from s2r_spec.robustness.online.values import NumberBuilder
from s2r_spec.robustness.ties import break_tie, tie


@dataclass(eq=False)
class OnlineAlgebra:
    """Robustness signals that grow with the trace.

    Args:
        clock: the clock of the trace.
        signals: name → a tape for each component.
        ranges: name → range of a signal's samples, for signals with a known one.
        params: name → value.
        roots: the formulas.
        until: see :class:`s2r_spec.robustness.evaluate.Walk`.
    """

    clock: OnlineClock
    signals: Mapping[str, Sequence[Tape]]
    ranges: Mapping[str, Span]
    params: Mapping[str, float]
    roots: Sequence[f.Formula]
    until: Witness

    def __post_init__(self) -> None:
        self.walk = Walk(self._operations(), self.until)
        self.values = NumberBuilder(self.clock, self.signals, self.params, self.roots, self._follow)
        self.terms: list[Term] = []  # the operands of a term come before it
        self.predicates: list[tuple[Leaf, f.Comparison]] = []
        timed = (
            node for root in self.roots for node in f.walk(root) if isinstance(node, f.Temporal | f.Until)
        )
        self.places = {id(node.interval.span): node.span for node in timed}

    def foresee(self) -> None:
        """Compute the range of every term, from the known ranges of the signals."""
        spans = Spans(self.ranges, self.params, self.values.settled)
        for leaf, node in self.predicates:
            low, high = spans.margin(node)
            leaf.ahead = break_tie(low, node.operator), break_tie(high, node.operator)
        for term in self.terms:
            term.foresee()

    def _follow(self, node: f.Formula) -> Term:
        term = self.walk(node)
        term.follow()
        return term

    def _operations(self) -> Algebra[Term]:
        clock, make = self.clock, self._make
        return Algebra(
            truth=self._truth,
            flag=self._flag,
            margin=self._margin,
            negative=self._negative,
            scale=lambda x, factor: make(Scaled(clock, x, factor)),
            least=lambda x, y: make(Least(clock, x, y)),
            greatest=self._greatest,
            always=self._always,
            eventually=lambda x, interval, past: self._negative(
                self._always(self._negative(x), interval, past)
            ),
            until=self._until,
            step=lambda x, node: make(AdjacentSample(clock, x, node.operator == "next")),
            # of one signal, and never at the first sample
            edge=lambda now, before, earlier: make(Rise(clock, now)),
        )

    def _make(self, term: Term) -> Term:
        self.terms.append(term)
        return term

    def _leaf(self, margin: Component, sources: tuple[InstantSource, ...], ahead: Span) -> Leaf:
        samples = {id(tape) for tapes in self.signals.values() for tape in tapes}
        leaf = Leaf(self.clock, InstantNumber((margin,), sources), samples.issuperset(map(id, sources)))
        leaf.ahead = ahead
        return leaf

    def _truth(self, value: bool) -> Term:
        rho = math.inf if value else -math.inf
        return self._leaf(lambda k: rho, (), (rho, rho))

    def _flag(self, node: f.Flag) -> Term:
        (tape,) = self.signals[node.name]
        return self._leaf(lambda k: math.inf if tape.value(k) > 0 else -math.inf, (tape,), ANY)

    def _margin(self, node: f.Comparison) -> Term:
        left, right = self.values(node.left), self.values(node.right)
        (x,), (y,) = left.parts, right.parts
        difference, equal = MARGIN[node.operator], tie(node.operator)

        def margin(k: int) -> float:
            rho: float = difference(x(k), y(k))
            if rho != rho:
                raise no_value(node, f"sample {k}, {self.clock.seconds(k):.9g} s after the first")
            return rho or equal

        leaf = self._leaf(margin, (*left.sources, *right.sources), ANY)
        self.predicates.append((leaf, node))
        return leaf

    def _negative(self, x: Term) -> Term:
        return x.operand if type(x) is Negative else self._make(Negative(self.clock, x))

    def _greatest(self, x: Term, y: Term) -> Term:
        return self._negative(self._make(Least(self.clock, self._negative(x), self._negative(y))))

    def _always(self, x: Term, interval: f.Interval, past: bool) -> Term:
        reach, place = self.clock.reach(interval, past), self.places[id(interval.span)]
        return self._make(Always(self.clock, x, reach, past, place))

    def _until(self, left: Term, right: Term, interval: f.Interval, past: bool) -> Term:
        reach, place = self.clock.reach(interval, past), self.places[id(interval.span)]
        return self._make(Until(self.clock, left, right, reach, past, place))
