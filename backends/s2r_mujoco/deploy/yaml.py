"""Strangers' YAML as plain values: mappings, lists, numbers, words and marks for unknown tags.

PyYAML's parser makes a graph of nodes; the values are built here, so no tag can create an object. Budgets bound size,
depth and, with every alias expanded, the number of values.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from s2r_spec.errors import UsageError, require, shortened

MOST_BYTES = 1_000_000
"""Budget: size of a file [B]. Deploy files have 1 to 20 kB."""
MOST_VALUES = 50_000
"""Budget: values of a file with its aliases expanded, so that nested aliases cannot fill the memory. A deploy file has
about 1,000; its parts are linear in joints and terms."""
DEEPEST = 30
"""Budget: levels of nesting. Deploy files have 5."""

_WHOLE = re.compile(r"[-+]?\d+")
_NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF|nan|NaN|NAN)")
_NULL = {"", "~", "null", "Null", "NULL"}
_TRUTH = {"true": True, "false": False, "yes": True, "no": False, "on": True, "off": False}
_STANDARD = "tag:yaml.org,2002:"
_PLAIN = {"null", "bool", "int", "float", "str", "timestamp", "value", "map", "seq", "python/tuple"}


@dataclass(frozen=True)
class Tagged:
    """A value with a tag that has no meaning here, such as ``!!python/object/apply:builtins.slice``; no object."""

    tag: str
    value: Any


def read(path: Path) -> Any:
    """Return the plain values of a YAML file.

    Raises:
        UsageError: the file cannot be read, is too large, too deep or not YAML, repeats a key, or has a number that is
            not finite.
    """
    if path.exists() and not path.is_file():  # a pipe would keep us waiting
        raise UsageError(f"cannot read {path}: it is not a file")
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from None
    if len(content) > MOST_BYTES:
        raise UsageError(f"{path} has more than {MOST_BYTES // 1000} kB; a deploy file has less")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise UsageError(f"{path}, line {line}: the text is not UTF-8") from None
    return parse(text, str(path))


@dataclass(frozen=True)
class Number:
    """A number in a text: the keys and indices that lead to it (several by aliases), its place, and its value."""

    paths: tuple[tuple[str | int, ...], ...]
    start: int
    stop: int
    line: int
    value: float
    whole: bool


def parse(text: str, source: str) -> Any:
    """Return the plain values of a YAML text; ``source`` names it in messages. Errors as :func:`read`."""
    node = _node(text, source)
    return None if node is None else _Builder(source).value(node)


def numbers(text: str, source: str) -> tuple[Number, ...]:
    """Return every number in a YAML text that :func:`parse` reads, in the order of the text."""
    found: dict[tuple[int, int], Number] = {}

    def walk(node: Any, path: tuple[str | int, ...]) -> None:
        if node.id == "sequence":
            for index, child in enumerate(node.value):
                walk(child, (*path, index))
        elif node.id == "mapping":
            for key, child in node.value:
                walk(child, (*path, key.value))
        elif node.style is None and _NUMBER.fullmatch(node.value):
            place = node.start_mark.index, node.end_mark.index
            before = found[place].paths if place in found else ()
            line, whole = node.start_mark.line + 1, bool(_WHOLE.fullmatch(node.value))
            found[place] = Number((*before, path), *place, line, float(node.value), whole)

    if parse(text, source) is not None:
        walk(_node(text, source), ())
    return tuple(found[place] for place in sorted(found))


def _node(text: str, source: str) -> Any:
    """Return the parser's tree."""
    require("deploy files need", "yaml", "mujoco")
    import yaml

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        """The parser, which stops at the budgets before the memory is full."""

        depth = 0
        count = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            self.count += 1
            self.depth += 1
            _within(self.count, self.depth, source, self.peek_event().start_mark.line)
            node = super().compose_node(parent, index)
            self.depth -= 1
            return node

    try:
        loader = Loader(text)
        try:
            return loader.get_single_node()
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = (error.problem or error.context or "it cannot be read").removeprefix("but ")
        raise UsageError(
            f"{source}, line {mark.line + 1}: the YAML is broken: {shortened(problem)}"
        ) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise UsageError(f"{source}, line {line}: the YAML is broken: a character is not printable") from None


def _within(count: int, depth: int, source: str, line: int) -> None:
    if depth > DEEPEST:
        raise UsageError(f"{source}, line {line + 1}: the values are nested deeper than {DEEPEST} levels")
    if count > MOST_VALUES:
        raise UsageError(
            f"{source} has more than {MOST_VALUES:,} values with its aliases; a deploy file has less"
        )


@dataclass
class _Builder:
    """Values of nodes; counts each value as often as an alias repeats it."""

    source: str
    count: int = field(default=0, init=False)

    def value(self, node: Any, depth: int = 1) -> Any:
        self.count += 1
        _within(self.count, depth, self.source, node.start_mark.line)
        if node.id == "scalar":
            value = self._scalar(node)
        elif node.id == "sequence":
            value = [self.value(child, depth + 1) for child in node.value]
        else:
            value = self._mapping(node, depth)
        tag = node.tag.removeprefix(_STANDARD)
        return value if tag in _PLAIN else Tagged(shortened(tag), value)

    def _mapping(self, node: Any, depth: int) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for key_node, child in node.value:
            if key_node.id != "scalar":
                self._fail(key_node, "a key is a list or a mapping; use a word")
            key = key_node.value
            if key_node.tag == f"{_STANDARD}merge":
                self._fail(key_node, "the merge key '<<' is not supported; write the values out")
            if key in values:
                self._fail(key_node, f"the key {shortened(key)!r} occurs twice; remove one")
            values[key] = self.value(child, depth + 1)
        return values

    def _scalar(self, node: Any) -> Any:
        text: str = node.value
        if node.style is not None:
            return text  # in quotes
        if text in _NULL:
            return None
        if text.lower() in _TRUTH:
            return _TRUTH[text.lower()]
        if _NOT_FINITE.fullmatch(text):
            self._fail(node, f"{text} is not a finite number")
        if not _NUMBER.fullmatch(text):
            return text
        number = float(text)  # also 1e-3, which is text in YAML 1.1, and a number for the robots' controllers
        if not math.isfinite(number):
            self._fail(node, f"{shortened(text)} is not a finite number")
        return int(text) if _WHOLE.fullmatch(text) else number

    def _fail(self, node: Any, problem: str) -> None:
        raise UsageError(f"{self.source}, line {node.start_mark.line + 1}: {problem}")
