"""``s2r docs``: the pages of the documentation at the terminal."""

from __future__ import annotations

from typing import Annotated

import typer

from s2r_spec.base import documentation
from s2r_spec.base.errors import UsageError, one_of, suggest
from s2r_spec.cli.terminal.common import sentences

Name = Annotated[
    str | None,
    typer.Argument(
        metavar="[PAGE]", help="Page to print, such as how-to/effects or effects.", show_default="list all"
    ),
]


def docs(name: Name = None) -> None:
    """Print a page of the documentation, or list all pages."""
    with sentences():
        place = documentation.folder()
        if place is None:
            raise UsageError("this installation has no pages; install s2r again, from a wheel or a checkout")
        pages = documentation.pages(place)
        if name is None:
            widest = max(map(len, pages))
            for each, path in pages.items():
                heads = [row for row in documentation.read(path).splitlines() if row.startswith("# ")]
                print(f"{each:{widest}}  {heads[0].removeprefix('# ') if heads else ''}")
            return
        bare = name.removesuffix(".md").removesuffix(documentation.NOTEBOOK)
        matches = [each for each in pages if each == bare or each.endswith(f"/{bare}")]
        if len(matches) > 1:
            raise UsageError(f"several pages end in {bare}: {one_of(matches)}; give one of them")
        if not matches:
            raise UsageError(f"no page {name!r}{suggest(name, pages)} `s2r docs` lists all pages")
        print(documentation.read(pages[matches[0]]), end="")
