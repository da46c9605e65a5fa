"""The part of a trace after an instant that a formula depends on."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

from s2r_spec.lang import formula as f
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.once import once

Ends = Callable[[f.Interval], tuple[float, float]]


@once
def horizon(formula: f.Formula) -> float:
    """Return the time after an instant that decides the formula there [s]; inf if it is the whole rest.

    A sub-formula that is evaluated later counts even if it only looks back.
    """
    return _reach(formula, lambda interval: (interval.low, interval.high), 0.0)


@once
def samples_needed(formula: f.Formula, period: Fraction | None) -> int:
    """Return the number of samples after an instant that a formula needs on a grid of a period [s].

    An unbounded window needs only its first sample, since it means the rest of the trace, of any length. An open end
    does not need the sample on it.
    """
    grid = Grid(1, period)

    def ends(interval: f.Interval) -> tuple[float, float]:
        low, high = grid.window(interval)
        return low, low if high is None else high

    return int(_reach(formula, ends, 1.0))


@once
def samples_read(formula: f.Formula, period: Fraction | None) -> float:
    """Return the number of samples after an instant that ρ there depends on; inf for the rest of the trace."""
    grid = Grid(1, period)

    def ends(interval: f.Interval) -> tuple[float, float]:
        low, high = grid.window(interval)
        return low, math.inf if high is None else high

    return _reach(formula, ends, 1.0)


@once
def seconds_needed(formula: f.Formula, step: float, slack: float) -> float:
    """Return the time after an instant that a trace must last to decide a formula there [s].

    Like :func:`samples_needed`, but in time. An unbounded window needs only its beginning.

    Args:
        formula: the formula.
        step: time from one sample to the next, for ``next`` [s].
        slack: time by which an open end comes before a closed one, since it needs no sample on it [s].
    """

    def ends(within: f.Interval) -> tuple[float, float]:
        high = within.low if math.isinf(within.high) else within.high
        return within.low, high if within.high_closed or high == within.low else high - slack

    return _reach(formula, ends, step)


@once
def samples_before(formula: f.Formula, period: Fraction | None) -> float:
    """Return a number of samples before an instant on which ρ there depends at most; inf for all of them."""
    grid = Grid(1, period)
    known: dict[int, float] = {}

    def before(node: f.Node) -> float:
        if id(node) not in known:
            known[id(node)] = here(node) + max(map(before, f.children(node)), default=0.0)
        return known[id(node)]

    def here(node: f.Node) -> float:
        match node:
            case f.Temporal(operator="historically" | "once") | f.Until(operator="since"):
                high = grid.window(node.interval)[1]
                return math.inf if high is None else high
            case f.AdjacentSample(operator="prev") | f.Edge():
                return 1.0
            case (
                f.Initial() | f.Overshoot() | f.Delayed() | f.Derivative()
                | f.Accumulated() | f.Duration() | f.Count()
            ):  # fmt: skip
                # They count from the first sample, or round as sums and times from there do.
                return math.inf
        return 0.0

    return before(formula)


def _reach(formula: f.Formula, ends: Ends, step: float) -> float:
    """Return the sum of the interval ends from the outermost operator to the innermost; `next` counts ``step``."""
    known: dict[int, float] = {}

    def reach(node: f.Node) -> float:
        if id(node) not in known:
            known[id(node)] = here(node)
        return known[id(node)]

    def below(node: f.Node) -> float:
        return max(map(reach, f.children(node)), default=0.0)

    def here(node: f.Node) -> float:
        match node:
            case f.Temporal(operator="always" | "eventually"):
                return ends(node.interval)[1] + below(node)
            case f.Temporal(operator="historically" | "once"):
                return max(0.0, below(node) - ends(node.interval)[0])
            case f.Until(operator="since"):
                return max(0.0, reach(node.left), reach(node.right) - ends(node.interval)[0])
            case f.Until():
                return ends(node.interval)[1] + below(node)
            case f.AdjacentSample(operator="next"):
                return step + below(node)
            case _:
                return below(node)

    return reach(formula)
