"""The samples on which a verdict depends: it stays the same while the predicates keep their truth values there."""

from __future__ import annotations

from functools import reduce

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray
from s2r_spec.lang import formula as f
from s2r_spec.robustness.deciding import best_witness
from s2r_spec.robustness.evaluate import Walk, up_to
from s2r_spec.robustness.ticks import Clock


def responsible_samples(root: f.Formula, walk: Walk[FloatArray], clock: Clock) -> dict[int, BoolArray]:
    """Return id of predicate → (n,): the samples at which the verdict of ``root`` at sample 0 depends on it.

    A violated ``always`` depends on the samples that violate it, and a satisfied one on its whole window;
    ``eventually`` is the opposite. A predicate that does not matter is absent.
    """
    start = np.zeros(clock.count, dtype=bool)
    start[0] = True
    causes = _Causes(walk, clock)
    causes.add(root, start, float(walk(root)[0]) > 0)
    return causes.found


class _Causes:
    def __init__(self, walk: Walk[FloatArray], clock: Clock) -> None:
        self.walk, self.clock = walk, clock
        self.found: dict[int, BoolArray] = {}

    def agrees(self, node: f.Formula, holds: bool) -> BoolArray:
        rho = self.walk(node)
        return np.asarray(rho > 0 if holds else rho < 0)

    def add(self, node: f.Formula, at: BoolArray, holds: bool) -> None:
        """Add the predicates and samples that make ``node`` hold, or not hold, at the samples ``at``."""
        if not at.any():
            return
        match node:
            case f.Comparison():
                self.found[id(node)] = self.found.get(id(node), np.zeros_like(at)) | at
            case f.Named() | f.Rescale():
                self.add(node.operand, at, holds)
            case f.Not():
                self.add(node.operand, at, not holds)
            case f.Junction():
                every = (node.operator == "and") == holds
                for operand in node.operands:
                    self.add(operand, at if every else at & self.agrees(operand, holds), holds)
            case f.Implication():
                self._implication(node, at, holds)
            case f.Temporal():
                over = node.operator in ("always", "historically")
                window = self._reach(at, node.interval, past=node.operator in ("historically", "once"))
                self.add(
                    node.operand,
                    window if over == holds else window & self.agrees(node.operand, holds),
                    holds,
                )
            case f.Until():
                self._until(node, at, holds)
            case f.AdjacentSample():
                self.add(node.operand, _shift(at, 1 if node.operator == "next" else -1), holds)
            case f.Edge():
                rises = node.operator == "rise"
                for there, value in ((at, rises), (_shift(at, -1), not rises)):
                    if holds:
                        self.add(node.operand, there, value)
                    else:
                        self.add(node.operand, there & self.agrees(node.operand, not value), not value)
            case _:
                pass  # a constant depends on no sample

    def _reach(self, at: BoolArray, interval: f.Interval, past: bool) -> BoolArray:
        """Return the samples that lie in the window of any of ``at``."""
        first, last = self.clock.windows(interval, past)
        at = at & (last >= first)
        change = np.zeros(at.size + 1, dtype=np.intp)
        np.add.at(change, first[at], 1)
        np.add.at(change, last[at] + 1, -1)
        return np.asarray(np.cumsum(change)[:-1] > 0)

    def _implication(self, node: f.Implication, at: BoolArray, holds: bool) -> None:
        if node.operator == "<->":
            for side in (node.left, node.right):
                for value in (True, False):
                    self.add(side, at & self.agrees(side, value), value)
        elif holds:
            self.add(node.left, at & self.agrees(node.left, False), False)
            self.add(node.right, at & self.agrees(node.right, True), True)
        else:
            self.add(node.left, at, True)
            self.add(node.right, at, False)

    def _until(self, node: f.Until, at: BoolArray, holds: bool) -> None:
        dual = node.operator == "release"
        sign = -1.0 if dual else 1.0
        until_holds = holds != dual  # for release, the until of the negated sides
        parts = [self._one(node, int(t), sign, until_holds) for t in np.flatnonzero(at)]
        left = reduce(np.logical_or, (part[0] for part in parts))
        right = reduce(np.logical_or, (part[1] for part in parts))
        self.add(node.left, left, holds)
        self.add(node.right, right, holds)

    def _one(self, node: f.Until, t: int, sign: float, until_holds: bool) -> tuple[BoolArray, BoolArray]:
        """Return the samples at which an until at sample t depends on its left and on its right side."""
        left, right = np.zeros((2, self.clock.count), dtype=bool)
        witness = best_witness(node, t, self.walk, self.clock, sign)
        if until_holds and witness is not None and (node.operator != "unless" or witness.rho > 0):
            left[witness.before], right[witness.witness] = True, True
            return left, right
        past = node.operator == "since"
        first, last = (int(end[t]) for end in self.clock.windows(node.interval, past))
        if until_holds:  # an unless without a witness: its left side holds throughout
            last = int(self.clock.windows(up_to(node.interval), False)[1][t])
            left[t : last + 1] = True
            return left, right
        # violated: no witness up to where the left side fails
        way = np.arange(t, first - 1, -1) if past else np.arange(t, last + 1)
        fails = np.flatnonzero(-sign * self.walk(node.left)[way] > 0)
        if fails.size:
            left[way[fails[0]]] = True
            way = way[: fails[0] + 1]
        right[way[(way >= first) & (way <= last)]] = True
        right &= -sign * self.walk(node.right) > 0
        return left, right


def _shift(at: BoolArray, steps: int) -> BoolArray:
    moved = np.zeros_like(at)
    if steps > 0:
        moved[steps:] = at[:-steps]
    else:
        moved[:steps] = at[-steps:]
    return moved
