"""Whether a gap matters, in sentences: gap, margin and tolerance with their ratios, and the tests."""

from __future__ import annotations

from collections.abc import Mapping

from s2r_spec.base.quantity import quantity
from s2r_spec.diagnose.gap import LEVEL
from s2r_spec.diagnose.gap.materiality import Failures, GapAtTest, Materiality
from s2r_spec.report.check import test_words

PLACES = 3
"""Definition: tests that are printed, largest gap first."""
MOST_PERCENT = 10.0
"""Definition: ratio from which on a part is written as a multiple."""


def matters_words(materiality: Materiality | None, units: Mapping[str, str]) -> tuple[str, ...]:
    """Return sentences on the largest gap, on the tests at which the gap matters, and on early ends.

    Args:
        materiality: the answer; None if the gap was not compared.
        units: parameter → unit, in the spec's order.
    """
    if materiality is None:
        return ()
    lines = []
    if materiality.largest is not None:
        lines += [_largest_gap(materiality.largest, materiality, units), _tests(materiality, units)]
    if materiality.failures is not None:
        lines.append(_failures(materiality.failures))
    return tuple(lines)


def part_of(part: float, whole: float) -> str:
    """Return a ratio as people write it: ``0.6 %``, ``45 %``, ``12 times``."""
    ratio = abs(part / whole)
    if ratio >= MOST_PERCENT:
        return f"{ratio:.0f} times"
    percent = 100.0 * ratio
    return f"{percent:.0f} %" if percent >= 9.5 else f"{percent:.1g} %"


def _largest_gap(at: GapAtTest, materiality: Materiality, units: Mapping[str, str]) -> str:
    """Return the largest gap, with its parts of the margin and of the tolerance."""
    test = test_words(at.params, units)
    own = quantity(abs(at.gap), materiality.unit)
    worse = "worse" if at.gap < 0.0 else "better"
    parts = [
        f"{part_of(at.gap, whole)} of the {name} of {quantity(whole, materiality.unit)}"
        for name, whole in (("simulated margin", abs(at.simulated)), ("tolerance", materiality.tolerance))
        if whole
    ]
    words = f"largest gap{f' at {test}' if test else ''}: the machine is {own} {worse} than the simulator"
    return ", ".join([words, *parts])


def _tests(materiality: Materiality, units: Mapping[str, str]) -> str:
    """Return the number of tests at which the gap matters, and the first of them."""
    places = materiality.places
    if not places:
        false = f"at most {100 * LEVEL:.0f} % false alarms"
        return f"it matters at none of {len(materiality.tests)} tests, each compared by itself ({false})"
    changed = sum(at.changes_sign for at in places)
    words = f"it matters at {len(places)} of {len(materiality.tests)} tests"
    names = [name for name in (test_words(at.params, units) for at in places[:PLACES]) if name]
    if names:
        more = f", and {len(places) - PLACES} more" if len(places) > PLACES else ""
        words += f": {'; '.join(names)}{more}"
    return words + (f". The sign of ρ changes at {changed} of them" if changed else "")


def _failures(failures: Failures) -> str:
    """Return how many rollouts ended early."""
    than = "more than chance" if failures.matters else "no more than chance; repeat these tests to decide"
    return (
        f"{failures.real} of {failures.real_rollouts} real rollouts ended early, and {failures.simulated} of "
        f"{failures.simulated_rollouts} simulated ones: {than} (p = {failures.p:.2g})"
    )
