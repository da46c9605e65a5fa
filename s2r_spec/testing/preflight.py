"""The pre-flight of a backend that was put together from a user's files: do the files fit?"""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.backend import Backend, Finding, HasPreflight
from s2r_spec.base.errors import S2RError

FEW = 5
"""Definition: lines of a pre-flight that a search prints before it begins."""
FAULT = "rollout"
"""Definition: topic of the finding that no rollout can run."""
_ORDER = ("wrong", "note", "ok")


def preflight(backend: Backend) -> Iterator[Finding]:
    """Yield every finding of a backend; nothing for a backend that is not put together from files."""
    if not isinstance(backend, HasPreflight):
        return
    try:
        yield from backend.preflight(run=True)
    except S2RError as error:  # for instance a controller that raises
        yield Finding(FAULT, str(error), "wrong")


def in_short(backend: Backend) -> list[Finding]:
    """Return the few findings without a rollout that matter most."""
    if not isinstance(backend, HasPreflight):
        return []
    return sorted(backend.preflight(run=False), key=lambda one: _ORDER.index(one.level))[:FEW]
