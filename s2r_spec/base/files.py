"""Files that are replaced whole or not at all.

New content goes to a temporary file in the same folder, is flushed to the disk, and then takes the file's name. After
a full disk, a crash or a kill the old content remains.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from s2r_spec.base.errors import UsageError


def save(path: Path, content: str | bytes) -> None:
    """Write a file as :func:`replace` does; text becomes UTF-8 with line feeds.

    Raises:
        UsageError: the file cannot be written; its old content remains.
    """
    with _usage_errors(path):
        replace(path, content)


def refuse_existing(folder: Path) -> None:
    """Refuse a folder in which a file could be overwritten, or that cannot be made.

    Raises:
        UsageError: it is there and not empty, or there is no folder for it.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder} is there already, and nothing is overwritten; name a new folder")
    if not folder.absolute().parent.is_dir():
        raise UsageError(f"cannot make the folder {folder}: there is no folder {folder.parent}")


@contextmanager
def saving(path: Path) -> Iterator[Path]:
    """Give a temporary file to write to, as :func:`replacing` does.

    Raises:
        UsageError: the file cannot be written; its old content remains.
    """
    with _usage_errors(path), replacing(path) as temporary:
        yield temporary


@contextmanager
def _usage_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror or error}") from None


def replace(path: Path, content: str | bytes) -> None:
    """Replace the content of a file.

    Raises:
        OSError: the file cannot be written; its old content remains.
    """
    # Python reads bytes that are not UTF-8 in a file's name as lone surrogates; they are written as escapes.
    data = content if isinstance(content, bytes) else content.encode("utf-8", "backslashreplace")
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(data)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give an empty temporary file to write to; at the end it replaces the file.

    The temporary file has the same ending, the same permissions and, if allowed, the same owner. A symbolic link stays,
    and its target is replaced. A path that is not a regular file (``/dev/stdout``, a pipe) is written directly.

    Raises:
        OSError: the file cannot be written. Its old content remains, and the temporary file is removed.
    """
    target = Path(os.path.realpath(path) if os.path.islink(path) else os.path.abspath(path))
    try:
        before = target.stat()
    except OSError:
        before = None
    if before is not None and not stat.S_ISREG(before.st_mode):
        yield path
        return
    if before is not None and not os.access(target, os.W_OK):
        raise PermissionError(13, "Permission denied", str(path))
    temporary = target.with_name(f".{target.stem[:100]}.{os.urandom(4).hex()}.part{target.suffix[:50]}")
    handle = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
    try:
        os.close(handle)
        yield temporary
        if before is not None:
            with suppress(OSError, AttributeError):  # a file of another user; not a POSIX system
                os.chown(temporary, before.st_uid, before.st_gid)
            os.chmod(temporary, stat.S_IMODE(before.st_mode))
        onto_disk(temporary)
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    with suppress(OSError):  # on some file systems a folder cannot be opened
        onto_disk(target.parent)


def onto_disk(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk.

    Raises:
        OSError: the file cannot be opened or written.
    """
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
