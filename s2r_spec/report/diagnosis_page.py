"""A diagnosis as one HTML page that opens offline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from s2r_spec.attribution.attribute import FormulaShare
from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.diagnose.gap.held_out import HeldOutGap
from s2r_spec.diagnose.gap.where import Where
from s2r_spec.report.diagnosis import SizeRow, describe
from s2r_spec.report.figures.blame import blame
from s2r_spec.report.figures.canvas import Picture
from s2r_spec.report.figures.robot import amount, robot
from s2r_spec.report.figures.shrink import before_and_after, over_space
from s2r_spec.report.html import fill
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class BarRow:
    """A row with a bar; positions in percent of the line."""

    label: str
    left: float
    width: float
    words: str
    tone: str = ""


def render(diagnosis: Diagnosis, spec: Spec, real: str = "") -> str:
    """Return the page: the same bytes for the same diagnosis.

    Args:
        diagnosis: the diagnosis.
        spec: specification of the diagnosed requirement.
        real: name of the real machine, ``twin:lab``; "" for rollouts without a name.

    Raises:
        UsageError: a package is missing.
    """
    words, where, far = describe(diagnosis, spec), diagnosis.where, diagnosis.how_far
    return fill(
        "diagnosis.html",
        diagnosis=diagnosis,
        words=words,
        about=about(diagnosis.provenance, spec, real),
        reason=unbreak(diagnosis.reason),
        next=unbreak(words.next),
        bars=on_a_line(words.sizes),
        space=space(where, far),
        held_out=held_out(where, far, spec),
        trace=None if where is None else blame(where, spec, "trace"),
        formula=() if where is None else formula(where.pair.parts, where.pair.delta),
        formula_unit="" if where is None else where.pair.unit,
        body=body(where),
        shifts=shifts(where),
        sources=flatten(diagnosis.provenance),
        spec_text=spec.text,
        version=str(diagnosis.provenance.get("s2r", "")),
    )


def on_a_line(rows: tuple[SizeRow, ...]) -> list[BarRow]:
    """Return the interval of every size as a bar on one line of typical sizes; its words are the place of the value."""
    ends = [end for row in rows for end in (row.parameter.size_low, row.parameter.size_high)]
    low, high = min([0.0, *ends]), max([1.0, *ends])

    def place(size: float) -> float:
        return percent((size - low) / (high - low))

    bars = []
    for p in (row.parameter for row in rows):
        left = place(p.size_low)
        bars.append(BarRow("", left, max(place(p.size_high) - left, 0.5), f"{place(p.size)}"))
    return bars


def formula(parts: tuple[FormulaShare, ...], delta: float) -> tuple[BarRow, ...]:
    """Return a bar for the part of Δρ of each sub-formula, indented by its depth."""
    most = max((abs(part.amount) for part in parts), default=0.0)
    bars = []
    for part in parts:
        if most > 0 and abs(part.amount) > 1e-3 * most:
            share = f", {100 * part.amount / delta:.0f} %" if delta else ""
            label = "\u2003" * part.depth + (f"{part.name}: " if part.name else "") + part.text
            bars.append(
                BarRow(
                    label, 0.0, percent(abs(part.amount) / most), f"{part.amount:+.3g}{share}",
                    "worse" if part.amount < 0 else "better",
                )
            )  # fmt: skip
    return tuple(bars)


def unbreak(sentence: str) -> str:
    """Keep numbers and their percent signs on one line."""
    return sentence.replace(" %", "\u00a0%")


def percent(part: float) -> float:
    """Return a part of a line in percent."""
    return round(100.0 * min(max(part, 0.0), 1.0), 2)


def about(provenance: Mapping[str, Any], spec: Spec, real: str) -> str:
    """Return the requirement, the simulator, the machine and the rollouts in one line."""
    p = provenance
    against = f" against {real}" if real else ""
    return (
        f"{PurePath(spec.name).name}, requirement {p['requirement']}: {p['backend']}{against}, "
        f"{p['rollouts']} real rollouts, {p['held_out']} of them held out"
    )


def space(where: Where | None, far: HeldOutGap | None) -> Picture | None:
    """Return the gap over the test space."""
    return None if where is None or where.space is None else over_space(where.space, far, "space")


def held_out(where: Where | None, far: HeldOutGap | None, spec: Spec) -> Picture | None:
    """Return the gap of each held-out test; None where the picture over one parameter shows it already."""
    over = None if where is None else where.space
    if far is None or not far.tests or (over is not None and over.space.dim == 1):
        return None
    return before_and_after(far, spec.space.units, "held")


def body(where: Where | None) -> Picture | None:
    """Return the parts of the machine; None where their motion was not compared."""
    return None if where is None or where.body is None else robot(where.body, "robot")


def shifts(where: Where | None) -> list[tuple[str, str, str]]:
    """Return the place, the residual with its size, and the adjusted p-value of every significant shift."""
    if where is None or where.body is None:
        return []
    body = where.body
    return [
        (str(body.place(part, shift)), amount(shift), f"p = {shift.adjusted:.1g}, adjusted for all tests")
        for part in body.shifted
        for shift in part.shifts
    ]


def flatten(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return nested values as rows of names and words."""
    rows: list[tuple[str, str]] = []
    for name, value in values.items():
        if isinstance(value, Mapping):
            rows += flatten(value, f"{prefix}{name}: ")
        else:
            rows.append((f"{prefix}{name}", str(value)))
    return rows
