"""The pages of the documentation: where they are on this computer, and how a message names one.

A checkout has them in ``docs``, a wheel in this package, as text; the command ``s2r docs`` prints them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from s2r_spec.base.distribution import find_own
from s2r_spec.base.shipped import shipped_folder

NOTEBOOK = ".ipynb"


@cache
def _address() -> str | None:
    """Return the address of the documentation's site, from the project's URLs; None if it has none."""
    distribution = find_own()
    if distribution is None:
        return None
    urls = distribution.metadata.get_all("Project-URL") or []
    return dict(url.split(", ", 1) for url in urls).get("Documentation")


def page(name: str) -> str:
    """Return the address of a page such as ``how-to/effects``, or the command that prints it if there is no site."""
    address = _address()
    if address is None:
        return f"`s2r docs {name}`"
    return f"{address.rstrip('/')}/{name}.html"


def folder() -> Path | None:
    """Return the folder of the pages, of the installed package or of the checkout; None if there is neither."""
    return shipped_folder("docs")


def pages(place: Path) -> dict[str, Path]:
    """Return name → file of every page below a folder, in the order of their names."""
    paths = [path for path in place.rglob("*") if path.suffix in (".md", NOTEBOOK)]
    pages_by_name = {path.relative_to(place).with_suffix("").as_posix(): path for path in paths}
    return dict(sorted(pages_by_name.items()))


def read(path: Path) -> str:
    """Return a page as Markdown."""
    text = path.read_text(encoding="utf-8")
    return of_notebook(text) if path.suffix == NOTEBOOK else text


def of_notebook(notebook: str, rich: Sequence[str] = ()) -> str:
    """Return the cells of a notebook with their outputs as one page in Markdown; nothing runs.

    Args:
        notebook: the text of its file.
        rich: kinds of outputs that the page shows as HTML, such as "image/svg+xml"; other outputs are shown as text.
    """
    parts = []
    for cell in json.loads(notebook)["cells"]:
        text = "".join(cell["source"])
        parts.append(f"```python\n{text}\n```" if cell["cell_type"] == "code" else text)
        parts += [_output(output, rich) for output in cell.get("outputs", ())]
    return "\n\n".join(parts) + "\n"


def _output(output: dict[str, Any], rich: Sequence[str]) -> str:
    data = output.get("data", {"text/plain": output.get("text", "")})
    for kind in (kind for kind in rich if kind in data):
        text = "".join(data[kind])
        return f"```{{raw}} html\n{text[max(text.find('<svg'), 0) :]}\n```"  # without the declaration of XML
    return f"```text\n{''.join(data['text/plain']).rstrip()}\n```"
