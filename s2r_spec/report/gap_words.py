"""Sentences on a gap: whether it matters, where it lies, what no effect explains, how far it shrinks, what breaks ρ."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from s2r_spec.attribution.place import Place, ValueRange, cause_first
from s2r_spec.base.quantity import Scale, format_estimate, interval, quantity, signed_quantity
from s2r_spec.diagnose.gap import LEVEL
from s2r_spec.diagnose.gap.breaking import Breaking, BreakingSize, Crossing
from s2r_spec.diagnose.gap.held_out import HeldOutGap
from s2r_spec.diagnose.gap.materiality import GapAtTest, Materiality
from s2r_spec.diagnose.gap.shares import Gap
from s2r_spec.diagnose.gap.where import Where
from s2r_spec.diagnose.residuals.left import Remainder
from s2r_spec.report.check import test_words
from s2r_spec.report.figures.robot import amount
from s2r_spec.spec import Spec

FIRST = 3
"""Definition: parts of the machine, tests, or parameters that are printed, the largest or nearest first."""
LATE = 0.95
"""Definition: part of a rollout; a window that ends later than it says nothing about the time of the cause."""

MOST_PERCENT = 10.0
"""Definition: ratio from which on a part is written as a multiple."""


def join_names(names: Sequence[str], last: str = "and") -> str:
    """Return "a, b and c"."""
    return f" {last} ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def matters_words(materiality: Materiality | None, units: Mapping[str, str]) -> tuple[str, ...]:
    """Return sentences on the largest gap, on the tests at which the gap matters, and on early ends."""
    if materiality is None:
        return ()
    lines = []
    if materiality.largest is not None:
        lines += [_largest_gap(materiality.largest, materiality, units), _tests(materiality, units)]
    if (ends := materiality.failures) is not None:
        than = "more than chance" if ends.matters else "no more than chance; repeat these tests to decide"
        lines.append(
            f"{ends.real} of {ends.real_rollouts} real rollouts ended early, and {ends.simulated} of "
            f"{ends.simulated_rollouts} simulated ones: {than} (p = {ends.p:.2g})"
        )
    return tuple(lines)


def _part_of(part: float, whole: float) -> str:
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
        f"{_part_of(at.gap, whole)} of the {name} of {quantity(whole, materiality.unit)}"
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
        none = f"one by one, the gap matters at none of {len(materiality.tests)} tests ({false})"
        return f"{none}; an average over tests shows smaller gaps"
    changed = sum(at.changes_sign for at in places)
    words = f"it matters at {len(places)} of {len(materiality.tests)} tests"
    names = [name for name in (test_words(at.params, units) for at in places[:FIRST]) if name]
    if names:
        more = f", and {len(places) - FIRST} more" if len(places) > FIRST else ""
        words += f": {'; '.join(names)}{more}"
    return words + (f". The sign of ρ changes at {changed} of them" if changed else "")


def where_words(where: Where, spec: Spec) -> tuple[str, ...]:
    """Return sentences on the worst test: its gap, and the time, channel and predicate that cause most of it."""
    unit = where.pair.unit
    test = test_words(where.test, spec.space.units)
    delta = signed_quantity(where.pair.delta, unit)
    lines = [f"worst test of those run{f', {test}' if test else ''}: Δρ {delta}{_rho(where)}"]
    window = where.pair.window
    if where.pair.delta and window is None:
        part = round(100 * where.pair.ended / where.pair.delta)
        lines.append(
            f"{part} % of it comes from the end of a trace: {where.pair.reason or 'one trace ends before the other'}"
        )
    elif where.pair.delta and window is not None:
        part = round(100 * window.delta / where.pair.delta)
        lines.append(f"{part} % of it arises {Place(ValueRange(window.begin, window.end))}")
    credit = {name: float(values.sum()) for name, values in where.pair.credit.items()}
    if credit and window is not None:
        name = max(credit, key=lambda n: abs(credit[n]))
        lines.append(f"most of it comes from {name} ({signed_quantity(credit[name], unit)})")
    if where.pair.switch is not None:
        lines.append(str(where.pair.switch))
    if where.space is not None:
        place = test_words(where.space.worst, spec.space.units)
        expected = format_estimate(*vars(where.space.largest).values())
        lines.append(f"worst test of the whole space is probably {place}: expected |Δρ| {expected} at 95 %")
    return tuple(lines)


def _rho(where: Where) -> str:
    """Return ρ of both rollouts at the worst test; "" where it is not the margin of one predicate."""
    pair, switch = where.pair, where.pair.switch
    if switch is None:
        return ""
    simulated, real = switch.simulated.simulated, switch.real.real
    if not math.isclose(real - simulated, pair.delta, rel_tol=1e-6, abs_tol=1e-12):
        return ""
    own, other = signed_quantity(simulated, pair.unit), signed_quantity(real, pair.unit)
    return f" (ρ {own} in simulation, {other} on the real machine)"


def body_words(where: Where) -> tuple[str, ...]:
    """Return one sentence for each part whose residuals the nominal model does not explain, the cause's place first."""
    if where.body is None:
        return (str(where.no_body),)
    body, origin = where.body, where.body.origin
    if origin is None:
        return (
            f"the nominal model explains the residuals of every part of the machine ({body.asked} comparisons)",
        )
    shown = [(part, part.shifts[0]) for part in body.shifted[:FIRST]]
    if origin[0] not in body.shifted[:FIRST]:
        shown.append(origin)  # where the next step looks first
    ordered = cause_first(shown, lambda one: body.place(*one), lambda one: one[1].sigma)
    return tuple(
        f"{body.place(part, shift)}: {amount(shift)}, unexplained by the nominal model"
        for part, shift in ordered
    )


def left_words(left: Sequence[Remainder]) -> tuple[str, ...]:
    """Return one sentence for each remainder of the motion that no effect explains."""
    if not left:
        return ()
    unexplained = [f"{each}, which no effect explains{_at(each)}" for each in left if each.material]
    return tuple(unexplained[:FIRST]) or (largest_rest_words(left[0]),)


def largest_rest_words(largest: Remainder) -> str:
    """Return the place of the largest remainder, with its part of what small effects may leave."""
    part = _part_of(largest.surplus, 1.0)
    return f"largest rest of the motion is {largest}, {part} of what small effects may leave{_at(largest)}"


def _at(one: Remainder) -> str:
    return "" if one.frequency is None else f"; most of it is at {one.frequency:.2g} Hz"


def shrink_rows(far: HeldOutGap) -> tuple[tuple[str, str], ...]:
    """Return (name, text) rows: the gap before and after, the floor, and the closed part."""
    scale = _scale(far)
    rows = [("before", _gap(far.before, scale))]
    if far.after is not None:
        rows.append(("after", _gap(far.after, scale)))
    rows.append(("floor", f"{scale.number(far.floor, 0.3 * far.floor)} (scatter alone)"))
    for name, part, words in (
        ("closed", far.share, "of the gap above the floor"),
        ("tuned", far.tuned_share, "with small amounts of every other effect"),
    ):
        if part is not None:
            value, low, high = (round(100 * end) for end in (part.estimate, part.low, part.high))
            more = "; more than 100 % is scatter" if value > 100 else ""
            rows.append((name, f"{value} % {words} (95 %: {low} to {high} %{more})"))
    return tuple(rows)


def gap_title(far: HeldOutGap) -> str:
    """Return the title of :func:`shrink_rows`, with their unit."""
    unit = _scale(far).unit
    return f"gap on {far.rollouts} held-out rollouts, mean |ρ_real − ρ_sim|{f' in {unit}' if unit else ''}"


def gap_and_limit_words(far: HeldOutGap) -> tuple[str, str]:
    """Return the mean gap over the held-out tests, and the largest that is not material, so that they differ."""
    between = abs(far.before.mean - far.at_most)
    return quantity(far.before.mean, far.unit, between), quantity(far.at_most, far.unit, between)


def _scale(far: HeldOutGap) -> Scale:
    return Scale.of(max(far.before.mean, far.before.worst), far.unit)


def _gap(gap: Gap, scale: Scale) -> str:
    half = (gap.high - gap.low) / 2
    mean, low, high, worst = (scale.number(value, half) for value in (gap.mean, gap.low, gap.high, gap.worst))
    return f"{mean} (95 %: {low} to {high}), {worst} at the worst test"


def place_words(left: Sequence[Remainder], where: Where | None) -> str:
    """Return the place to look at: where most of the motion is left, the part where a shift begins, or a time."""
    if left:
        return f" that explains {left[0]}"
    if where is None:
        return ""
    if where.body is not None and (origin := where.body.origin) is not None:
        return f" that acts {where.body.place(*origin)} ({origin[1].channel})"
    window = where.pair.window
    if window is None:
        return f" before the end of the trace ({where.pair.reason})" if where.pair.reason else ""
    times = where.pair.times
    if window.end - times[0] > LATE * (times[-1] - times[0]):
        return ""  # a cause before the end is every cause
    # ρ is decided where a requirement is nearest to its limit; feedback carries earlier disturbances there.
    return (
        f" that acts before or while most of the gap arises ({Place(ValueRange(window.begin, window.end))})"
    )


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
    words = " or ".join(f"{side} {_crossing(end, one.axis.unit)}" for side, end in sides if end is not None)
    return words or f"at no size from {interval(*one.simulated, one.axis.unit, exact=True)}"


def _crossing(end: Crossing, unit: str) -> str:
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
