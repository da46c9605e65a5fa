"""Search for the predicate and the sample that decide ρ."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray, IntArray
from s2r_spec.lang import formula as f
from s2r_spec.robustness.evaluate import Walk, up_to
from s2r_spec.robustness.ticks import Clock


@dataclass(frozen=True)
class DescentStep:
    """A sub-formula on the way down, and the sample at which it is evaluated.

    Args:
        node: the sub-formula.
        sample: index of the sample.
        factor: ρ of the requirement is factor · ρ of this node here; negative below a negation.
        vacuous: whether this is the false left side of an implication, which makes its right side irrelevant.
    """

    node: f.Formula
    sample: int
    factor: float
    vacuous: bool = False


def descend(root: f.Formula, walk: Walk[FloatArray], clock: Clock) -> Iterator[DescentStep]:
    """Yield the steps from ``root`` at the first sample to the predicate that decides its ρ.

    If several decide equally, the nearest in time is taken, and then the first in the text. The last step is a
    predicate, or has infinite ρ: a constant, a boolean signal, or an operator whose window lies past the end.
    """
    step: DescentStep | None = DescentStep(root, 0, 1.0)
    down = _Descent(walk, clock)
    while step is not None:
        yield step
        step = down.below(step)


class _Descent:
    def __init__(self, walk: Walk[FloatArray], clock: Clock) -> None:
        self.walk, self.clock = walk, clock

    def rho(self, node: f.Formula, sample: int) -> float:
        return float(self.walk(node)[sample])

    def below(self, step: DescentStep) -> DescentStep | None:
        node, t, factor = step.node, step.sample, step.factor
        match node:
            case f.Named():
                return DescentStep(node.operand, t, factor)
            case f.Not():
                return DescentStep(node.operand, t, -factor)
            case f.Rescale():
                return DescentStep(node.operand, t, factor * node.factor)
            case f.Junction():
                choose = min if node.operator == "and" else max
                return DescentStep(choose(node.operands, key=lambda operand: self.rho(operand, t)), t, factor)
            case f.Implication():
                return self._implication(node, t, factor)
            case f.Temporal():
                over = node.operator in ("always", "historically")
                window = self._window(node.interval, t, past=node.operator in ("historically", "once"))
                return self._extreme(node.operand, window, factor, least=over)
            case f.Until():
                return self._until(node, t, factor)
            case f.AdjacentSample():
                there = t + (1 if node.operator == "next" else -1)
                return DescentStep(node.operand, there, factor) if 0 <= there < self.clock.count else None
            case f.Edge():
                rise = 1.0 if node.operator == "rise" else -1.0
                if t == 0:
                    return None
                now, before = rise * self.rho(node.operand, t), -rise * self.rho(node.operand, t - 1)
                if now <= before:
                    return DescentStep(node.operand, t, rise * factor)
                return DescentStep(node.operand, t - 1, -rise * factor)
            case _:
                return None

    def _window(self, interval: f.Interval, t: int, past: bool) -> IntArray:
        """Return the samples of a window, nearest first."""
        first, last = (int(end[t]) for end in self.clock.windows(interval, past))
        return np.arange(last, first - 1, -1) if past else np.arange(first, last + 1)

    def _extreme(self, node: f.Formula, window: IntArray, factor: float, least: bool) -> DescentStep | None:
        if not window.size:
            return None
        rho = self.walk(node)[window]
        return DescentStep(node, int(window[np.argmin(rho) if least else np.argmax(rho)]), factor)

    def _implication(self, node: f.Implication, t: int, factor: float) -> DescentStep:
        left, right = self.rho(node.left, t), self.rho(node.right, t)
        forward = node.operator == "->" or max(-left, right) <= max(left, -right)
        if forward:
            if -left >= right:
                return DescentStep(node.left, t, -factor, vacuous=left < 0)
            return DescentStep(node.right, t, factor)
        return DescentStep(node.left, t, factor) if left >= -right else DescentStep(node.right, t, -factor)

    def _until(self, node: f.Until, t: int, factor: float) -> DescentStep | None:
        # release is the dual of until, so the search runs on −ρ
        sign = -1.0 if node.operator == "release" else 1.0
        witness = best_witness(node, t, self.walk, self.clock, sign)
        if node.operator == "unless":
            stays = self._extreme(node.left, self._window(up_to(node.interval), t, False), factor, least=True)
            if stays and (witness is None or self.rho(node.left, stays.sample) >= witness.rho):
                return stays
        if witness is None:
            return None
        left, right = sign * self.walk(node.left), sign * self.walk(node.right)
        before = witness.before
        if before.size and left[before].min() < right[witness.witness]:
            return DescentStep(node.left, int(before[np.argmin(left[before])]), factor)
        return DescentStep(node.right, witness.witness, factor)


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
