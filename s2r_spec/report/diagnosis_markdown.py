"""A diagnosis as Markdown, for ``$GITHUB_STEP_SUMMARY`` and pull requests."""

from __future__ import annotations

from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.report.diagnosis import describe
from s2r_spec.report.markdown import cell
from s2r_spec.spec import Spec


def markdown(diagnosis: Diagnosis, spec: Spec) -> str:
    """Return the answer, then all sizes, how far the gap shrinks, where it lies, the next step, and the assumptions."""
    words = describe(diagnosis, spec)
    lines = ["### s2r diagnose", "", *_notes(words.mistakes)]
    lines += [f"**{diagnosis.verdict.value.upper()}**: {cell(diagnosis.reason)}", ""]
    lines += [f"{cell(words.passive)}.", ""] if words.passive else []
    lines += [*(f"- {cell(line)}" for line in words.matters), ""] if words.matters else []
    lines += _notes(words.notes)
    lines += ["| parameter | value | 90 % interval | parts of typical | probability | effect is |"]
    lines += ["| --- | ---: | --- | ---: | ---: | --- |"]
    for row in words.sizes:
        cells = (row.name, row.value, row.interval, row.size, row.probability, row.status)
        lines.append(f"| {' | '.join(map(cell, cells))} |")
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
