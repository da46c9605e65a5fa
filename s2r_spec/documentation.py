"""The pages of the documentation: where they are on this computer, and how a message names one.

A checkout has them in ``docs``. A wheel installs them in ``share/doc/s2r`` of its environment, as text; the command
``s2r docs`` prints them.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, files, metadata
from pathlib import Path

_CHECKOUT = Path(__file__).resolve().parents[1]
_INSTALLED = ("share", "doc", "s2r", "index.md")
"""Definition: the end of the path at which a wheel installs the first page (``shared-data`` in pyproject.toml)."""


@cache
def _address() -> str | None:
    """Return the address of the documentation's site, from the project's URLs; None if it has none."""
    try:
        urls = metadata("s2r").get_all("Project-URL") or []
    except PackageNotFoundError:  # a source tree on the path, not installed
        return None
    named = dict(url.split(", ", 1) for url in urls)
    return named.get("Documentation")


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
    """Return the folder of the pages, of the checkout or of the installed package; None if there is neither."""
    if (_CHECKOUT / "pyproject.toml").exists():
        return _CHECKOUT / "docs"
    try:
        installed = files("s2r") or []
    except PackageNotFoundError:
        return None
    found = [Path(str(file.locate())) for file in installed if file.parts[-4:] == _INSTALLED]
    return found[0].resolve().parent if found else None


def pages(place: Path) -> dict[str, Path]:
    """Return name → file of every page below a folder, in the order of their names."""
    found = {path.relative_to(place).with_suffix("").as_posix(): path for path in place.rglob("*.md")}
    return dict(sorted(found.items()))
