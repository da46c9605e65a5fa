"""The forms of a result in Python; they are methods of :class:`s2r_spec.base.result.Result`."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from s2r_spec.base.errors import UsageError
from s2r_spec.base.files import save
from s2r_spec.base.json_values import document, to_json
from s2r_spec.base.printable import html_table, html_text, one_line
from s2r_spec.certify.bound.rounding import interval_text
from s2r_spec.certify.real_machine import CertifyResult
from s2r_spec.certify.result.check_result import CheckResult
from s2r_spec.certify.result.gap_result import GapResult
from s2r_spec.diagnose.diagnosis import Diagnosis
from s2r_spec.report import check as check_report
from s2r_spec.report import diagnosis as diagnosis_report
from s2r_spec.report.certify import report_of
from s2r_spec.report.recompute import Certified

Known = Certified | Diagnosis
_FILES = {
    CheckResult: "check.json", GapResult: "gap.json", CertifyResult: "certify.json", Diagnosis: "diagnosis.json",
}  # fmt: skip

_RUNS: dict[str, Callable[[Any], str | Path]] = {
    "s2r.check/1": lambda saved: saved["results"][0]["folder"],
    "s2r.gap/1": lambda saved: saved["folder"],
    "s2r.certify/1": lambda saved: Path(saved["simulation"]["folder"]).parent,
}
"""Schema of a saved result → the folder of its run."""


def line(result: Known) -> str:
    """Return one line: the verdict, and the bounds or the reason."""
    if isinstance(result, Diagnosis):
        words = str(result)
    elif isinstance(result, CheckResult):
        words = f"{result.requirement} {result.verdict.name}: {_bound('ρ', result)}"
    elif isinstance(result, GapResult):
        words = f"{result.requirement}: {_bound('Δ', result)}"
    else:
        first, both, bound = result.simulated, result.composition, result.reason
        if both is not None:
            interval = f"{interval_text(both.lower, both.upper)} {first.unit}".rstrip()
            bound = f"worst expected ρ of {result.real} in {interval}, with probability ≥ 1 − {both.delta:g}"
        words = f"{first.requirement} {result.verdict.name}: {bound}"
    return one_line(f"{type(result).__name__}({words})")


def _bound(symbol: str, result: CheckResult | GapResult) -> str:
    certificate = result.certificate
    if not certificate.label.certifies:
        return f"no certificate: {certificate.reason}"
    interval, probability = check_report.interval_words(result), check_report.probability_words(certificate)
    return f"worst expected {symbol} {interval}, {probability}, {certificate.rollouts} rollouts"


def table(result: Known) -> str:
    """Return a table for a notebook: verdict, bounds and effort, and the assumptions to unfold."""
    if isinstance(result, Diagnosis):
        return html_table(line(result), (), _diagnosis_rows(result)) + _fold(
            "This assumes", result.assumptions
        )
    (finding,) = report_of([result]).findings
    rows = [("", finding.reason), *finding.facts, ("run", finding.provenance)]
    return html_table(f"{finding.name}: {finding.word} ({finding.about})", (), rows) + "".join(
        _fold(title, lines) for title, lines in finding.sections
    )


def _fold(title: str, lines: Sequence[str]) -> str:
    items = "".join(f"<li>{html_text(one)}</li>" for one in lines)
    return f"<details><summary>{html_text(title)}</summary><ul>{items}</ul></details>"


def _diagnosis_rows(result: Diagnosis) -> list[tuple[str, str]]:
    if result.spec is None:
        return [("note", note) for note in result.notes]
    words = diagnosis_report.describe(result, result.spec)
    rows = [("hidden", words.passive)] if words.passive else []
    rows += [("note", note) for note in (*words.mistakes, *words.notes)]
    rows += [("matters", "; ".join(words.matters))] if words.matters else []
    rows += [(row.name, f"{row.whole}, {row.size} of typical") for row in words.named]
    rows += [(f"{name} (possible)", row) for name, row in words.possible]
    rows += [("ruled out", words.ruled_out)] if words.ruled_out else []
    rows += [("not visible", words.hidden)] if words.hidden else []
    rows += [(words.breaks, words.breaking)] if words.breaking else []
    rows += [(f"gap {name}", row) for name, row in words.gap]
    rows += [("where", "; ".join(words.where))] if words.where else []
    return [*rows, ("next", words.next), ("run", words.provenance)]


def as_json(result: Known) -> Any:
    """Return the object of the command's ``--json`` as plain values."""
    return to_json(result if isinstance(result, Diagnosis) else report_of([result]).record)


def save_result(result: Known, path: str | os.PathLike[str]) -> Path:
    """Write a result as JSON, the same bytes as ``--json --output``; see :meth:`s2r_spec.base.result.Result.save`."""
    file = Path(path)
    if file.is_dir() or not file.suffix:
        file = file / _FILES[type(result)]
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"cannot make the folder {file.parent}: {error.strerror or error}") from None
    elif file.suffix.lower() != ".json":
        remedy = "; report() writes a page" if file.suffix.lower() in (".html", ".htm") else ""
        raise UsageError(f"{file.name!r}: the file name of a saved result ends in .json{remedy}")
    save(file, document(result if isinstance(result, Diagnosis) else report_of([result]).record) + "\n")
    return file


def save_page(result: Known, path: str | os.PathLike[str]) -> Path:
    """Write the page of a result; see :meth:`s2r_spec.base.result.Result.report`."""
    from s2r_spec.report import diagnosis_page, html, recompute

    file = Path(path)
    if file.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{file.name!r}: the file name of a page ends in .html")
    html.require_packages()
    if isinstance(result, Diagnosis):
        if result.spec is None:
            raise UsageError("this diagnosis has no specification, so there is no page of it")
        text = diagnosis_page.render(result, result.spec, result.real)
    else:
        text = html.render([recompute.recompute_again(result)])
    save(file, text)
    return file


def load_result(path: str | os.PathLike[str]) -> Certified:
    """Return the result of a run, computed again from its rollouts, bit for bit; nothing is simulated.

    Args:
        path: the folder of a run with one requirement, or a file that ``save`` wrote while that folder is still there.

    Raises:
        UsageError: there is no run, its files were changed, or the file is a diagnosis.
    """
    from s2r_spec.report.recompute import RunKind, kind, recompute_all
    from s2r_spec.runs.layout import runs_in

    place = Path(path)
    folder = _folder_in(place) if place.is_file() else place
    if kind(folder) is RunKind.CHECK and len(runs := runs_in(folder)) > 1:
        raise UsageError(f"{folder} has {len(runs)} requirements; give one of {', '.join(map(str, runs))}")
    return recompute_all(folder)[0].result


def _folder_in(file: Path) -> Path:
    try:
        contents = json.loads(file.read_text(encoding="utf-8"))
        if contents["schema"].startswith("s2r/diagnosis/"):
            raise UsageError(f"{file} is a diagnosis; read it as plain values: json.loads(path.read_text())")
        folder = Path(_RUNS[contents["schema"]](contents))
    except (OSError, ValueError, LookupError, TypeError):
        raise UsageError(f"{file} is not a saved result") from None
    if not folder.is_dir():
        raise UsageError(f"the run of {file} is not in {folder}; give the folder of the run instead")
    return folder
