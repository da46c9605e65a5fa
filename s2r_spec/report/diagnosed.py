"""A diagnosis as text and as one JSON object, and the sentences that every form of it contains."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import cast

from rich.markup import escape
from rich.text import Text

from s2r_spec.backend import short
from s2r_spec.diagnose.diagnosis import Diagnosis, Verdict, Which
from s2r_spec.diagnose.estimate import Estimate
from s2r_spec.json_objects.diagnosis import DiagnosisObject
from s2r_spec.printable import one_line
from s2r_spec.quantity import interval, measured, quantity
from s2r_spec.report.gap_words import body_words, gap_title, left_words, listed, shrink_rows, where_words
from s2r_spec.report.materiality import matters_words
from s2r_spec.report.nextstep import next_step
from s2r_spec.report.text import STYLES
from s2r_spec.spec import Spec

SHOWN = 5
"""Definition: causes that are printed, most probable first."""
WORDS = {"none": "no material effect", "unknown": "none of these"}


@dataclass(frozen=True)
class Description:
    """What every form of a diagnosis says; a form adds its layout and its figures.

    Attributes:
        mistakes: sentences on suspected mistakes of the recordings.
        notes: other sentences on the recordings.
        matters: sentences on whether the gap matters; none for a diagnosis without that test.
        where: sentences on the worst test; none if the place of the gap was not asked for.
        parts: sentences on the parts of the machine, and on motion that no effect explains.
        causes: (cause, probability), most probable first.
        estimates: (parameter, value with its interval, value, 90 % interval).
        doubt: which effects the data do not separate; "" for none.
        gap_title: the title of ``gap``.
        gap: (name, text) rows on the gap of held-out rollouts; none without such rollouts.
        next: the next step.
        provenance: rollouts, seed, backend and model hash.
    """

    mistakes: tuple[str, ...]
    notes: tuple[str, ...]
    matters: tuple[str, ...]
    where: tuple[str, ...]
    parts: tuple[str, ...]
    causes: tuple[tuple[str, float], ...]
    estimates: tuple[tuple[str, str, str, str], ...]
    doubt: str
    gap_title: str
    gap: tuple[tuple[str, str], ...]
    next: str
    provenance: str


def describe(found: Diagnosis, spec: Spec) -> Description:
    """Return what every form of a diagnosis says."""
    which, where, far = found.which, found.where, found.how_far
    mistakes = tuple(each.text for each in found.findings)
    return Description(
        mistakes=mistakes,
        notes=tuple(note for note in found.notes if note not in mistakes),
        matters=() if found.materiality is None else matters_words(found.materiality, spec.space.units),
        where=() if where is None else where_words(where, spec),
        parts=() if where is None else (*body_words(where), *left_words(found.left)),
        causes=tuple((WORDS.get(names[0], " + ".join(names)), p) for names, p in which.ranked),
        estimates=tuple(map(_estimate, which.estimates)),
        doubt=doubt(which),
        gap_title="" if far is None else gap_title(far),
        gap=() if far is None else shrink_rows(far),
        next=next_step(found, spec),
        provenance=provenance(found),
    )


def record(found: Diagnosis, spec: Spec) -> DiagnosisObject:
    """Return the whole diagnosis as plain JSON values."""
    more = {"exit_code": exit_code(found), "next": next_step(found, spec)}
    return cast(DiagnosisObject, found.to_json() | more)


def exit_code(found: Diagnosis) -> int:
    """Return 0 if the verdict is a cause or no material gap, and the recordings have no suspected mistake; else 3."""
    return (Verdict.UNKNOWN if found.misread else found.verdict).exit_code


def as_json(found: Diagnosis, spec: Spec) -> str:
    """Return the record as JSON text; NaN and infinity raise ``ValueError``."""
    return json.dumps(record(found, spec), allow_nan=False, indent=2, ensure_ascii=False)


def text(found: Diagnosis, spec: Spec) -> str:
    """Return plain text."""
    return Text.from_markup(markup(found, spec)).plain


def markup(found: Diagnosis, spec: Spec) -> str:
    """Return rich markup: mistakes of the recordings, the answer, then its details."""
    first = "".join(f"{escape(one_line(f'note: {each.text}'))}\n" for each in found.findings)
    headline = (
        f"[{STYLES[found.verdict.tone]}]{found.verdict.value.upper()}[/]  {escape(one_line(found.reason))}"
    )
    return f"{first}{headline}\n{escape(body(found, spec))}"


def body(found: Diagnosis, spec: Spec) -> str:
    """Return where the gap lies, which effects cause it, how far it shrinks, and what to do next, as plain text."""
    words = describe(found, spec)
    lines = [f"  {line}" for line in words.matters] + [f"  note: {line}" for line in words.notes]
    if words.where:
        first, *rest = words.where + words.parts
        lines += ["", f"  where: {first}", *(f"    {line}" for line in rest)]
    lines += ["", f"  {'cause':42} probability"]
    lines += [f"  {cause:42} {p:.3f}" for cause, p in words.causes[:SHOWN]]
    if words.estimates:
        lines += ["", f"  {'parameter':42} value (90 %)"]
        lines += [f"  {name:42} {value}" for name, value, *_ in words.estimates]
    if words.doubt:
        lines += ["", f"  {words.doubt}"]
    if words.gap:
        lines += ["", f"  {words.gap_title}", *(f"    {name:6} {row}" for name, row in words.gap)]
    lines += ["", f"  next: {words.next}", "", *(f"  - {line}" for line in found.assumptions)]
    return "\n".join(map(one_line, [*lines, "", f"  {words.provenance}"]))


def provenance(found: Diagnosis) -> str:
    """Return the numbers of rollouts, the seed, the backend and the model hash in one line."""
    p = found.provenance
    return (
        f"{p['rollouts']} real rollouts, {p['held_out']} of them held out, seed {p['seed']}, "
        f"backend {p['backend']}, model {short(str(p['model_hash']))}"
    )


def _estimate(e: Estimate) -> tuple[str, str, str, str]:
    whole, ends = measured(e.value, e.low, e.high, e.unit), interval(e.low, e.high, e.unit)
    return f"{e.effect}.{e.parameter}", whole, quantity(e.value, e.unit, (e.high - e.low) / 2), ends


def doubt(which: Which) -> str:
    """Return which effects the data do not separate from the answer, and which no data would; "" for none."""
    if not set(which.confounded) > set(which.answer) != set():
        return ""
    if len(which.answer) == 1 and set(which.instead) | set(which.answer) == set(which.confounded):
        words = f"these data do not separate {listed(which.confounded)}"
    else:
        others = listed([name for name in which.confounded if name not in which.answer])
        words = f"these data do not rule out {others}"
    kinds = ", ".join(f"{a} and {b}" for a, b in which.isolability.kinds(which.confounded))
    return (
        f"{words}. More of these tests would not separate {kinds}: their laws are too similar"
        if kinds
        else words
    )
