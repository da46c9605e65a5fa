"""From text to tokens, and from tokens to statements.

Two rules are applied here and not in the grammar. Short and foreign operator names (``G``, ``alw``, ``U`` …, as
other tools write them) are operators only if no declaration uses the name. And the text is cut at the keywords
that begin a statement, so each statement is parsed by itself and a mistake in one does not hide another.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Set
from dataclasses import dataclass
from functools import cache
from importlib.util import cache_from_source
from itertools import islice, pairwise
from pathlib import Path

from lark import Lark, Token

from s2r_spec.lang.source import Source, Span

STATEMENTS = frozenset({"SIGNAL", "PARAM", "CONST", "LET", "REQUIRE", "CERTIFY", "IMPORT"})
DECLARATIONS = STATEMENTS - {"REQUIRE", "CERTIFY", "IMPORT"}
_SILENT = frozenset({"WS", "COMMENT"})

_TEMPORAL = {
    "G": "always", "globally": "always", "alw": "always",
    "F": "eventually", "finally": "eventually", "ev": "eventually",
    "H": "historically", "hist": "historically",
    "O": "once",
}  # fmt: skip
_UNTIL = {"U": "until", "S": "since", "R": "release", "W": "unless"}
_STEP = {"X": "next", "Y": "prev"}
_TABLES = {"TEMPORAL": _TEMPORAL, "UNTIL": _UNTIL, "STEP": _STEP, "IFF": {"iff": "<->"}}
MOST_TOKENS = 50_000
"""Budget: words, numbers, signs and spaces of a file. Reading takes time in proportion, and large specifications
have a few thousand."""
ALIASES = {name: (kind, word) for kind, table in _TABLES.items() for name, word in table.items()}
"""Other name of an operator → (terminal, its name in this language)."""


@cache
def grammar() -> Lark:
    """Return the parser of one statement; its tables lie beside Python's compiled modules from the first use on."""
    path = Path(__file__).with_name("stl.lark")
    tables = Path(cache_from_source(str(path))).with_suffix(".tables")
    kept = not sys.dont_write_bytecode and tables.parent.is_dir()
    return Lark(
        path.read_text(encoding="utf-8"),
        start="statement",
        parser="lalr",
        lexer="basic",
        cache=str(tables) if kept else False,
    )


@dataclass(frozen=True)
class Lexed:
    """The tokens of a source, cut into statements.

    Args:
        statements: each begins with a keyword, except the first if the text does not.
        stray: single characters that the language does not have.
        beyond: the first token that is not read, if the source is too long.
    """

    statements: tuple[tuple[Token, ...], ...]
    stray: tuple[Token, ...]
    beyond: Token | None = None


def span_of(source: Source, first: Token, last: Token | None = None) -> Span:
    """Return the span of a token, or of all tokens from ``first`` to ``last``."""
    last = last or first
    assert first.start_pos is not None
    assert last.end_pos is not None
    return Span(source, first.start_pos, last.end_pos)


def lex(source: Source, outside: Set[str] = frozenset()) -> Lexed:
    """Cut a source into tokens and statements; names declared ``outside`` of it are not operators."""
    read = list(islice(grammar().lex(source.text, dont_ignore=True), MOST_TOKENS + 1))
    beyond = read[MOST_TOKENS] if len(read) > MOST_TOKENS else None
    tokens = [token for token in read[:MOST_TOKENS] if token.type not in _SILENT]
    stray = tuple(token for token in tokens if token.type == "STRAY")
    kept = [token for token in tokens if token.type != "STRAY"]
    declared = frozenset(
        str(name) for keyword, name in pairwise(kept) if keyword.type in DECLARATIONS and name.type == "NAME"
    )
    return Lexed(tuple(_statements(kept, declared | outside)), stray, beyond)


def comments(source: Source) -> list[Token]:
    """Return every comment, in order."""
    return [token for token in grammar().lex(source.text, dont_ignore=True) if token.type == "COMMENT"]


def names(text: str) -> list[str]:
    """Return the names of signals, parameters and constants that a formula uses, in order; never raises."""
    tokens = list(grammar().lex(text))
    words = [
        str(token)
        for before, token, after in zip([None, *tokens], tokens, [*tokens[1:], None], strict=False)
        if token.type == "NAME"
        and str(token) not in ALIASES
        and after != "("
        # after a number it is a unit, as in [0, 2 s]
        and (before is None or before.type != "NUMBER")
    ]
    return list(dict.fromkeys(words))


def _statements(tokens: list[Token], declared: Set[str]) -> Iterator[tuple[Token, ...]]:
    starts = [i for i, token in enumerate(tokens) if token.type in STATEMENTS]
    for start, end in zip([0, *starts], [*starts, len(tokens)], strict=True):
        statement = tokens[start:end]
        if not statement:
            continue
        if statement[0].type != "CERTIFY":
            # the first name of a statement is what it declares, not an operator
            statement = [*statement[:2], *(_operator(token, declared) for token in statement[2:])]
        yield tuple(statement)


def _operator(token: Token, declared: Set[str]) -> Token:
    """Return ``always`` for ``G``, ``alw_``, ``[]`` …, and any other token as it is."""
    if token.type == "TEMPORAL" and not token[0].isalpha():
        return token.update(value="always" if token[0] == "[" else "eventually")
    if token == "!==":
        return token.update(value="!=")
    if token.type != "NAME" or str(token) in declared:
        return token
    name = token.removesuffix("_")
    if name in ALIASES:
        kind, word = ALIASES[name]
        return token.update(type=kind, value=word)
    if token.endswith("_") and name in ("always", "eventually", "historically", "once"):
        return token.update(type="TEMPORAL", value=name)
    if token.endswith("_") and name in _UNTIL.values():
        return token.update(type="UNTIL", value=name)
    return token
