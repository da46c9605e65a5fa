"""A diagnosis as text and as Markdown, and the sentences that every form of it contains."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rich.markup import escape
from rich.text import Text

from s2r_spec.backend import short
from s2r_spec.base.printable import one_line
from s2r_spec.base.quantity import format_estimate, interval, middle
from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.diagnose.gap.breaking import Breaking
from s2r_spec.diagnose.inference.estimates import (
    EffectEstimate,
    ParameterEstimate,
    Status,
    hidden_names,
    with_status,
)
from s2r_spec.report.advice import next_step, settled_words
from s2r_spec.report.gap_words import (
    body_words,
    breaking_cell,
    breaking_title,
    breaking_words,
    gap_title,
    join_names,
    left_words,
    matters_words,
    shrink_rows,
    where_words,
)
from s2r_spec.report.markdown import cell
from s2r_spec.report.text import STYLES
from s2r_spec.spec import Spec


@dataclass(frozen=True)
class SizeRow:
    """The estimate of one parameter of an effect, in words and as numbers.

    Attributes:
        whole: value and interval of 90 %.
        size: in typical sizes, with its interval.
        probability: that the effect is at least a quarter of typical.
        breaks: at which size the requirement breaks; "" where this is not known.
    """

    name: str
    value: str
    interval: str
    whole: str
    size: str
    probability: str
    status: str
    breaks: str
    parameter: ParameterEstimate


@dataclass(frozen=True)
class Description:
    """What every form of a diagnosis says; a form adds its layout and its figures.

    Attributes:
        passive: what tests of the specification alone cannot tell; "" where protocols were run, or nothing is hidden.
        mistakes: sentences on suspected mistakes of the recordings.
        notes: other sentences on the recordings.
        possible: (effect, its size, its probability, and the experiment that would settle it).
        ruled_out: names of effects; "" for none.
        hidden: names of the effects that the data do not show; "" for none.
        breaks: head of the column of breaking sizes; "" without them.
        breaking: the effects that break the requirement first, in a sentence; "" without them.
        sizes: of every parameter of the catalogue: named, possible, ruled out.
        gap: (name, text) rows on the gap of held-out rollouts; none without such rollouts.
        where: sentences on the worst test; none if the place of the gap was not asked for.
        parts: sentences on the parts of the machine, and on motion that no effect explains.
        provenance: rollouts, seed, backend and model hash.
    """

    passive: str
    mistakes: tuple[str, ...]
    notes: tuple[str, ...]
    matters: tuple[str, ...]
    named: tuple[SizeRow, ...]
    possible: tuple[tuple[str, str], ...]
    ruled_out: str
    hidden: str
    breaks: str
    breaking: str
    sizes: tuple[SizeRow, ...]
    gap_title: str
    gap: tuple[tuple[str, str], ...]
    where: tuple[str, ...]
    parts: tuple[str, ...]
    next: str
    provenance: str


def describe(diagnosis: Diagnosis, spec: Spec) -> Description:
    """Return what every form of a diagnosis says."""
    which, where, far, p = diagnosis.which, diagnosis.where, diagnosis.how_far, diagnosis.provenance
    mistakes = tuple(each.text for each in diagnosis.evidence.findings)
    by_status = {status: with_status(which.effects, status) for status in Status}
    settled = {one.effect: settled_words(one, spec) for one in which.evidence.separations}
    names = {status: join_names(sorted(one.effect for one in of)) for status, of in by_status.items()}
    return Description(
        passive=_passive_words(diagnosis),
        mistakes=mistakes,
        notes=tuple(note for note in diagnosis.notes if note not in mistakes),
        matters=matters_words(diagnosis.materiality, spec.space.units),
        named=_rows(by_status[Status.NAMED], diagnosis.breaking),
        possible=tuple(
            (one.effect, "; ".join(filter(None, (_size_words(one), settled.get(one.effect)))))
            for one in by_status[Status.POSSIBLE]
        ),
        ruled_out=names[Status.RULED_OUT],
        hidden=names[Status.HIDDEN],
        breaks=breaking_title(diagnosis.breaking),
        breaking=breaking_words(diagnosis.breaking, spec.space.units),
        sizes=_rows((one for status in Status for one in by_status[status]), diagnosis.breaking),
        gap_title="" if far is None else gap_title(far),
        gap=() if far is None else shrink_rows(far),
        where=() if where is None else where_words(where, spec),
        parts=() if where is None else (*body_words(where), *left_words(diagnosis.left)),
        next=next_step(diagnosis, spec),
        provenance=(
            f"{p['rollouts']} real rollouts, {p['held_out']} of them held out, seed {p['seed']}, "
            f"backend {p['backend']}, model {short(str(p['model_hash']))}"
        ),
    )


def _passive_words(diagnosis: Diagnosis) -> str:
    """Return what tests of the specification alone cannot tell; "" where protocols were run, or nothing is hidden."""
    # A named effect is measured, and one that is ruled out has no parameters to measure.
    unknown = [one for one in diagnosis.which.effects if one.status in (Status.POSSIBLE, Status.HIDDEN)]
    hidden = hidden_names(unknown)
    if not diagnosis.passive or not hidden:
        return ""
    return (
        f"tests of the specification alone cannot measure {join_names(hidden, 'or')}: with all other sizes free, the "
        f"90 % interval reaches more than a quarter of typical either way"
    )


def _rows(effects: Iterable[EffectEstimate], breaking: Breaking | None) -> tuple[SizeRow, ...]:
    breaks = {} if breaking is None else breaking.by_name
    return tuple(
        SizeRow(
            f"{one.effect}.{p.parameter}",
            middle(p.value, p.low, p.high, p.unit),
            interval(p.low, p.high, p.unit),
            format_estimate(p.value, p.low, p.high, p.unit),
            format_estimate(p.size, p.size_low, p.size_high, ""),
            f"{one.probability:.3f}",
            one.status.value,
            breaking_cell(breaks.get(f"{one.effect}.{p.parameter}")),
            p,
        )
        for one in effects
        for p in one.parameters
    )


def _size_words(one: EffectEstimate) -> str:
    p = one.largest
    return f"{format_estimate(p.value, p.low, p.high, p.unit)}, probability {one.probability:.2f}"


def text(diagnosis: Diagnosis, spec: Spec) -> str:
    """Return plain text."""
    return Text.from_markup(markup(diagnosis, spec)).plain


def markup(diagnosis: Diagnosis, spec: Spec) -> str:
    """Return rich markup: mistakes of the recordings, the answer, then its details."""
    first = "".join(f"{escape(one_line(f'note: {each.text}'))}\n" for each in diagnosis.evidence.findings)
    colour, word = STYLES[diagnosis.verdict.tone], diagnosis.verdict.value.upper()
    headline = f"[{colour}]{word}[/]  {escape(one_line(diagnosis.reason))}"
    return f"{first}{headline}\n{escape(body(diagnosis, spec))}"


def body(diagnosis: Diagnosis, spec: Spec) -> str:
    """Return whether the gap matters, its causes, how far it shrinks, where it lies, and what to do next."""
    words = describe(diagnosis, spec)
    lines = [f"  {words.passive}"] if words.passive else []
    lines += [f"  {line}" for line in words.matters] + [f"  note: {line}" for line in words.notes]
    if words.named:
        title = "named" if diagnosis.which.answer else "fits best"
        head = (title, "value (90 %)", "parts of typical", words.breaks)
        rows = [head, *((row.name, row.whole, row.size, row.breaks) for row in words.named)]
        lines += ["", *("  {:36} {:28} {:24} {}".format(*row).rstrip() for row in rows)]
    if words.possible:
        lines += ["", f"  {'possible':36} value (90 %)"]
        lines += [f"  {name:36} {row}" for name, row in words.possible]
    if words.ruled_out:
        lines += ["", f"  ruled out: {words.ruled_out}"]
    if words.hidden:
        lines += ["", f"  not visible in these data: {words.hidden}"]
    lines += ["", f"  {words.breaking}"] if words.breaking else []
    if words.gap:
        lines += ["", f"  {words.gap_title}", *(f"    {name:6} {row}" for name, row in words.gap)]
    if words.where:
        first, *rest = words.where + words.parts
        lines += ["", f"  where: {first}", *(f"    {line}" for line in rest)]
    lines += ["", f"  next: {words.next}", "", *(f"  - {line}" for line in diagnosis.assumptions)]
    return "\n".join(map(one_line, [*lines, "", f"  {words.provenance}"]))


def markdown(diagnosis: Diagnosis, spec: Spec) -> str:
    """Return Markdown, for ``$GITHUB_STEP_SUMMARY`` and pull requests."""
    words = describe(diagnosis, spec)
    lines = ["### s2r diagnose", "", *_notes(words.mistakes)]
    lines += [f"**{diagnosis.verdict.value.upper()}**: {cell(diagnosis.reason)}", ""]
    lines += [f"{cell(words.passive)}.", ""] if words.passive else []
    lines += [*(f"- {cell(line)}" for line in words.matters), ""] if words.matters else []
    lines += _notes(words.notes)
    head = (
        "parameter",
        "value",
        "90 % interval",
        "parts of typical",
        "probability",
        "effect is",
        words.breaks,
    )
    rows = [
        (row.name, row.value, row.interval, row.size, row.probability, row.status, row.breaks)
        for row in words.sizes
    ]
    width = len(head) if words.breaks else len(head) - 1
    ruled = (head, ("---", "---:", "---", "---:", "---:", "---", "---"), *(map(cell, row) for row in rows))
    lines += [f"| {' | '.join([*row][:width])} |" for row in ruled]
    lines += ["", f"{cell(words.breaking)}."] if words.breaking else []
    if words.possible:
        lines += ["", "Possible:", "", *(f"- {name}: {cell(row)}" for name, row in words.possible)]
    if words.gap:
        lines += ["", f"{cell(words.gap_title)}:", "", *(f"- {name}: {cell(row)}" for name, row in words.gap)]
    if words.where:
        lines += ["", "Where:", "", *(f"- {cell(line)}" for line in words.where + words.parts)]
    lines += ["", f"**Next**: {cell(words.next)}", "", "<details>", "<summary>This assumes</summary>", ""]
    lines += [f"- {cell(line)}" for line in diagnosis.assumptions]
    return "\n".join([*lines, "", "</details>", "", cell(words.provenance)])


def _notes(sentences: tuple[str, ...]) -> list[str]:
    return [line for sentence in sentences for line in (f"**Note**: {cell(sentence)}", "")]
