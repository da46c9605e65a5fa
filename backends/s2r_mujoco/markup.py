"""The elements of a MuJoCo model in the text of its XML files, and changes of single attributes of them.

Everything else of the text stays as it is: comments, spaces, the order of attributes. An XML library would lose spaces
between attributes, and refuses what MuJoCo's parser accepts, such as two hyphens in a comment.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape, unescape
from pathlib import Path

_TOKEN = re.compile(
    r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|<![^>]*>"
    r"|</(?P<end>[\w:.-]+)\s*>"
    r"|<(?P<name>[\w:.-]+)(?P<attributes>(?:\s+[\w:.-]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*)\s*(?P<closed>/?)>",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r"\s+(?P<name>[\w:.-]+)\s*=\s*(?P<value>\"[^\"]*\"|'[^']*')")
_REAL = frozenset(("mujoco", "mujocoinclude", "include", "worldbody", "body", "frame", "actuator", "contact"))
"""Definition: elements that hold elements of the model; a default, a composite or a replicate holds patterns."""


@dataclass(eq=False)
class Element:
    """An element of an XML text.

    Attributes:
        file: the file whose text has it.
        name: of the element.
        attributes: as MuJoCo reads them.
        start, stop: of its start tag in the text; ``end`` is the start of its end tag, or ``stop`` without one.
        above: the element around it; None for the outermost. An included file is within its ``<include>``.
        below: the elements in it.
    """

    file: Path
    name: str
    attributes: dict[str, str]
    start: int
    stop: int
    end: int
    above: Element | None
    below: list[Element] = field(default_factory=list)

    def every(self) -> Iterator[Element]:
        """Yield the element and all within, in the order of the text."""
        yield self
        for one in self.below:
            yield from one.every()

    @property
    def is_real(self) -> bool:
        """Whether it is itself a part of the model, no pattern for some."""
        return self.above is None or (self.above.name in _REAL and self.above.is_real)


@dataclass
class Markup:
    """The texts of a model's files as elements, and the changes of them.

    Attributes:
        root: the outermost element of the main file.
        texts: file → its text; the main file is the first.
    """

    root: Element
    texts: dict[Path, str]
    _changes: dict[Element, dict[str, str | None]] = field(default_factory=dict)
    _renamed: dict[Element, str] = field(default_factory=dict)
    _inserted: dict[Element, list[str]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> Markup:
        """Read a model's file and all that it includes.

        Raises:
            ValueError: the text is not that of a MuJoCo model.
        """
        texts: dict[Path, str] = {}
        root = read_elements(path, path.parent, texts)
        if root is None or root.name != "mujoco":
            raise ValueError(f"{path.name} is not a model in MuJoCo's own format")
        return cls(root, texts)

    def real(self, name: str) -> list[Element]:
        """Return the elements of a name that are parts of the model."""
        return [one for one in self.root.every() if one.name == name and one.is_real]

    def change(self, element: Element, attributes: Mapping[str, str | None]) -> None:
        """Give an element other values of attributes; None leaves one out."""
        self._changes.setdefault(element, {}).update(attributes)

    def rename(self, element: Element, name: str) -> None:
        """Give an element another name."""
        self._renamed[element] = name

    def insert(self, element: Element, text: str) -> None:
        """Put a text on a line of its own, as the first in an element."""
        self._inserted.setdefault(element, []).insert(0, text)

    @property
    def changed(self) -> set[Path]:
        """Files with changes."""
        return {element.file for edits in (self._changes, self._renamed, self._inserted) for element in edits}

    def written(self) -> dict[Path, str]:
        """Return file → its text with all changes."""
        texts = dict(self.texts)
        edits = [edit for element in self.root.every() for edit in self._edits(element)]
        for file, start, stop, new in sorted(edits, key=lambda edit: edit[1:3], reverse=True):
            texts[file] = texts[file][:start] + new + texts[file][stop:]
        return texts

    def _edits(self, element: Element) -> Iterator[tuple[Path, int, int, str]]:
        """Yield the file, the place and the new text of each change of an element."""
        name = self._renamed.get(element, element.name)
        old = self.texts[element.file][element.start : element.stop]
        tag, inside = self._tag(element, name, old), self._inserted.get(element, [])
        has_end = element.end > element.stop or not old.endswith("/>")
        if inside:
            lines = "".join(f"{self._indent(element)}{text}" for text in inside)
            tag = f"{tag}{lines}" if has_end else f"{tag[:-2].rstrip()}>{lines}</{name}>"
        if tag != old:
            yield element.file, element.start, element.stop, tag
        if has_end and name != element.name:
            stop = element.end + len(f"</{element.name}")
            yield element.file, element.end, stop, f"</{name}"

    def _tag(self, element: Element, name: str, tag: str) -> str:
        """Return the start tag with other attributes."""
        tag = f"<{name}{tag[1 + len(element.name) :]}"
        for key, value in self._changes.get(element, {}).items():
            new = "" if value is None else f' {key}="{escape(value)}"'
            for match in _ATTRIBUTE.finditer(tag):
                if match["name"] == key:
                    space = tag[match.start() : match.start("name")]
                    tag = tag[: match.start()] + (space + new[1:] if new else "") + tag[match.end() :]
                    break
            else:
                head = tag[:-2] if tag.endswith("/>") else tag[:-1]
                tag = f"{head.rstrip()}{new}{tag[len(head.rstrip()) :]}"
        return tag

    def _indent(self, element: Element) -> str:
        """Return the line feed and the spaces before the first element in this one."""
        text = self.texts[element.file]
        first = next((one for one in element.below if one.file == element.file), element)
        line = text[text.rfind("\n", 0, first.start) + 1 : first.start]
        space = line[: len(line) - len(line.lstrip())]
        feed = "\r\n" if "\r\n" in text else "\n"
        return feed + space + ("  " if first is element else "")


def read_elements(
    path: Path, root: Path, texts: dict[Path, str], above: Element | None = None
) -> Element | None:
    """Return the outermost element of a file, and add its text and those that it includes; None where there is none.

    Names of included files are relative to ``root``, the folder of the main file.
    """
    text = texts[path] = path.read_bytes().decode("utf-8", "surrogateescape")
    first, place = None, above
    for token in _TOKEN.finditer(text):
        if token["end"] is not None and place is not None and place is not above:
            place.end = token.start()
            place = place.above
        if token["name"] is None:
            continue
        attributes = {
            one["name"]: unescape(one["value"][1:-1]) for one in _ATTRIBUTE.finditer(token["attributes"])
        }
        one = Element(path, token["name"], attributes, *token.span(), token.end(), place)
        first = first or one
        if place is not None:
            place.below.append(one)
        included = root / attributes.get("file", "")
        if one.name == "include" and is_file(included) and included not in texts:
            read_elements(included, root, texts, one)
        if not token["closed"]:
            place = one
    return first


def is_file(path: Path) -> bool:
    """Return whether there is a file of this name; also for one that is too long."""
    try:
        return path.is_file()
    except OSError:
        return False
