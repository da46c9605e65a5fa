"""Libraries behind extras, imported where a file needs them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from s2r_spec.errors import TraceError


def library(name: str, what: str, extra: str) -> Any:
    """Return a module.

    Args:
        name: name of the module.
        what: what needs it, in the plural.
        extra: the extra that installs it.

    Raises:
        TraceError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        raise TraceError(f"{what} need the package {package}; try: pip install 's2r[{extra}]'") from None
