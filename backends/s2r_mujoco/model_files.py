"""The files of a MuJoCo model: what its XML includes and loads, found in the text alone.

The text is searched, because MuJoCo's parser accepts what a strict XML parser refuses, such as two hyphens in a
comment, and expands no entities. Names are relative to the folder of the main file, also in a file that it includes. A
model that is attached has a folder and a ``<compiler>`` of its own, and its name is relative to the file that names it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path, PureWindowsPath

from s2r_mujoco.markup import is_file, read_elements

_FOLDERS = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "texture": "texturedir"}
"""Definition: element with a file → attribute of ``<compiler>`` with the folder of this file."""
_FILE = re.compile(r"file(name|right|left|up|down|front|back)?")
"""Definition: attributes that name a file."""


def model_files(path: Path) -> tuple[Path, ...]:
    """Return a model's file, and every file that it includes, attaches or loads; a missing one is left out."""
    return tuple(dict.fromkeys(_files(path, set())))


def _files(path: Path, seen: set[Path]) -> Iterator[Path]:
    if path in seen or not is_file(path):
        return
    root, texts = path.parent, dict[Path, str]()
    top = read_elements(path, root, texts)
    seen |= texts.keys()
    yield from texts
    elements = [] if top is None else [one for one in top.every() if one.name != "include"]
    compiler = {
        key: value for one in elements if one.name == "compiler" for key, value in one.attributes.items()
    }
    for one in elements:
        folder = compiler.get(_FOLDERS.get(one.name, ""), compiler.get("assetdir", ""))
        for file in (value for key, value in one.attributes.items() if _FILE.fullmatch(key)):
            if one.name == "model":
                for place in (one.file.parent / file, root / file):
                    yield from _files(place, seen)
                continue
            places = (root / folder / file, root / folder / PureWindowsPath(file).name, root / file)
            yield from filter(is_file, places)
