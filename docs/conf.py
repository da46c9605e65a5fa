"""Sphinx settings of the documentation: ``sphinx-build -W docs build/site`` builds it without a network.

The pages are MyST Markdown, so that they also read well in the repository. Two reference pages come from the code at
build time: `reference/command-line.md` from the typer application, `reference/python-api.md` from docstrings.
"""

import re
import sys
from pathlib import Path

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

from s2r_spec.base import distribution, documentation
from s2r_spec.lang.highlight import StlLexer

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

project = "s2r"
author = "the s2r authors"
version = release = distribution.version()
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown", ".ipynb": "markdown"}
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"s2r {version}"
html_static_path = [str(ROOT / "docs" / "static")]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
suppress_warnings = ["config.cache"]

# Headings have the anchors that the repository's file view gives them.
myst_heading_anchors = 4

napoleon_numpy_docstring = False
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints = "description"
default_role = "code"

COMMANDS = "<!-- commands -->"
"""Where `reference/command-line.md` gets every command with its options."""


OUTSIDE = re.compile(r"\[([^][]*)\]\((\.\./\.\./[^)#]+)\)")
"""A link to a file or folder of the repository that is not a page of the site."""


def _commands() -> str:
    """Return every command with its options in Markdown, as typer describes them."""
    from typer.cli import get_docs_for_click
    from typer.main import get_command

    from s2r_spec.cli import app

    group = get_command(app)
    context = group.make_context("s2r", [], resilient_parsing=True)
    text = get_docs_for_click(obj=group, ctx=context, name="s2r").split("\n", 1)[1]
    for name, command in group.commands.items():  # typer cuts these sentences
        text = re.sub(
            rf"^\* `{name}`:.*$",
            f"* [`{name}`](#s2r-{name}): {command.help}",
            text,
            count=1,
            flags=re.M,
        )
    return text


def _fill(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put the commands in the place of their mark, and make links out of the site work in it.

    A link to a file offers the file itself; a folder has no page, so its name remains. A link to what does not exist
    is left to Sphinx, which refuses it.
    """

    def link(found: re.Match[str]) -> str:
        target = Path(app.srcdir, docname).parent / found[2]
        if target.is_dir():
            return found[1]
        return f"[{found[1]}](path:{found[2]})" if target.is_file() else found[0]

    if app.env.doc2path(docname).suffix == ".ipynb":
        source[0] = documentation.of_notebook(
            source[0], rich=("image/svg+xml", "text/html")
        )
    source[0] = OUTSIDE.sub(link, source[0])
    if COMMANDS in source[0]:
        source[0] = source[0].replace(COMMANDS, _commands())


def _bars(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Escape the bars of an absolute value in a docstring, which reStructuredText takes for a substitution."""
    for i, line in enumerate(lines):
        parts = re.split(r"(``.*?``)", line)
        lines[i] = "".join(
            part if part.startswith("``") else part.replace("|", r"\|")
            for part in parts
        )


def setup(app: Sphinx) -> None:
    """Connect what this file adds to Sphinx."""
    app.add_lexer("stl", StlLexer)
    # A diagram is shown as its source: drawing it would take a network.
    app.add_lexer("mermaid", TextLexer)
    app.connect("source-read", _fill)
    app.connect("autodoc-process-docstring", _bars)
