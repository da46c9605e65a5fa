"""The result as one JSON object."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from s2r_spec.report.finding import Report

SCHEMAS = ("s2r.check/1", "s2r.gap/1", "s2r.certify/1", "s2r.error/1", "s2r/diagnosis/1")


def render(report: Report) -> str:
    """Return the whole record.

    Raises:
        ValueError: the record holds NaN or an infinity, which JSON has not.
    """
    return json.dumps(report.record, allow_nan=False, indent=2, ensure_ascii=False)


def schema(name: str) -> Any:
    """Return the JSON Schema of a record by its ``schema`` field: "s2r.check/1", "s2r.error/1" and so on.

    Other schemas that it refers to are bundled in, each under its own ``$id``.
    """
    found = _read(name)
    if others := _referred(found, {name}):
        found["$defs"] = found.get("$defs", {}) | {other: _read(other) for other in sorted(others)}
    return found


def _referred(found: Any, known: set[str]) -> set[str]:
    """Return the names of all other schemas that one refers to, directly or through another."""
    text, names = json.dumps(found), set[str]()
    for other in SCHEMAS:
        if other not in known and f'"urn:{other.replace(".", ":").replace("/", ":")}#' in text:
            names |= {other} | _referred(_read(other), known | {other})
    return names


def _read(name: str) -> Any:
    file = name.removeprefix("s2r").lstrip("./").replace("/", "-") + ".json"
    return json.loads((files("s2r_spec.report") / "schema" / file).read_text(encoding="utf-8"))
