"""What is computed once and kept on disk: arrays and JSON in an NPZ file.

A file may be cut, of another version or somebody else's: reading it runs nothing, and where it cannot be read it is
made again, with a sentence that names it.
"""

from __future__ import annotations

import hashlib
import inspect
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Cache:
    """A folder of files that can be made again, and a sentence for each that was damaged or could not be kept."""

    folder: Path
    notes: list[str] = field(default_factory=list)

    @classmethod
    def usual(cls) -> Cache:
        """Return that of ``$S2R_CACHE``, else in the user's cache folder."""
        if folder := os.environ.get("S2R_CACHE"):
            return cls(Path(folder))
        return cls(Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "s2r")

    def read(self, place: str, load: Callable[[Path], T]) -> T | None:
        """Return what a file below the folder holds; None if there is none, or if it is damaged.

        ``load`` reads it as data, and raises whatever it likes if it is not what belongs there. The place ends in
        ".npz".
        """
        path = self.folder / place
        if path.is_file():
            try:
                return load(path)
            except Exception:  # what a file of unknown content raises has no end: zip, JSON, memory, shapes
                self.notes.append(f"the cache file {path} was damaged, and was made again")
        return None

    def write(self, place: str, save: Callable[[Path], None]) -> None:
        """Write a file below the folder by ``save``; another process sees it only when it is whole."""
        path = self.folder / place
        part = path.with_suffix(f".{os.getpid()}.part.npz")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                save(part)
                part.replace(path)
            finally:
                part.unlink(missing_ok=True)
        except OSError as error:
            self.notes.append(
                f"the cache file {path} could not be written ({error.strerror}), so the next diagnosis makes it again"
            )

    def kept(
        self, place: str, load: Callable[[Path], T], make: Callable[[], T], save: Callable[[T, Path], None]
    ) -> T:
        """Return what a file below the folder holds, or make it and write it there; see :meth:`read`."""
        made = self.read(place, load)
        if made is None:
            made = make()
            self.write(place, partial(save, made))
        return made


def source_of(kind: type) -> str:
    """Return a hash of the packages that a class and those it is made from are in, or of their files."""
    digest = hashlib.sha256()
    for one in kind.__mro__:
        try:
            file = Path(inspect.getfile(one))
        except (OSError, TypeError):
            continue  # built in, or typed at a prompt
        packaged = (file.parent / "__init__.py").exists()
        if not one.__module__.startswith("s2r_spec."):
            for path in sorted(file.parent.rglob("*.py")) if packaged else (file,):
                digest.update(path.relative_to(file.parent).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
