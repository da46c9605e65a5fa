"""Libraries behind extras, imported where a file needs them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from s2r_spec.base.distribution import find_own
from s2r_spec.base.errors import TraceError, not_installed


def library(name: str, what: str) -> Any:
    """Return a module.

    Args:
        name: name of the module.
        what: what needs it, in the plural.

    Raises:
        TraceError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        raise TraceError(not_installed(f"{what} need", name, find_own())) from None
