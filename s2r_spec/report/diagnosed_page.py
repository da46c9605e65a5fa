"""A diagnosis as one HTML page that opens offline."""

from __future__ import annotations

from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.diagnose.estimate import Estimate
from s2r_spec.printable import spelled
from s2r_spec.report.answered_page import (
    Bar,
    about,
    body,
    flat,
    formula,
    held_out,
    percent,
    shifts,
    space,
    unbroken,
)
from s2r_spec.report.diagnosed import Description, describe
from s2r_spec.report.figures.blame import blame
from s2r_spec.report.figures.isolation import isolation
from s2r_spec.report.html import fill
from s2r_spec.spec import Spec

SHOWN = 8
"""Definition: causes that get a bar, most probable first."""
_LEAST = 0.0005


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
        about=about(found.provenance, spec, real),
        reason=unbroken(found.reason),
        next=unbroken(words.next),
        causes=causes(words),
        bars=[_on_a_line(e) for e in found.which.estimates],
        space=space(found.where, found.how_far),
        held_out=held_out(found.where, found.how_far, spec),
        trace=None if found.where is None else blame(found.where, spec, "trace"),
        formula=() if found.where is None else formula(found.where.pair.parts, found.where.pair.delta),
        formula_unit="" if found.where is None else found.where.pair.unit,
        body=body(found.where),
        shifts=shifts(found.where),
        isolation=isolation(found.which.isolability, found.which.answer, "isolation"),
        least=_least(found),
        sources=flat(found.provenance),
        spec_text=spec.text,
        version=str(found.provenance.get("s2r", "")),
    )


def causes(words: Description) -> tuple[Bar, ...]:
    """Return a bar for each of the most probable causes, and one for the sum of all others."""
    shown = [one for one in words.causes[:SHOWN] if one[1] >= _LEAST]
    bars = [Bar(cause, 0.0, percent(p), _odds(p)) for cause, p in shown]
    others = words.causes[len(shown) :]
    left = sum(p for _, p in others)
    if left >= _LEAST:
        bars.append(Bar(f"{len(others)} others together", 0.0, percent(left), _odds(left), "quiet"))
    return tuple(bars)


def _odds(p: float) -> str:
    return f"{100 * p:.1f} %"


def _on_a_line(e: Estimate) -> Bar:
    """Return the interval of a parameter as a bar; its words are the place of the value."""
    low, high = min(e.low, e.value, 0.0 if e.low >= 0 else e.low), max(e.high, e.value)
    span = (high - low) or 1.0
    low, high = low - 0.06 * span * (low != 0.0), high + 0.06 * span
    place = [percent((x - low) / (high - low)) for x in (e.low, e.high, e.value)]
    return Bar("", place[0], max(place[1] - place[0], 0.5), f"{place[2]}")


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
