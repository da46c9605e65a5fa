"""The report as one HTML page that opens offline: verdict, pictures, assumptions, provenance."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from s2r_spec.base.errors import require
from s2r_spec.base.verdict import Tone
from s2r_spec.report.recompute import Run
from s2r_spec.report.sections import section

PACKAGES = ("jinja2", "matplotlib")
SIGNS = {Tone.GOOD: ("✓", "holds"), Tone.BAD: ("✗", "violated"), Tone.OPEN: ("?", "unknown")}
"""Definition: tone → sign, and the style class of its colour."""


def require_packages() -> None:
    """Check that the packages of a page are installed.

    Raises:
        UsageError: one is missing; the message says what to install.
    """
    require("an HTML report needs", *PACKAGES)


def render(runs: Sequence[Run]) -> str:
    """Return the page: the same bytes for the same runs.

    Raises:
        UsageError: a package is missing.
    """
    sections = [section(run, f"r{number}") for number, run in enumerate(runs)]
    return fill("template.html", sections=sections, command=sections[0].command)


def fill(template: str, **words: Any) -> str:
    """Return a template of this package, filled in; all text is escaped except through the filter ``svg``.

    Raises:
        UsageError: a package is missing.
    """
    require_packages()
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FunctionLoader(lambda name: (files("s2r_spec.report") / name).read_text(encoding="utf-8")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["svg"] = Markup
    environment.filters["sign"] = lambda verdict: SIGNS[verdict.tone][0]
    environment.filters["style"] = lambda verdict: SIGNS[verdict.tone][1]
    # Unlike jinja's own "capitalize", it leaves the rest of the sentence unchanged.
    environment.filters["capitalize_first"] = lambda words: words[:1].upper() + words[1:]
    return environment.get_template(template).render(**words)
