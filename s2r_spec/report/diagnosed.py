"""A diagnosis as text, as one JSON object, and the words that all of its forms share."""

from __future__ import annotations

import json
from typing import cast

from rich.markup import escape
from rich.text import Text

from s2r_spec.backend import short
from s2r_spec.diagnose.diagnosis import Diagnosis, Verdict, Which
from s2r_spec.diagnose.how_far import Gap, HowFar
from s2r_spec.diagnose.where.found import Where
from s2r_spec.json_objects.diagnosis import DiagnosisObject
from s2r_spec.printable import one_line
from s2r_spec.report.checked import test_words
from s2r_spec.report.figures.robot import said
from s2r_spec.report.nextstep import next_step
from s2r_spec.spec import Spec

COLOURS = {
    Verdict.NONE: "bold green",
    Verdict.SPREAD: "bold yellow",
    Verdict.NAMED: "bold green",
    Verdict.CONFOUNDED: "bold yellow",
    Verdict.UNKNOWN: "bold yellow",
}
EXIT = {Verdict.NONE: 0, Verdict.NAMED: 0, Verdict.SPREAD: 3, Verdict.CONFOUNDED: 3, Verdict.UNKNOWN: 3}
"""A diagnosis has no verdict on the machine: 0 says that a cause (or none) is named, 3 that it is not."""
SHOWN = 5
"""Ranked causes that are printed."""
PARTS = 3
"""Parts of the machine that are told of."""
WORDS = {"none": "no material effect", "unknown": "none of these"}


def record(found: Diagnosis, spec: Spec) -> DiagnosisObject:
    """Return all of it as plain JSON values."""
    more = {"exit_code": exit_code(found), "next": next_step(found, spec)}
    return cast(DiagnosisObject, found.to_json() | more)


def exit_code(found: Diagnosis) -> int:
    """Return 0 where a cause, or none, is named, and the recordings do not seem to be misread; else 3."""
    return EXIT[Verdict.UNKNOWN] if found.misread else EXIT[found.verdict]


def as_json(found: Diagnosis, spec: Spec) -> str:
    """Return the record as text; no NaN and no infinity ever gets in."""
    return json.dumps(record(found, spec), allow_nan=False, indent=2, ensure_ascii=False)


def text(found: Diagnosis, spec: Spec) -> str:
    """Return plain text."""
    return Text.from_markup(markup(found, spec)).plain


def markup(found: Diagnosis, spec: Spec) -> str:
    """Return rich markup: what is wrong with the recordings first, then the answer, then what it stands on."""
    first = "".join(f"{escape(one_line(f'note: {each.text}'))}\n" for each in found.findings)
    headline = f"[{COLOURS[found.verdict]}]{found.verdict.value.upper()}[/]  {escape(one_line(found.reason))}"
    return f"{first}{headline}\n{escape(body(found, spec))}"


def body(found: Diagnosis, spec: Spec) -> str:
    """Return all but the answer and what is said before it, as plain text."""
    said = {each.text for each in found.findings}
    notes = [f"  note: {line}" for line in found.notes if line not in said]
    lines = [*notes, "", *_causes(found.which)]
    if found.where is not None:
        lines += ["", *_where(found, found.where, spec)]
    if found.how_far is not None:
        lines += ["", *_shrinks(found.how_far)]
    lines += ["", f"  next: {next_step(found, spec)}", ""]
    lines += [f"  - {line}" for line in found.assumptions]
    return "\n".join(map(one_line, [*lines, "", f"  {provenance(found)}"]))


def provenance(found: Diagnosis) -> str:
    """Return what fixes the answer, in one line."""
    p = found.provenance
    return (
        f"{p['rollouts']} real rollouts, {p['held_out']} of them held out, seed {p['seed']}, "
        f"backend {p['backend']}, model {short(str(p['model_hash']))}"
    )


def cause(names: tuple[str, ...]) -> str:
    """Return a ranked answer in words."""
    return WORDS.get(names[0], " + ".join(names))


def _causes(which: Which) -> list[str]:
    lines = [f"  {'cause':42} probability"]
    lines += [f"  {cause(names):42} {p:.3f}" for names, p in which.ranked[:SHOWN]]
    if which.estimates:
        lines += ["", "  fitted (90 % interval)"]
        for e in which.estimates:
            value = f"{e.value:.4g} {e.unit}".rstrip()
            lines.append(f"  {f'{e.effect}.{e.parameter}':42} {value}  [{e.low:.4g}, {e.high:.4g}]")
    if words := doubt(which):
        lines += ["", f"  {words}"]
    return lines


def doubt(which: Which) -> str:
    """Return what cannot be told apart, and what of it by no data; nothing if the answer stands alone."""
    if not set(which.confounded) > set(which.answer) != set():
        return ""
    if len(which.answer) == 1 and set(which.instead) | set(which.answer) == set(which.confounded):
        words = f"these data cannot tell apart: {', '.join(which.confounded)}"
    else:
        others = ", ".join(name for name in which.confounded if name not in which.answer)
        words = f"these data do not rule out: {others}"
    kinds = ", ".join(f"{a} and {b}" for a, b in which.isolability.kinds(which.confounded))
    return (
        f"{words}; a law a little off makes {kinds} the same in these tests, however many" if kinds else words
    )


def where_words(where: Where, spec: Spec) -> tuple[str, ...]:
    """Return sentences: how large, when, in which channel, by which predicate."""
    unit = where.pair.unit
    test = test_words(where.test, spec.space.units) or "there is but one"
    lines = [f"worst of the tests that were run, {test}: Δρ {where.pair.delta:+.3g} {unit}".rstrip()]
    window = where.window
    if where.pair.delta and window is None:
        part = round(100 * where.pair.ended / where.pair.delta)
        lines.append(
            f"{part} % of it is in no window of time: {where.pair.reason or 'one trace ends before the other'}"
        )
    elif where.pair.delta and window is not None:
        part = round(100 * window["delta"] / where.pair.delta)
        lines.append(f"{part} % of it from {window['begin']:.2f} to {window['end']:.2f} s")
    credit = {name: float(values.sum()) for name, values in where.pair.credit.items()}
    if credit and window is not None:
        name = max(credit, key=lambda n: abs(credit[n]))
        lines.append(f"most of it in {name} ({credit[name]:+.3g} {unit})".replace(" )", ")"))
    if where.pair.switch is not None:
        lines.append(str(where.pair.switch))
    if where.space is not None:
        place = test_words(where.space.worst, spec.space.units)
        size, low, high = where.space.largest
        expected = f"{size:.3g} [{low:.3g}, {high:.3g}] {where.space.unit}".rstrip()
        lines.append(f"worst of the whole test space is likely {place}: expected |Δρ| {expected}")
    return tuple(lines)


def body_words(where: Where) -> tuple[str, ...]:
    """Return sentences: which parts of the machine show what their model does not explain."""
    if where.body is None:
        return (where.no_body,)
    most = where.body.most
    if most is None:
        return (
            f"no part of the machine does what its model does not explain ({where.body.asked} questions)",
        )
    told = [(part, part.shifts[0]) for part in where.body.shifted[:PARTS]]
    if most[0] not in where.body.shifted[:PARTS]:
        told.append(most)  # where the next step looks first
    return tuple(
        f"{part.name}: {said(shift)}, which the nominal model does not explain" for part, shift in told
    )


def left_words(found: Diagnosis) -> tuple[str, ...]:
    """Return sentences: what no effect explains of the motion, and where."""
    if not found.left:
        return ()
    told = [f"{each}, which no effect explains" for each in found.left if each.material]
    return tuple(told[:PARTS]) or (
        "nothing is left of the motion that a simulator with what fits best does not leave, too",
    )


def _where(found: Diagnosis, where: Where, spec: Spec) -> list[str]:
    first, *rest = (*where_words(where, spec), *body_words(where), *left_words(found))
    return [f"  where: {first}", *(f"    {line}" for line in rest)]


def shrink_rows(far: HowFar) -> tuple[tuple[str, str], ...]:
    """Return (name, text) rows."""
    rows = [("before", _gap(far.before))]
    if far.after is not None:
        rows.append(("after", _gap(far.after)))
    rows.append(("floor", f"{far.floor:.3g} (scatter alone)"))
    for name, part, words in (
        ("closed", far.share, "of what lies above the floor"),
        ("tuned", far.tuned_share, "with a little of every other effect as well"),
    ):
        if part is not None:
            value, low, high = (round(100 * end) for end in part)
            more = "; more than 100 % is scatter" if value > 100 else ""
            rows.append((name, f"{value} % {words} (95 %: {low} to {high} %{more})"))
    return tuple(rows)


def gap_title(far: HowFar) -> str:
    """Return what the rows are of."""
    unit = f" in {far.unit}" if far.unit else ""
    return f"gap on {far.rollouts} held-out rollouts, mean |ρ_real − ρ_sim|{unit}"


def _shrinks(far: HowFar) -> list[str]:
    return [f"  {gap_title(far)}", *(f"    {name:6} {words}" for name, words in shrink_rows(far))]


def _gap(gap: Gap) -> str:
    return (
        f"{gap.mean:.3g} (95 %: {gap.low:.3g} to {gap.high:.3g}), mean Δρ at the worst test {gap.worst:.3g}"
    )
