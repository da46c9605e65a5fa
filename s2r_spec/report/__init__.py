"""Reporters: one result record in, one text out. By name, as ``--format`` says."""

from __future__ import annotations

from collections.abc import Callable

from s2r_spec.errors import UsageError, one_of, suggest
from s2r_spec.report import github, jsonform, junit, markdown, text
from s2r_spec.report.finding import Report

REPORTERS: dict[str, Callable[[Report], str]] = {
    "text": text.render,
    "json": jsonform.render,
    "junit": junit.render,
    "github": github.render,
    "markdown": markdown.render,
}
"""Name, as ``--format`` takes it → a report as text."""


def reporter(name: str) -> Callable[[Report], str]:
    """Return a reporter by its name.

    Raises:
        UsageError: there is none of that name.
    """
    if name not in REPORTERS:
        raise UsageError(f"no format {name!r}{suggest(name, REPORTERS)} there are: {one_of(REPORTERS)}")
    return REPORTERS[name]
