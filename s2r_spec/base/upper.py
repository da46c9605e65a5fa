"""Work that a module of a higher layer does for a method of a lower one.

Imports go one way. But users look for ``Trace.from_dataframe`` at the trace, and for ``CheckResult.report`` at the
result. Such a method finds its function by name when it is called, and loads nothing before.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


def upper(module: str) -> Any:
    """Return a module of this package, such as ``logs.dataframe``."""
    return import_module(f"{__name__.partition('.')[0]}.{module}")
