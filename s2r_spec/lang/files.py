"""Specifications on disk."""

from __future__ import annotations

from pathlib import Path

from s2r_spec.errors import UsageError


def read_text(path: str | Path) -> str:
    """Return the text of a specification's file (UTF-8).

    Raises:
        UsageError: the file cannot be read, is not text, or is a mesh (``.stl`` means that, too).
    """
    try:
        data = Path(path).read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else error
        raise UsageError(f"cannot read the specification {path}: {reason}") from None
    if _is_mesh(data):
        raise UsageError(
            f"{path} is a 3-D mesh; s2r reads signal temporal logic, which has the same ending, .stl, "
            f"and is text like `require slow: always (v <= 1 {{m/s}})`"
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(
            f"{path} is not UTF-8 text: byte {error.start} is {data[error.start]:#04x}"
        ) from None


def _is_mesh(data: bytes) -> bool:
    """Tell a mesh: binary ones give their size, ASCII ones list facets."""
    binary = len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
    head = data[:1000].lower()
    return binary or (head.lstrip().startswith(b"solid") and (b"facet" in head or b"endsolid" in head))
