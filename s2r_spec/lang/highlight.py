"""Colours for Pygments, and so for Sphinx and rich: the lexer named ``s2r-stl``."""

from __future__ import annotations

from typing import ClassVar

from pygments.lexer import RegexLexer, words
from pygments.token import Comment, Keyword, Literal, Name, Number, Operator, Punctuation, Text

from s2r_spec.lang.functions import FUNCTIONS

STATEMENTS = ("signal", "param", "const", "let", "require", "certify", "import")
TEMPORAL = (
    "always", "eventually", "historically", "once", "until", "since", "release", "unless", "next", "prev",
)  # fmt: skip


class StlLexer(RegexLexer):
    """Signal temporal logic in the syntax of s2r."""

    name = "s2r signal temporal logic"
    aliases: ClassVar[list[str]] = ["s2r-stl"]
    filenames: ClassVar[list[str]] = []  # .stl is also the ending of mesh files

    tokens: ClassVar[dict[str, list[tuple[object, ...]]]] = {
        "root": [
            (r"\s+", Text),
            (r"(#|//).*?$", Comment.Single),
            (words(STATEMENTS, suffix=r"\b"), Keyword.Declaration),
            (words(TEMPORAL, suffix=r"\b"), Keyword),
            (words(("and", "or", "not", "implies", "iff"), suffix=r"\b"), Operator.Word),
            (words(("in", "bool"), suffix=r"\b"), Keyword.Type),
            (words(("true", "false", "inf"), suffix=r"\b"), Keyword.Constant),
            (words(tuple(FUNCTIONS), suffix=r"(?=\s*\()"), Name.Builtin),
            (r"\{[^{}\n]*\}", Literal),
            (r'"[^"\n]*"', Literal.String),
            (r"(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", Number),
            (r"[A-Za-z][A-Za-z0-9_]*", Name),
            (r"<->|<=>|->|=>|:=|!==|[<>=!]=|&&?|\|\|?|/\\|\\/|[-+*/^<>=!]", Operator),
            (r"[\[\](),:_]", Punctuation),
        ]
    }
