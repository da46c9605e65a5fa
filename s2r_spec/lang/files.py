"""Specifications on disk."""

from __future__ import annotations

import stat
from pathlib import Path

from s2r_spec.base.errors import UsageError

LONGEST = 2**18
"""Budget: bytes of a specification, 262 144, some hundred times those shipped."""


def read_text(path: str | Path) -> str:
    """Return the text of a specification's file (UTF-8).

    Raises:
        UsageError: the file cannot be read, is not text, is too long, or is a 3-D mesh, which has the same ending.
    """
    try:
        data, size = _beginning(Path(path))
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else error
        raise UsageError(f"cannot read the specification {path}: {reason}") from None
    if _is_mesh(data, size):
        raise UsageError(
            f"{path} is a 3-D mesh. A specification has the same ending, .stl, but is text such as "
            f"`require slow: always (v <= 1 {{m/s}})`"
        )
    if len(data) > LONGEST:
        raise UsageError(f"{path} is longer than {LONGEST:,} bytes, the limit of a specification")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError(
            f"{path} is not UTF-8 text: byte {error.start} is {data[error.start]:#04x}"
        ) from None


def _beginning(path: Path) -> tuple[bytes, int]:
    """Return the first :data:`LONGEST` + 1 bytes of a file, and its size [bytes].

    Raises:
        OSError: it cannot be read.
        ValueError: it is a pipe or a device, which may never end.
    """
    about = path.stat()
    if not stat.S_ISREG(about.st_mode) and not stat.S_ISDIR(about.st_mode):
        raise ValueError("it is a pipe or a device, not a file")
    with path.open("rb") as stream:
        return stream.read(LONGEST + 1), about.st_size


def _is_mesh(data: bytes, size: int) -> bool:
    """Return whether a file is a mesh: a binary one states its size, an ASCII one lists facets."""
    binary = len(data) >= 84 and size == 84 + 50 * int.from_bytes(data[80:84], "little")
    head = data[:1000].lower()
    return binary or (head.lstrip().startswith(b"solid") and (b"facet" in head or b"endsolid" in head))
