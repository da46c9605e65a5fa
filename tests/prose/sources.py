"""What a person reads of this project: pages, the command line's help, messages in the code, docstrings."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import typer
from markdown_it import MarkdownIt
from markdown_it.token import Token

from s2r_spec import documentation
from tests.prose.sentences import SPAN, Measure, measure

ROOT = Path(__file__).resolve().parents[2]
HELP = "s2r --help"
"""Name of the page of the command line's help."""

LEAST = 5
"""A string literal with fewer words is a name, a key or a label, and no sentence."""

_STRINGS = (ast.Constant, ast.JoinedStr, ast.BinOp)
_EMPTY = (ast.Name, ast.expr_context, ast.operator)
_PARSER = MarkdownIt("commonmark").enable("table")
_FRONT_MATTER = re.compile(r"\A---\n.*?\n---\n", re.S)
_DIRECTIVE = re.compile(r"^ *:::.*$", re.M)
_ROLE = re.compile(r"\{[\w:-]+\}(?=`)")
_MATH = re.compile(r"\$\$.*?\$\$|(?<![\w$])\$[^$\n]+\$(?![\w$])", re.S)
_WORD = re.compile(r"\b[A-Za-z][a-z]*\b")


class Text(NamedTuple):
    """Paragraphs, and what is no sentence by itself: headings and cells."""

    paragraphs: list[str]
    fragments: list[str]


def markdown(text: str) -> Text:
    """Return the prose of a Markdown page, without code, comments, front matter and formulas."""
    text = _FRONT_MATTER.sub("", text)
    text = _MATH.sub(SPAN, _ROLE.sub("", _DIRECTIVE.sub("", text)))
    found = Text([], [])
    tokens = _PARSER.parse(text)
    for before, token in pairwise(tokens):
        if token.type == "inline":
            (found.paragraphs if before.type == "paragraph_open" else found.fragments).append(_inline(token))
    return found


def _inline(token: Token) -> str:
    return "".join(
        {"code_inline": SPAN, "softbreak": " ", "hardbreak": " ", "text": child.content}.get(child.type, "")
        for child in token.children or ()
    )


def _plain(text: str) -> str:
    """Return a docstring's or message's text with its code spans and formulas as one word each."""
    return re.sub(r"``[^`]+``|`[^`]+`", SPAN, _MATH.sub(SPAN, text))


def literals(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of each message of a module: string literals with sentences, not docstrings.

    A field of an f-string is one word. Strings that are added are one string.
    """
    todo = [tree]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            continue
        text = _joined(node) if isinstance(node, _STRINGS) else None
        if text is None:
            todo.extend(reversed(_children(node)))
            continue
        for paragraph in re.split(r"\n\s*\n|\n(?=\s)", text):
            if " " in paragraph.strip() and len(_WORD.findall(paragraph)) >= LEAST:
                yield node.lineno, _plain(paragraph)


def _children(node: ast.AST) -> list[ast.AST]:
    """Return the nodes directly below a node that can hold a sentence; a name or the key of a dictionary cannot."""
    found: list[ast.AST] = []
    fields = ("values",) if isinstance(node, ast.Dict) else node._fields
    for value in map(node.__dict__.get, fields):
        if isinstance(value, list):
            found += [one for one in value if isinstance(one, ast.AST)]
        elif isinstance(value, ast.AST) and not isinstance(value, _EMPTY):
            found.append(value)
    return found


def _joined(node: ast.AST) -> str | None:
    """Return the text of a string expression, or None where it is another expression."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else SPAN for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = _joined(node.left), _joined(node.right)
        if left is None and right is None:
            return None
        return (SPAN if left is None else left) + (SPAN if right is None else right)
    return None


def docstrings(tree: ast.AST) -> Iterator[str]:
    """Yield the first paragraph of each docstring."""
    todo = [tree]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield _plain(re.split(r"\n\s*\n", text)[0])
        todo.extend(child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt))


def command_help() -> Iterator[str]:
    """Yield the help of each command, its arguments and its options, those that are hidden left out."""
    from s2r_spec.cli import app

    todo = [typer.main.get_command(app)]
    while todo:
        command = todo.pop()
        if command.hidden:
            continue
        yield from (_plain(part) for part in re.split(r"\n\s*\n", command.help or "") if part.strip())
        yield from (_plain(option.help) for option in command.params if getattr(option, "help", None))
        todo += getattr(command, "commands", {}).values()


def markdown_files() -> list[Path]:
    """Return every Markdown page of the repository."""
    files = [
        *ROOT.glob("*.md"),
        *documentation.pages(ROOT / "docs").values(),
        *(ROOT / "benchmarks").rglob("*.md"),
    ]
    return sorted(file for file in files if not {"_build", "runs"} & set(file.relative_to(ROOT).parts))


def markdown_pages() -> dict[str, Measure]:
    """Return the measure of every Markdown page of the repository, by its path."""
    return {
        file.relative_to(ROOT).as_posix(): measure(*markdown(documentation.read(file)))
        for file in markdown_files()
    }


def package_pages() -> dict[str, Measure]:
    """Return the measures of messages and docstrings of every package, so that files may move within one."""
    gathered: dict[str, list[str]] = {}
    for top in ("s2r_spec", "backends"):
        for file in sorted((ROOT / top).rglob("*.py")):
            place = "/".join(file.relative_to(ROOT).parts[:2]) if file.parent != ROOT / top else top
            tree = ast.parse(file.read_text(encoding="utf-8"))
            gathered.setdefault(f"{place}: messages", []).extend(text for _, text in literals(tree))
            gathered.setdefault(f"{place}: docstrings", []).extend(docstrings(tree))
    return {name: measure(paragraphs) for name, paragraphs in gathered.items()}


def pages() -> dict[str, Measure]:
    """Return the measure of everything, by the page's name."""
    return {**markdown_pages(), HELP: measure(command_help()), **package_pages()}
