"""What all results have in common: one line, a table for a notebook, JSON, a file, and a page with pictures."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any, cast

from s2r_spec.base.upper import upper

_FORMS = "report.results"


class Result:
    """A result of a check, a gap, a certificate or a diagnosis, with its forms for readers."""

    def __repr__(self) -> str:
        """Return one line: the verdict, and the bounds or the reason."""
        return cast(str, upper(_FORMS).line(self))

    def _repr_html_(self) -> str:
        """Return a small table for a notebook."""
        return cast(str, upper(_FORMS).table(self))

    def to_json(self) -> dict[str, Any]:
        """Return the object that the command prints with ``--json``, as plain values."""
        return cast(dict[str, Any], upper(_FORMS).as_json(self))

    def save(self, path: str | PathLike[str]) -> Path:
        """Write :meth:`to_json` to a file, and return its path.

        Args:
            path: a file that ends in ``.json``; or a folder, which is made, for ``check.json``, ``gap.json``,
                ``certify.json`` or ``diagnosis.json``.

        Raises:
            UsageError: the name has another ending, or the file cannot be written.
        """
        return cast(Path, upper(_FORMS).save_result(self, path))

    def report(self, path: str | PathLike[str]) -> Path:
        """Write the page of ``s2r report`` or ``--report``, which opens offline, and return its path.

        A certificate is computed again from its run, whose folder must still be there. Needs the extra
        ``report``.

        Args:
            path: a file that ends in ``.html``.

        Raises:
            UsageError: the name has another ending, a package is missing, the run is gone, or the file cannot be
                written.
        """
        return cast(Path, upper(_FORMS).save_page(self, path))
