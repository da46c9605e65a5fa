"""A diagnosis as Markdown, for ``$GITHUB_STEP_SUMMARY`` and pull requests."""

from __future__ import annotations

from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.report.diagnosed import (
    SHOWN,
    body_words,
    cause,
    doubt,
    gap_title,
    left_words,
    provenance,
    shrink_rows,
    where_words,
)
from s2r_spec.report.markdown import cell
from s2r_spec.report.nextstep import next_step
from s2r_spec.report.quantity import interval, quantity
from s2r_spec.spec import Spec


def markdown(found: Diagnosis, spec: Spec) -> str:
    """Return the answer, then where, which and how far, the next step, and the assumptions."""
    which = found.which
    mistakes = [each.text for each in found.findings]
    lines = ["### s2r diagnose", "", *(line for text in mistakes for line in (f"**Note**: {cell(text)}", ""))]
    lines += [f"**{found.verdict.value.upper()}**: {cell(found.reason)}", ""]
    lines += [
        line for note in found.notes if note not in mistakes for line in (f"**Note**: {cell(note)}", "")
    ]
    if found.where is not None:
        sentences = (*where_words(found.where, spec), *body_words(found.where), *left_words(found))
        lines += ["Where:", "", *(f"- {cell(line)}" for line in sentences), ""]
    lines += ["| cause | probability |", "| --- | ---: |"]
    lines += [f"| {cell(cause(names))} | {p:.3f} |" for names, p in which.ranked[:SHOWN]]
    if which.estimates:
        lines += ["", "| parameter | value | 90 % interval |", "| --- | ---: | --- |"]
        for e in which.estimates:
            value = quantity(e.value, e.unit, (e.high - e.low) / 2)
            name, ends = f"{e.effect}.{e.parameter}", interval(e.low, e.high, e.unit)
            lines.append(f"| {cell(name)} | {cell(value)} | {cell(ends)} |")
    if words := doubt(which):
        lines += ["", f"{cell(words[0].upper() + words[1:])}."]
    if found.how_far is not None:
        lines += ["", f"{cell(gap_title(found.how_far))}:", ""]
        lines += [f"- {name}: {cell(words)}" for name, words in shrink_rows(found.how_far)]
    lines += ["", f"**Next**: {cell(next_step(found, spec))}"]
    lines += ["", "<details>", "<summary>This assumes</summary>", ""]
    lines += [f"- {cell(line)}" for line in found.assumptions]
    return "\n".join([*lines, "", "</details>", "", cell(provenance(found))])
