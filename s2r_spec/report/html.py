"""The report as one HTML page that opens offline: verdict, pictures, assumptions, provenance."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from s2r_spec.base.errors import require
from s2r_spec.base.verdict import Tone
from s2r_spec.report.recompute import Run
from s2r_spec.report.sections import section

if TYPE_CHECKING:
    from markupsafe import Markup

PACKAGES = ("jinja2", "matplotlib")
_HASH = re.compile(r"\b[0-9a-f]{16,}\b")
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


def prose(text: str) -> Markup:
    """Return text as HTML as people write it.

    What is between backticks is code. A number stays with its percent sign, and |Δρ|, 1e-06 and --sim in one piece.
    Names may break behind their dots, and a hash behind every eighth digit. A break is no character, so a copied name
    has none.
    """
    from markupsafe import Markup, escape

    parts = str(escape(text)).split("`")
    for place, words in enumerate(parts):
        if place % 2 and place + 1 < len(parts):
            parts[place] = f"<code>{words}</code>"
            continue
        words = re.sub(
            r"\|[^\s|]+\||\d+e-\d+|--[a-z][\w-]*",
            r'<span class="whole">\g<0></span>',
            words.replace(" %", "\u00a0%"),
        )
        words = re.sub(r"(?<=[^\W\d]\.)(?=[^\W\d])", "<wbr>", words)
        parts[place] = re.sub(_HASH, lambda digits: re.sub("(.{8})(?=.)", r"\1<wbr>", digits[0]), words)
    return Markup("".join(parts))


def fill(template: str, **words: Any) -> str:
    """Return a template of this package, filled in; all text is escaped except through the filter ``svg``.

    Text is prose (:func:`prose`) except through the filter ``plain``, for attributes and for files.

    Raises:
        UsageError: a package is missing.
    """
    require_packages()
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup, escape

    environment = Environment(
        loader=FunctionLoader(lambda name: (files("s2r_spec.report") / name).read_text(encoding="utf-8")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: prose(value) if type(value) is str else value,
    )
    environment.filters["svg"] = Markup
    environment.filters["plain"] = escape
    environment.filters["sign"] = lambda verdict: SIGNS[verdict.tone][0]
    environment.filters["style"] = lambda verdict: SIGNS[verdict.tone][1]
    # Unlike jinja's own "capitalize", it leaves the rest of the sentence unchanged.
    environment.filters["capitalize_first"] = lambda words: words[:1].upper() + words[1:]
    return environment.get_template(template).render(**words)
