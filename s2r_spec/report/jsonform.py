"""The result as one JSON object."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from s2r_spec.report.finding import Report


def render(report: Report) -> str:
    """Return the whole record; no NaN and no infinity ever gets in."""
    return json.dumps(report.record, allow_nan=False, indent=2, ensure_ascii=False)


def schema(name: str) -> Any:
    """Return the JSON Schema of what calls itself ``name``: "s2r.check/1" or "s2r.error/1"."""
    file = name.removeprefix("s2r.").replace("/", "-") + ".json"
    return json.loads((files("s2r_spec.report") / "schema" / file).read_text(encoding="utf-8"))
