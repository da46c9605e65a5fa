"""The files of a MuJoCo model: what its XML includes and loads, found in the text alone.

The text is searched, because MuJoCo's parser accepts what a strict XML parser refuses, such as two hyphens in a
comment, and expands no entities. Names are relative to the folder of the main file, also in a file that it includes. A
model that is attached has a folder and a ``<compiler>`` of its own, and its name is relative to the file that names it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import unescape
from pathlib import Path, PureWindowsPath

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_TAG = re.compile(rb"<(\w+)((?:\s+[\w:.-]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))+)")
_ATTRIBUTE = re.compile(rb"([\w:.-]+)\s*=\s*(?:\"([^\"]*)\"|'([^']*)')")
_FOLDERS = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "texture": "texturedir"}
"""Definition: element with a file → attribute of ``<compiler>`` with the folder of this file."""
_FILE = re.compile(r"file(name|right|left|up|down|front|back)?")
"""Definition: attributes that name a file."""

Tag = tuple[Path, str, dict[str, str]]
"""Definition: folder of the file, name and attributes of an element."""


def model_files(path: Path) -> tuple[Path, ...]:
    """Return a model's file, and every file that it includes, attaches or loads; a missing one is left out."""
    return tuple(dict.fromkeys(_files(path, set())))


def _files(path: Path, seen: set[Path]) -> Iterator[Path]:
    root, tags = path.parent, []
    for text, found in _texts(path, path.parent, seen):
        yield text
        tags += found
    compiler = {key: value for _, name, values in tags if name == "compiler" for key, value in values.items()}
    for own, name, values in tags:
        folder = compiler.get(_FOLDERS.get(name, ""), compiler.get("assetdir", ""))
        for file in (value for key, value in values.items() if _FILE.fullmatch(key)):
            if name == "include":
                continue
            if name == "model":
                for place in (own / file, root / file):
                    yield from _files(place, seen)
                continue
            places = (root / folder / file, root / folder / PureWindowsPath(file).name, root / file)
            yield from (one for one in places if _is_file(one))


def _texts(path: Path, root: Path, seen: set[Path]) -> Iterator[tuple[Path, list[Tag]]]:
    """Yield an XML file and every one that it includes, with their elements."""
    if path in seen or not _is_file(path):
        return
    seen.add(path)
    tags = [
        (
            path.parent,
            name.decode(),
            {key.decode(): _text(one or other) for key, one, other in _ATTRIBUTE.findall(rest)},
        )
        for name, rest in _TAG.findall(_COMMENT.sub(b"", path.read_bytes()))
    ]
    yield path, tags
    for _, name, values in tags:
        if name == "include" and "file" in values:
            yield from _texts(root / values["file"], root, seen)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # for instance a name that is too long
        return False


def _text(value: bytes) -> str:
    # A NUL is in no path, and Python refuses to look for one.
    return unescape(value.decode(errors="surrogateescape")).replace("\0", "")
