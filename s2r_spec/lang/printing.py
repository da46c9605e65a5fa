"""The formatter of specifications.

It works on tokens, so comments and brackets stay. Other names of operators become this language's. A statement is
one line if it fits. Declared names are aligned, and so are definitions and comments in a block of consecutive
lines. Formatting a formatted text changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass
from itertools import groupby

from lark import Token

from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import SpecError
from s2r_spec.lang.formula import walk
from s2r_spec.lang.imports import imported_names
from s2r_spec.lang.lexing import comments, lex
from s2r_spec.lang.parsing import parse
from s2r_spec.lang.source import Source

WIDTH = 110
_INDENT = "    "
_WORDS = {"AND": "and", "OR": "or", "NOT": "not", "IMPLIES": "->", "IFF": "<->"}
_OPERANDS = {"NUMBER", "NAME", "UNIT", "RPAR", "RSQB", "INF", "TRUE", "FALSE"}
_LOOSEST = ("IFF", "IMPLIES", "OR", "AND", "UNTIL")


def format_text(text: str, name: str = "<string>") -> str:
    """Return a specification in the standard layout, with the same meaning; its imports are relative to ``name``.

    Raises:
        SpecError: the text does not parse. Mistakes that only the check finds are not reported.
    """
    source = Source.of(text, name)
    outside = imported_names(source)
    parsed = parse(source, outside)
    if parsed.diagnostics:
        raise SpecError(parsed.diagnostics)
    intervals = {node.span.start for node in walk(*parsed.statements) if isinstance(node, syntax.Interval)}
    lines = _align(list(_lines(source, outside, intervals)))
    return "".join(f"{line}\n" for line in lines)


@dataclass
class _Line:
    """A line of the result before it is aligned.

    Args:
        head: text before the column that a block aligns; "" if there is none.
        column: column of the comment before formatting, from 0.
        kind: keyword of the statement; consecutive lines of one kind form a block.
        blank: whether an empty line comes before.
    """

    head: str = ""
    body: str = ""
    comment: str = ""
    column: int = 0
    kind: str = ""
    blank: bool = False


def _lines(source: Source, outside: Set[str], intervals: set[int]) -> Iterator[_Line]:
    items = [_canonical(tokens) for tokens in lex(source, outside).statements]
    remarks = comments(source)
    last = 0  # last line of the text that was yielded

    def alone(end: float) -> Iterator[_Line]:
        nonlocal last
        while remarks and _start(remarks[0]) < end:
            remark = remarks.pop(0)
            yield _Line(comment=_comment(remark), blank=_place(remark)[0] > last + 1 and last > 0)
            last = _place(remark)[1]

    for number, tokens in enumerate(items):
        yield from alone(_start(tokens[0]))
        start, end = _place(tokens[0])[0], _place(tokens[-1])[1]
        following = items[number + 1] if number + 1 < len(items) else None
        inner: list[Token] = []
        while remarks and _start(remarks[0]) < _start(tokens[-1]):
            inner.append(remarks.pop(0))
        line = _Line(kind=tokens[0].type, blank=start > last + 1 and last > 0)
        # a comment after two statements on one line belongs to the second
        if remarks and _place(remarks[0])[0] == end and not (following and _place(following[0])[0] == end):
            remark = remarks.pop(0)
            line.comment, line.column = _comment(remark), _column(remark)
        last = end
        yield from (
            _keep_lines(tokens, inner, line, intervals) if inner else _statement(tokens, line, intervals)
        )
    yield from alone(math.inf)


def _canonical(tokens: Sequence[Token]) -> list[Token]:
    """Return the tokens in the spelling of this language."""
    depth, written = 0, []
    for index, token in enumerate(tokens):
        depth += (token.type in ("LPAR", "LSQB")) - (token.type in ("RPAR", "RSQB"))
        word = _WORDS.get(token.type, str(token))
        if token.type == "UNIT":
            word = "{" + " ".join(token[1:-1].split()) + "}"
        elif token.type == "COLON" and depth:
            word = ","
        elif token.type == "EQ" and tokens[0].type == "LET" and index == _head_length(tokens):
            word = ":="
        written.append(token.update(value=word))
    return written


def _start(token: Token) -> int:
    assert token.start_pos is not None
    return token.start_pos


def _column(token: Token) -> int:
    """Return the column of a comment, from 0; 0 if it is beyond the line's width."""
    column = (token.column or 1) - 1
    return column if column <= WIDTH else 0


def _place(token: Token) -> tuple[int, int]:
    assert token.line is not None
    assert token.end_line is not None
    return token.line, token.end_line


def _comment(token: Token) -> str:
    text = token.removeprefix("//") if token.startswith("//") else token.removeprefix("#")
    return f"# {text[1:] if text.startswith(' ') else text}".rstrip()


def _statement(tokens: Sequence[Token], line: _Line, intervals: set[int]) -> Iterator[_Line]:
    cut = _head_length(tokens)
    line.head, line.body = _join_tokens(tokens[:cut], intervals), _join_tokens(tokens[cut:], intervals)
    if len(line.head) + len(line.body) + 1 <= WIDTH:
        yield line
        return
    comment, line.comment = line.comment, ""
    parts = list(_broken(tokens[cut:]))
    line.body = ""
    yield _Line(body=_join_words(line.head, ""), kind="", blank=line.blank)
    for part in parts:
        last = part is parts[-1]
        yield _Line(
            body=_INDENT + _join_tokens(part, intervals),
            comment=comment if last else "",
            column=line.column if last else 0,
        )


def _head_length(tokens: Sequence[Token]) -> int:
    """Return the number of tokens in the head: up to the colon, or up to the declared name."""
    types = [token.type for token in tokens]
    if types[0] in ("LET", "CONST"):
        return next(i for i, kind in enumerate(types) if kind in ("ASSIGN", "EQ"))
    if types[0] in ("SIGNAL", "PARAM"):
        return next((i for i, kind in enumerate(types) if kind in ("UNIT", "BOOL", "EQ", "IN")), len(types))
    return types.index("COLON") + 1 if types[0] in ("REQUIRE", "CERTIFY") else len(tokens)


def _broken(tokens: Sequence[Token]) -> Iterator[list[Token]]:
    """Cut a long body before its loosest operators, or after its commas."""
    depth, level = 0, []
    for token in tokens:
        depth -= token.type in ("RPAR", "RSQB")
        level.append(depth)
        depth += token.type in ("LPAR", "LSQB")
    top = [token.type for token, at in zip(tokens, level, strict=True) if at == 0]
    split = next((kind for kind in ("COMMA", *_LOOSEST) if kind in top), None)
    part: list[Token] = []
    for token, at in zip(tokens, level, strict=True):
        here = at == 0 and token.type == split
        if here and split != "COMMA":
            yield part
            part = []
        part.append(token)
        if here and split == "COMMA":
            yield part
            part = []
    yield part


def _keep_lines(
    tokens: Sequence[Token], inner: Sequence[Token], line: _Line, intervals: set[int]
) -> Iterator[_Line]:
    everything = sorted([*tokens, *inner], key=_start)
    for number, group in groupby(everything, key=lambda token: _place(token)[0]):
        parts = list(group)
        words = [token for token in parts if token.type != "COMMENT"]
        remark = parts[-1] if parts[-1].type == "COMMENT" else None
        first = number == _place(tokens[0])[0]
        last = number == _place(tokens[-1])[0]
        yield _Line(
            body=("" if first else _INDENT) + _join_tokens(words, intervals) if words else "",
            comment=_comment(remark) if remark else (line.comment if last else ""),
            column=_column(remark) if remark else line.column,
            blank=line.blank and first,
        )


def _join_tokens(tokens: Sequence[Token], intervals: set[int]) -> str:
    text, before, signed = "", None, False
    for token in tokens:
        if before is not None and not signed and not _tight(before, token, intervals):
            text = f"{text.ljust(6)} " if before.type in ("SIGNAL", "PARAM", "CONST") else f"{text} "
        signed = token.type == "MINUS" and (before is None or before.type not in _OPERANDS)
        text += token
        before = token
    return text


def _tight(before: Token, token: Token, intervals: set[int]) -> bool:
    if before.type in ("LPAR", "LSQB", "POW") or token.type in ("RPAR", "RSQB", "COMMA", "COLON", "POW"):
        return True
    if token.start_pos in intervals:
        return True
    return before.type == "NAME" and token.type in ("LPAR", "LSQB")


def _join_words(head: str, body: str) -> str:
    return f"{head} {body}".rstrip() if head else body


def _align(lines: list[_Line]) -> Iterator[str]:
    for block in _blocks(lines):
        for kind in ("SIGNAL", "PARAM", "CONST", "LET", "REQUIRE", "CERTIFY"):
            heads = [len(line.head) for line in block if line.kind == kind and line.body]
            for line in block:
                if line.kind == kind and line.body:
                    line.head = line.head.ljust(max(heads))
        texts = [_join_words(line.head, line.body) for line in block]
        remarks = [line for line, text in zip(block, texts, strict=True) if line.comment and text]
        ends = [len(text) + 2 for line, text in zip(block, texts, strict=True) if line in remarks]
        column = max([*ends, *(line.column for line in remarks)], default=0)
        for line, text in zip(block, texts, strict=True):
            if line.blank:
                yield ""
            yield f"{text.ljust(column)}{line.comment}" if text and line.comment else text + line.comment


def _blocks(lines: list[_Line]) -> Iterator[list[_Line]]:
    """Yield the blocks of lines, which end at empty lines and at comments on their own line."""
    block: list[_Line] = []
    for line in lines:
        alone = not (line.head or line.body)
        if block and (line.blank or alone):
            yield block
            block = []
        block.append(line)
        if alone:
            yield block
            block = []
    if block:
        yield block
