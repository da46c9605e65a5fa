"""A console of rich for text from files and backends."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from s2r_spec.base.printable import without_controls


class SafeConsole(Console):
    """A console that escapes the control characters of strings."""

    def print(self, *objects: Any, **how: Any) -> None:
        """Print objects as rich does, with the control characters of strings escaped."""
        super().print(*(without_controls(one) if isinstance(one, str) else one for one in objects), **how)
