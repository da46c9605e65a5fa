"""A diagnosis as one HTML page that opens offline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from s2r_spec.attribution.attribute import Part
from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.diagnose.estimate import Estimate
from s2r_spec.printable import spelled
from s2r_spec.report.diagnosed import Description, describe
from s2r_spec.report.figures.blame import blame
from s2r_spec.report.figures.canvas import Picture
from s2r_spec.report.figures.isolation import isolation
from s2r_spec.report.figures.robot import amount, robot
from s2r_spec.report.figures.shrink import before_and_after, over_space
from s2r_spec.report.html import fill
from s2r_spec.spec import Spec

SHOWN = 8
"""Definition: causes that get a bar, most probable first."""
_LEAST = 0.0005


@dataclass(frozen=True)
class Bar:
    """A row with a bar; positions in percent of the line."""

    label: str
    left: float
    width: float
    words: str
    tone: str = ""


def render(found: Diagnosis, spec: Spec, real: str = "") -> str:
    """Return the page: the same bytes for the same diagnosis.

    Args:
        found: the diagnosis.
        spec: specification of the diagnosed requirement.
        real: name of the real machine, ``twin:lab``; "" for rollouts without a name.

    Raises:
        UsageError: a package is missing.
    """
    words = describe(found, spec)
    return fill(
        "diagnosis.html",
        found=found,
        words=words,
        about=_about(found, spec, real),
        reason=_unbroken(found.reason),
        next=_unbroken(words.next),
        causes=causes(words),
        bars=[_on_a_line(e) for e in found.which.estimates],
        space=_space(found),
        held_out=_held_out(found, spec),
        trace=None if found.where is None else blame(found.where, spec, "trace"),
        formula=() if found.where is None else formula(found.where.pair.parts, found.where.pair.delta),
        formula_unit="" if found.where is None else found.where.pair.unit,
        body=_body(found),
        shifts=_shifts(found),
        isolation=isolation(found.which.isolability, found.which.answer, "isolation"),
        least=_least(found),
        sources=_flat(found.provenance),
        spec_text=spec.text,
        version=str(found.provenance.get("s2r", "")),
    )


def causes(words: Description) -> tuple[Bar, ...]:
    """Return a bar for each of the most probable causes, and one for the sum of all others."""
    shown = [one for one in words.causes[:SHOWN] if one[1] >= _LEAST]
    bars = [Bar(cause, 0.0, _percent(p), _odds(p)) for cause, p in shown]
    others = words.causes[len(shown) :]
    left = sum(p for _, p in others)
    if left >= _LEAST:
        bars.append(Bar(f"{len(others)} others together", 0.0, _percent(left), _odds(left), "quiet"))
    return tuple(bars)


def formula(parts: tuple[Part, ...], delta: float) -> tuple[Bar, ...]:
    """Return a bar for the part of Δρ of each sub-formula, indented by its depth."""
    most = max((abs(part.amount) for part in parts), default=0.0)
    bars = []
    for part in parts:
        if most > 0 and abs(part.amount) > 1e-3 * most:
            share = f", {100 * part.amount / delta:.0f} %" if delta else ""
            label = "\u2003" * part.depth + (f"{part.name}: " if part.name else "") + part.text
            bars.append(
                Bar(
                    label, 0.0, _percent(abs(part.amount) / most), f"{part.amount:+.3g}{share}",
                    "worse" if part.amount < 0 else "better",
                )
            )  # fmt: skip
    return tuple(bars)


def _unbroken(sentence: str) -> str:
    """Keep numbers and their percent signs on one line."""
    return sentence.replace(" %", "\u00a0%")


def _percent(part: float) -> float:
    return round(100.0 * min(max(part, 0.0), 1.0), 2)


def _odds(p: float) -> str:
    return f"{100 * p:.1f} %"


def _about(found: Diagnosis, spec: Spec, real: str) -> str:
    p = found.provenance
    against = f" against {real}" if real else ""
    return (
        f"{PurePath(spec.name).name}, requirement {p['requirement']}: {p['backend']}{against}, "
        f"{p['rollouts']} real rollouts, {p['held_out']} of them held out"
    )


def _on_a_line(e: Estimate) -> Bar:
    """Return the interval of a parameter as a bar; its words are the place of the value."""
    low, high = min(e.low, e.value, 0.0 if e.low >= 0 else e.low), max(e.high, e.value)
    span = (high - low) or 1.0
    low, high = low - 0.06 * span * (low != 0.0), high + 0.06 * span
    place = [_percent((x - low) / (high - low)) for x in (e.low, e.high, e.value)]
    return Bar("", place[0], max(place[1] - place[0], 0.5), f"{place[2]}")


def _space(found: Diagnosis) -> Picture | None:
    if found.where is None or found.where.space is None:
        return None
    return over_space(found.where.space, found.how_far, "space")


def _held_out(found: Diagnosis, spec: Spec) -> Picture | None:
    """Return the gap of each held-out test; None where the picture over one parameter shows it already."""
    space = None if found.where is None else found.where.space
    if found.how_far is None or not found.how_far.tests or (space is not None and space.space.dim == 1):
        return None
    return before_and_after(found.how_far, spec.space.units, "held")


def _body(found: Diagnosis) -> Picture | None:
    if found.where is None or found.where.body is None:
        return None
    return robot(found.where.body, "robot")


def _shifts(found: Diagnosis) -> list[tuple[str, str, str]]:
    """Return the place, the residual with its size, and the adjusted p-value of every significant shift."""
    if found.where is None or found.where.body is None:
        return []
    body = found.where.body
    return [
        (str(body.place(part, shift)), amount(shift), f"p = {shift.adjusted:.1g}, adjusted for all tests")
        for part in body.shifted
        for shift in part.shifts
    ]


def _least(found: Diagnosis) -> list[tuple[str, str, str]]:
    """Return parameter, nominal value, and the values at which these tests separate it from every other effect."""
    rows = []
    for one in found.which.isolability.least:
        unit = f" {spelled(one.unit)}" if one.unit else ""
        words = [f"{one.below:.3g}{unit} or less"] if one.below is not None else []
        words += [f"{one.above:.3g}{unit} or more"] if one.above is not None else []
        sizes = " and ".join(words) or "at none of the tried sizes"
        rows.append((f"{one.effect}.{one.parameter}", f"{one.nominal:.3g}{unit}", sizes))
    return rows


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for name, value in values.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f"{prefix}{name}: ")
        else:
            rows.append((f"{prefix}{name}", str(value)))
    return rows
