"""A diagnosis as one HTML page that opens offline."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any

from s2r_spec.attribution.attribute import FormulaShare
from s2r_spec.base.quantity import signed_quantity
from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.diagnose.inference.estimates import Status
from s2r_spec.diagnose.residuals.shifts import Body
from s2r_spec.report.check import test_words
from s2r_spec.report.diagnosis import SizeRow, describe
from s2r_spec.report.figures.blame import blame
from s2r_spec.report.figures.breaking import breaking_picture
from s2r_spec.report.figures.film import film
from s2r_spec.report.figures.robot import amount, robot
from s2r_spec.report.figures.shrink import before_and_after, over_space
from s2r_spec.report.html import fill
from s2r_spec.spec import Spec

SHOWN = (Status.NAMED.value, Status.POSSIBLE.value)
"""Definition: effects whose parameters are shown at once; those of all others are folded."""


def render(diagnosis: Diagnosis, spec: Spec, real: str = "") -> str:
    """Return the page: the same bytes for the same diagnosis.

    ``real`` is the name of the real machine, ``twin:lab``; "" for rollouts without a name.

    Raises:
        UsageError: a package is missing.
    """
    words, where, far = describe(diagnosis, spec), diagnosis.where, diagnosis.how_far
    p, against = diagnosis.provenance, f" against {real}" if real else ""
    pair = None if where is None else where.pair
    over = None if where is None else where.space
    body = None if where is None else where.body
    # The picture over one parameter shows the held-out tests already.
    shown = far is None or not far.tests or (over is not None and over.space.dim == 1)
    crossed = diagnosis.breaking
    sizes = list(zip(words.sizes, _on_a_line(words.sizes), strict=True))
    test = "" if where is None else test_words(where.test, spec.space.units)
    return fill(
        "diagnosis.html",
        diagnosis=diagnosis,
        words=words,
        about=(
            f"{PurePath(spec.name).name}, requirement {p['requirement']}: {p['backend']}{against}, "
            f"{p['rollouts']} real rollouts, {p['held_out']} of them held out"
        ),
        reason=diagnosis.reason,
        next=words.next,
        shown=[one for one in sizes if one[0].status in SHOWN],
        folded=[one for one in sizes if one[0].status not in SHOWN],
        film=None if where is None or where.traces is None else film(where.traces, test),
        breaking=breaking_picture(crossed, "breaking") if crossed and crossed.crossed else None,
        space=None if over is None else over_space(over, far, "space"),
        held_out=None if far is None or shown else before_and_after(far, spec.space.units, "held"),
        trace=None if where is None else blame(where, spec, "trace"),
        formula=() if pair is None else _formula(pair.parts, pair.delta, pair.unit),
        body=None if body is None else robot(body, "robot"),
        shifts=[] if body is None else _shifts(body),
        sources=list(_flatten(p)),
        spec_text=spec.text,
        version=str(p.get("s2r", "")),
    )


def _on_a_line(rows: tuple[SizeRow, ...]) -> list[tuple[float, float, float]]:
    """Return (left, width, value) of the interval of every size on one line of typical sizes, in percent of it."""
    ends = [end for row in rows for end in (row.parameter.size_low, row.parameter.size_high)]
    low, high = min([0.0, *ends]), max([1.0, *ends])
    places = [
        [_percent((size - low) / (high - low)) for size in (p.size_low, p.size_high, p.size)]
        for p in (row.parameter for row in rows)
    ]
    return [(left, max(right - left, 0.5), at) for left, right, at in places]


def _formula(parts: tuple[FormulaShare, ...], delta: float, unit: str) -> list[tuple[str, float, str, str]]:
    """Return (label, width, words, tone) of the part of Δρ of each sub-formula, indented by its depth."""
    most = max((abs(part.amount) for part in parts), default=0.0)
    rows = []
    for part in parts:
        if most > 0 and abs(part.amount) > 1e-3 * most:
            share = f", {100 * part.amount / delta:.0f} %" if delta else ""
            label = "\u2003" * part.depth + (f"{part.name}: " if part.name else "") + part.text
            words, tone = (
                f"{signed_quantity(part.amount, unit)}{share}",
                "worse" if part.amount < 0 else "better",
            )
            rows.append((label, _percent(abs(part.amount) / most), words, tone))
    return rows


def _percent(part: float) -> float:
    return round(100.0 * min(max(part, 0.0), 1.0), 2)


def _shifts(body: Body) -> list[tuple[str, str, str]]:
    """Return the place, the residual with its size, and the adjusted p-value of every significant shift."""
    return [
        (str(body.place(part, shift)), amount(shift), f"p = {shift.adjusted:.1g}, adjusted for all tests")
        for part in body.shifted
        for shift in part.shifts
    ]


def _flatten(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{name}: ")
        else:
            yield f"{prefix}{name}", str(value)
