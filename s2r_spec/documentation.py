"""The pages of the documentation: where they are on this computer, and how a message names one.

A checkout has them in ``docs``, a wheel in this package, as text; the command ``s2r docs`` prints them.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from s2r_spec.distribution import own
from s2r_spec.shipped import shipped


@cache
def _address() -> str | None:
    """Return the address of the documentation's site, from the project's URLs; None if it has none."""
    distribution = own()
    if distribution is None:
        return None
    urls = distribution.metadata.get_all("Project-URL") or []
    return dict(url.split(", ", 1) for url in urls).get("Documentation")


def page(name: str) -> str:
    """Return the name of a page in a message: its address, or the command that prints it if there is no site.

    Args:
        name: the name of the page below ``docs``, without its ending, such as ``how-to/effects``.
    """
    address = _address()
    if address is None:
        return f"`s2r docs {name}`"
    return f"{address.rstrip('/')}/{name}.html"


def folder() -> Path | None:
    """Return the folder of the pages, of the installed package or of the checkout; None if there is neither."""
    return shipped("docs")


def pages(place: Path) -> dict[str, Path]:
    """Return name → file of every page below a folder, in the order of their names."""
    found = {path.relative_to(place).with_suffix("").as_posix(): path for path in place.rglob("*.md")}
    return dict(sorted(found.items()))
