"""Sentences and table cells on the sizes at which effects break the requirement, or restore it."""

from __future__ import annotations

from collections.abc import Mapping

from s2r_spec.base.quantity import interval, quantity
from s2r_spec.diagnose.gap.breaking import Breaking, BreakingSize, Crossing
from s2r_spec.report.check import test_words

FIRST = 3
"""Definition: parameters that a sentence names, nearest first."""


def breaking_title(breaking: Breaking | None) -> str:
    """Return the head of the column: what a crossing does to the requirement; "" without any."""
    if breaking is None:
        return ""
    return "breaks" if breaking.holds else "holds again"


def breaking_cell(one: BreakingSize | None) -> str:
    """Return where ρ changes sign: "above 2.1 N·m (1.6 to 2.4 N·m)"; "" for a parameter that does nothing alone."""
    if one is None:
        return ""
    sides = zip(("below", "above"), (one.below, one.above), strict=True)
    words = " or ".join(f"{side} {_place(end, one.axis.unit)}" for side, end in sides if end is not None)
    return words or f"at no size from {interval(*one.simulated, one.axis.unit, exact=True)}"


def _place(end: Crossing, unit: str) -> str:
    around, half = interval(end.low, end.high, unit, exact=True), (end.high - end.low) / 2
    if end.estimate is None:
        return f"a size from {around}"
    return f"{quantity(end.estimate, unit, half)} ({around})"


def breaking_words(breaking: Breaking | None, units: Mapping[str, str]) -> str:
    """Return a sentence on the margin, and on the effects that use it up first; "" without any."""
    if breaking is None:
        return ""
    test = test_words(breaking.test, units)
    margin = quantity(abs(breaking.rho), breaking.unit)
    sign = "" if breaking.holds else "−"
    start = f"the machine has ρ = {sign}{margin} at its worst test{f', {test}' if test else ''}"
    near = breaking.crossed[:FIRST]
    does = "breaks the requirement" if breaking.holds else "restores the requirement"
    if not near:
        return f"{start}, and no simulated size of a single effect {does}"
    return f"{start}. A single effect {does}: " + "; ".join(
        f"{one.name} {breaking_cell(one)}" for one in near
    )
