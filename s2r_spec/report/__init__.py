"""Reporters by name, as ``--format`` takes it: each turns a report into one text."""

from __future__ import annotations

from collections.abc import Callable, Collection
from importlib import import_module
from typing import TYPE_CHECKING

from s2r_spec.base.errors import UsageError, one_of, suggest
from s2r_spec.base.json_values import document

if TYPE_CHECKING:
    from s2r_spec.report.finding import Report


def _later(module: str, name: str) -> Callable[[Report], str]:
    """Return a reporter whose module is loaded for its first report."""
    return lambda report: str(getattr(import_module(f"{__name__}.{module}"), name)(report))


REPORTERS: dict[str, Callable[[Report], str]] = {
    "text": _later("text", "render"),
    "json": lambda report: document(report.record),
    "junit": _later("ci", "junit"),
    "github": _later("ci", "github"),
    "markdown": _later("markdown", "render"),
}
"""Name, as ``--format`` takes it → a report as text."""


def reporter(name: str, among: Collection[str] | None = None) -> Callable[[Report], str]:
    """Return a reporter by its name.

    Raises:
        UsageError: no reporter has this name, or ``among`` leaves it out.
    """
    offered = REPORTERS if among is None else among
    if name not in offered:
        raise UsageError(f"no format {name!r}{suggest(name, offered)} the formats are {one_of(offered)}")
    return REPORTERS[name]
