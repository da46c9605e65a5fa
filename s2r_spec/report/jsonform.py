"""The result as one JSON object."""

from __future__ import annotations

import json

from s2r_spec.json_values import to_json
from s2r_spec.report.finding import Report


def render(report: Report) -> str:
    """Return the whole record.

    Raises:
        ValueError: the record holds NaN or an infinity, which JSON does not have.
    """
    return json.dumps(to_json(report.record), allow_nan=False, indent=2, ensure_ascii=False)
