"""Where a message sends its reader for more: an installed package has no ``docs`` folder."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, metadata


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
    """Return how a message names a page: by its address, or by its name where the site has no address.

    Args:
        name: of the page below ``docs``, without its ending, such as ``how-to/effects``.
    """
    address = _address()
    if address is None:
        return f"page {name} of the documentation"
    return f"{address.rstrip('/')}/{name}.html"
