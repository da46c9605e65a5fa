"""A diagnosis as Markdown, for ``$GITHUB_STEP_SUMMARY`` and pull requests."""

from __future__ import annotations

from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.report.diagnosed import SHOWN, describe
from s2r_spec.report.markdown import cell
from s2r_spec.spec import Spec


def markdown(found: Diagnosis, spec: Spec) -> str:
    """Return the answer, then where, which and how far, the next step, and the assumptions."""
    words = describe(found, spec)
    lines = ["### s2r diagnose", "", *_notes(words.mistakes)]
    lines += [f"**{found.verdict.value.upper()}**: {cell(found.reason)}", ""]
    if words.matters:
        lines += [*(f"- {cell(line)}" for line in words.matters), ""]
    lines += _notes(words.notes)
    if words.where:
        lines += ["Where:", "", *(f"- {cell(line)}" for line in words.where + words.parts), ""]
    lines += ["| cause | probability |", "| --- | ---: |"]
    lines += [f"| {cell(cause)} | {p:.3f} |" for cause, p in words.causes[:SHOWN]]
    if words.estimates:
        lines += ["", "| parameter | value | 90 % interval |", "| --- | ---: | --- |"]
        lines += [f"| {' | '.join(map(cell, (name, *value)))} |" for name, _, *value in words.estimates]
    if words.doubt:
        lines += ["", f"{cell(words.doubt[0].upper() + words.doubt[1:])}."]
    if words.gap:
        lines += ["", f"{cell(words.gap_title)}:", "", *(f"- {name}: {cell(row)}" for name, row in words.gap)]
    lines += ["", f"**Next**: {cell(words.next)}", "", "<details>", "<summary>This assumes</summary>", ""]
    lines += [f"- {cell(line)}" for line in found.assumptions]
    return "\n".join([*lines, "", "</details>", "", cell(words.provenance)])


def _notes(sentences: tuple[str, ...]) -> list[str]:
    return [line for sentence in sentences for line in (f"**Note**: {cell(sentence)}", "")]
