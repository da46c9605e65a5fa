"""Files that are replaced whole or not at all.

What is new is written beside the file, brought onto the disk, and only then takes its name. A full disk, a
crash or a kill leaves what was there before.
"""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from s2r_spec.errors import UsageError


def save(path: Path, content: str | bytes) -> None:
    """Write a file as :func:`replace` does; text becomes UTF-8 with line feeds.

    Raises:
        UsageError: it cannot be written; what was there before is as it was.
    """
    with _sentences(path):
        replace(path, content)


@contextmanager
def saving(path: Path) -> Iterator[Path]:
    """Give a file to write to as :func:`replacing` does.

    Raises:
        UsageError: it cannot be written; what was there before is as it was.
    """
    with _sentences(path), replacing(path) as beside:
        yield beside


@contextmanager
def _sentences(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror or error}") from None


def replace(path: Path, content: str | bytes) -> None:
    """Put new content in a file's place.

    Raises:
        OSError: it cannot be written; what was there before is as it was.
    """
    # A name that is no UTF-8 on disk is a lone surrogate in Python: it is written as an escape.
    data = content if isinstance(content, bytes) else content.encode("utf-8", "backslashreplace")
    with replacing(path) as beside, beside.open("wb") as file:
        file.write(data)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a new, empty file beside this one to write to; at the end it takes this one's place.

    It has the same ending, the same permissions and, where that is allowed, the same owner. A symbolic link
    stays one: the file that it leads to is replaced. What is no file (``/dev/stdout``, a pipe) is written to as it is.

    Raises:
        OSError: it cannot be written. This one is then as it was, and nothing is left beside it.
    """
    target = Path(os.path.realpath(path))
    before = target.stat() if target.exists() else None
    if before is not None and not stat.S_ISREG(before.st_mode):
        yield path
        return
    if before is not None and not os.access(target, os.W_OK):
        raise PermissionError(13, "Permission denied", str(path))
    beside = target.with_name(f".{target.stem[:100]}.{secrets.token_hex(4)}.part{target.suffix[:50]}")
    handle = os.open(beside, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
    try:
        os.close(handle)
        yield beside
        if before is not None:
            with suppress(OSError, AttributeError):  # another's file; not a POSIX system
                os.chown(beside, before.st_uid, before.st_gid)
            os.chmod(beside, stat.S_IMODE(before.st_mode))
        onto_disk(beside)
        os.replace(beside, target)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
    with suppress(OSError):  # some file systems have no folder that can be opened
        onto_disk(target.parent)


def onto_disk(path: Path) -> None:
    """Bring a file, or the names in a folder, onto the disk.

    Raises:
        OSError: it cannot be opened or written there.
    """
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
