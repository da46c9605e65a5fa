"""Stopping rules of a search by name, and the line of a journal that changes the rule of its run.

A journal's header holds the rule as ``stop``, unless it is the usual one. The tests of a search are the same under
every rule, so a run may be resumed under another one: a run that began under ``decided`` repeats tests once its verdict
is known, whatever its rule is later. The journal then has a further line:

    {"kind": "stop", "stop": "epsilon"}
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from s2r_spec.base.errors import UsageError, one_of

EPSILON, DECIDED, BUDGET = "epsilon", "decided", "budget"
STOPS = (EPSILON, DECIDED, BUDGET)
"""Definition: a search ends when its interval is ε wide, when its verdict is known, or when its budget is spent."""
KIND = "stop"
"""Definition: kind of the journal's line, and name of the header's field."""


def as_stop(stop: Any) -> str:
    """Return the name of a stopping rule; a UsageError says that there is no such rule."""
    if stop not in STOPS:
        raise UsageError(f"stop = {stop!r}; it must be one of {one_of(STOPS)}")
    return str(stop)


def stop_of(header: Mapping[str, Any]) -> str:
    """Return the stopping rule of a run from its header."""
    return str(header.get(KIND, EPSILON))


def repeats_of(header: Mapping[str, Any]) -> bool:
    """Return whether a run repeats tests once its verdict is known, from its header; its settings say so."""
    settings = header.get("settings")
    return isinstance(settings, dict) and settings.get("repeats") is True


def header_fields(stop: str) -> dict[str, Any]:
    """Return the header's field for a rule; the usual rule has none."""
    return {} if stop == EPSILON else {KIND: stop}
