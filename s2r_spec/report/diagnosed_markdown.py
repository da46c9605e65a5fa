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
from s2r_spec.spec import Spec


def markdown(found: Diagnosis, spec: Spec) -> str:
    """Return the answer, then tables of causes and values, then what it stands on."""
    which = found.which
    said = [each.text for each in found.findings]
    lines = ["### s2r diagnose", "", *(line for text in said for line in (f"**Note**: {cell(text)}", ""))]
    lines += [f"**{found.verdict.value.upper()}**: {cell(found.reason)}", ""]
    lines += [line for note in found.notes if note not in said for line in (f"**Note**: {cell(note)}", "")]
    lines += [f"**Next**: {cell(next_step(found, spec))}", "", "| cause | probability |", "| --- | ---: |"]
    lines += [f"| {cell(cause(names))} | {p:.3f} |" for names, p in which.ranked[:SHOWN]]
    if which.estimates:
        lines += ["", "| parameter | value | 90 % interval |", "| --- | ---: | --- |"]
        for e in which.estimates:
            value = cell(f"{e.value:.4g} {e.unit}".rstrip())
            interval = cell(f"[{e.low:.4g}, {e.high:.4g}] {e.unit}".rstrip())
            lines.append(f"| {cell(f'{e.effect}.{e.parameter}')} | {value} | {interval} |")
    if words := doubt(which):
        lines += ["", f"{cell(words[0].upper() + words[1:])}."]
    if found.where is not None:
        told = (*where_words(found.where, spec), *body_words(found.where), *left_words(found))
        lines += ["", "Where:", "", *(f"- {cell(line)}" for line in told)]
    if found.how_far is not None:
        lines += ["", f"{cell(gap_title(found.how_far))}:", ""]
        lines += [f"- {name}: {cell(words)}" for name, words in shrink_rows(found.how_far)]
    lines += ["", "<details>", "<summary>This assumes</summary>", ""]
    lines += [f"- {cell(line)}" for line in found.assumptions]
    return "\n".join([*lines, "", "</details>", "", cell(provenance(found))])
