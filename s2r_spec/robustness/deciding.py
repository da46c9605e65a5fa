"""Search for the predicate and the sample that decide ρ."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from s2r_spec.base.arrays import FloatArray, IntArray
from s2r_spec.lang import formula as f
from s2r_spec.robustness.evaluate import Walk, up_to
from s2r_spec.robustness.ticks import Clock


@dataclass(frozen=True, kw_only=True)
class Step:
    """A sub-formula on the way down.

    Args:
        node: the sub-formula.
        factor: ρ of the requirement is factor · ρ of this node here; negative below a negation.
        vacuous: whether this is the false left side of an implication, which makes its right side irrelevant.
    """

    node: f.Formula
    factor: float = 1.0
    vacuous: bool = False


@dataclass(frozen=True, kw_only=True)
class DescentStep(Step):
    """A sub-formula on the way down, and the index of the sample at which it is evaluated."""

    sample: int


S = TypeVar("S", bound=Step)


class Descent(ABC, Generic[S]):
    """The way from a formula down to the predicate that decides its ρ, by the operands that give the ρ of each node."""

    def steps(self, first: S) -> Iterator[S]:
        """Yield the steps from the first one on."""
        step: S | None = first
        while step is not None:
            yield step
            step = self.below(step)

    @abstractmethod
    def rho(self, node: f.Formula, step: S, factor: float) -> float:
        """Return ρ of a node at the instant of a step; ρ of the requirement is factor · ρ of the node."""

    @abstractmethod
    def earlier(self, step: S) -> S | None:
        """Return the step at the instant before; None at the first one."""

    @abstractmethod
    def extreme(self, node: f.Formula, step: S, interval: f.Interval, past: bool, least: bool) -> S | None:
        """Return the step to the least, or the greatest, ρ of a node in a window; None in an empty one."""

    @abstractmethod
    def until(self, node: f.Until, step: S) -> S | None:
        """Return the step to the side of an until that decides; None in an empty window."""

    def below(self, step: S) -> S | None:
        """Return the step to the operand that decides; None at the end of the way."""
        node, factor = step.node, step.factor
        match node:
            case f.Named():
                return replace(step, node=node.operand, vacuous=False)
            case f.Not():
                return replace(step, node=node.operand, factor=-factor, vacuous=False)
            case f.Rescale():
                return replace(step, node=node.operand, factor=factor * node.factor, vacuous=False)
            case f.Junction():
                choose = min if node.operator == "and" else max
                chosen = choose(node.operands, key=lambda operand: self.rho(operand, step, factor))
                return replace(step, node=chosen, vacuous=False)
            case f.Implication():
                return self._implication(node, step)
            case f.Temporal():
                past = node.operator in ("historically", "once")
                least = node.operator in ("always", "historically")
                return self.extreme(node.operand, replace(step, vacuous=False), node.interval, past, least)
            case f.Until():
                return self.until(node, replace(step, vacuous=False))
            case f.Edge():
                return self._edge(node, replace(step, vacuous=False))
        return None

    def _implication(self, node: f.Implication, step: S) -> S:
        factor = step.factor
        left, right = -self.rho(node.left, step, -factor), self.rho(node.right, step, factor)
        back = self.rho(node.left, step, factor), -self.rho(node.right, step, -factor)
        if node.operator == "->" or max(left, right) <= max(back):
            side, factor = (node.left, -factor) if left >= right else (node.right, factor)
        else:
            side, factor = (node.left, factor) if back[0] >= back[1] else (node.right, -factor)
        vacuous = node.operator == "->" and side is node.left and left > 0
        return replace(step, node=side, factor=factor, vacuous=vacuous)

    def _edge(self, node: f.Edge, step: S) -> S | None:
        sign = 1.0 if node.operator == "rise" else -1.0
        if (earlier := self.earlier(step)) is None:
            return None
        now = sign * self.rho(node.operand, step, sign * step.factor)
        then = -sign * self.rho(node.operand, earlier, -sign * step.factor)
        if now <= then:
            return replace(step, node=node.operand, factor=sign * step.factor)
        return replace(earlier, node=node.operand, factor=-sign * step.factor)


def descend(root: f.Formula, walk: Walk[FloatArray], clock: Clock) -> Iterator[DescentStep]:
    """Yield the steps from ``root`` at the first sample to the predicate that decides its ρ.

    If several decide equally, the nearest in time is taken, and then the first in the text. The last step is a
    predicate, or has infinite ρ: a constant, a boolean signal, or an operator whose window lies past the end.
    """
    return _SampleDescent(walk, clock).steps(DescentStep(node=root, sample=0))


class _SampleDescent(Descent[DescentStep]):
    def __init__(self, walk: Walk[FloatArray], clock: Clock) -> None:
        self.walk, self.clock = walk, clock

    def rho(self, node: f.Formula, step: DescentStep, factor: float) -> float:
        return float(self.walk(node)[step.sample])

    def earlier(self, step: DescentStep) -> DescentStep | None:
        return replace(step, sample=step.sample - 1) if step.sample else None

    def below(self, step: DescentStep) -> DescentStep | None:
        node = step.node
        if not isinstance(node, f.AdjacentSample):
            return super().below(step)
        there = step.sample + (1 if node.operator == "next" else -1)
        there_is = 0 <= there < self.clock.count
        return DescentStep(node=node.operand, sample=there, factor=step.factor) if there_is else None

    def _window(self, interval: f.Interval, t: int, past: bool) -> IntArray:
        """Return the samples of a window, nearest first."""
        first, last = (int(end[t]) for end in self.clock.windows(interval, past))
        return np.arange(last, first - 1, -1) if past else np.arange(first, last + 1)

    def extreme(
        self, node: f.Formula, step: DescentStep, interval: f.Interval, past: bool, least: bool
    ) -> DescentStep | None:
        window = self._window(interval, step.sample, past)
        if not window.size:
            return None
        rho = self.walk(node)[window]
        return replace(step, node=node, sample=int(window[np.argmin(rho) if least else np.argmax(rho)]))

    def until(self, node: f.Until, step: DescentStep) -> DescentStep | None:
        # release is the dual of until, so the search runs on −ρ
        sign = -1.0 if node.operator == "release" else 1.0
        witness = best_witness(node, step.sample, self.walk, self.clock, sign)
        if node.operator == "unless":
            stays = self.extreme(node.left, step, up_to(node.interval), past=False, least=True)
            if stays and (witness is None or self.rho(node.left, stays, 1.0) >= witness.rho):
                return stays
        if witness is None:
            return None
        left, right = sign * self.walk(node.left), sign * self.walk(node.right)
        before = witness.before
        if before.size and left[before].min() < right[witness.witness]:
            return replace(step, node=node.left, sample=int(before[np.argmin(left[before])]))
        return replace(step, node=node.right, sample=witness.witness)


@dataclass(frozen=True, eq=False)
class Witnessed:
    """The best witness of an until at one sample.

    Args:
        witness: index of the sample.
        before: samples at which the left side must hold, nearest first.
        rho: the robustness ρ of the until.
    """

    witness: int
    before: IntArray
    rho: float


def best_witness(
    node: f.Until, t: int, walk: Walk[FloatArray], clock: Clock, sign: float
) -> Witnessed | None:
    """Return the first best witness of sign · left until sign · right at sample t; None in an empty window."""
    past = node.operator == "since"
    first, last = (int(end[t]) for end in clock.windows(node.interval, past))
    if last < first:
        return None
    way = np.arange(t, first - 1, -1) if past else np.arange(t, last + 1)
    skipped = t - last if past else first - t
    left, right = sign * walk(node.left)[way], sign * walk(node.right)[way]
    if walk.witness == "closed":
        right = np.minimum(left, right)
    guard = np.minimum.accumulate(np.concatenate(([np.inf], left[:-1])))
    rho = np.minimum(guard, right)[skipped:]
    best = skipped + int(np.argmax(rho))
    held = best + 1 if walk.witness == "closed" else best
    return Witnessed(int(way[best]), way[:held], float(rho.max()))
