"""A random draw of what a person reads, to be read aloud: sentences, and docstrings of public functions."""

from __future__ import annotations

import ast
import random
from collections.abc import Iterator, Mapping

from s2r_spec import documentation
from tests.prose.sentences import SPAN, split, words
from tests.prose.sources import HELP, LEAST, ROOT, command_help, literals, markdown, markdown_files

PACKAGES = ("s2r_spec", "backends")
OTHER_PAGES = "benchmarks/"
"""Pages below this folder are not drawn."""
OTHER_DOCSTRINGS = "s2r_spec/diagnose/"
"""Messages of this package are drawn, and its docstrings are not."""

Line = tuple[str, str]
"""(place, text)."""


def draw(count: int, seed: int) -> list[str]:
    """Return ``count`` sentences and half as many docstrings, each as one line: its place, then its text."""
    rng = random.Random(seed)
    files = sorted(file for top in PACKAGES for file in (ROOT / top).rglob("*.py"))
    trees = {file.relative_to(ROOT).as_posix(): ast.parse(file.read_text(encoding="utf-8")) for file in files}
    sentences, docstrings = sorted({*_pages(), *_messages(trees)}), sorted(_docstrings(trees))
    drawn = rng.sample(sentences, count) + rng.sample(docstrings, count // 2)
    return [f"{place}: {' '.join(text.split()).replace(SPAN, '`…`')}" for place, text in drawn]


def _pages() -> Iterator[Line]:
    pages = {HELP: list(command_help())}
    for file in markdown_files():
        name, text = file.relative_to(ROOT).as_posix(), markdown(documentation.read(file))
        if not name.startswith(OTHER_PAGES):
            pages[name] = [*text.paragraphs, *text.fragments]
    for place, paragraphs in pages.items():
        for paragraph in paragraphs:
            yield from ((place, sentence) for sentence in split(paragraph) if words(sentence) >= LEAST)


def _messages(trees: Mapping[str, ast.Module]) -> Iterator[Line]:
    for name, tree in trees.items():
        for line, paragraph in literals(tree):
            yield from ((f"{name}:{line}", sentence) for sentence in split(paragraph))


def _docstrings(trees: Mapping[str, ast.Module]) -> Iterator[Line]:
    for name, tree in trees.items():
        for node in () if name.startswith(OTHER_DOCSTRINGS) else ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                text = ast.get_docstring(node)
                if text:
                    yield f"{name}:{node.lineno} {node.name}", text
