"""Libraries behind extras, imported where a file needs them, and their errors."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from s2r_spec.base.distribution import find_own
from s2r_spec.base.errors import TraceError, not_installed, shortened
from s2r_spec.base.printable import one_line


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


def reason_of(error: Exception) -> str:
    """Return the message of a library's error in one short line, or else the name of its type."""
    return shortened(one_line(str(error)) or type(error).__name__)
