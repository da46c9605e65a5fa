"""Folders of the repository that a wheel has as well: the documentation, and the examples."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def shipped_folder(name: str) -> Path | None:
    """Return a folder, such as ``docs``, of a wheel or else of the checkout; None if there is neither.

    A wheel has the folders in ``data`` of this package (``force-include`` in pyproject.toml).
    """
    installed = _PACKAGE / "data" / name
    if installed.is_dir():
        return installed
    checkout = _PACKAGE.parent
    return checkout / name if (checkout / "pyproject.toml").exists() else None
