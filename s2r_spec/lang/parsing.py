"""From tokens to syntax trees; a statement that does not parse becomes a diagnostic and a broken statement."""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import dataclass

from lark import Token, Tree
from lark.exceptions import UnexpectedToken

from s2r_spec.lang import syntax
from s2r_spec.lang.building import build
from s2r_spec.lang.diagnostics import Diagnostic
from s2r_spec.lang.lexing import MOST_TOKENS, grammar, lex, span_of
from s2r_spec.lang.source import Source
from s2r_spec.lang.unexpected import explain, stray_character

DEEPEST = 100
"""Budget: levels of nesting; deeper formulas are refused, since they might exhaust the interpreter's stack."""


@dataclass(frozen=True)
class Parsed:
    """A parsed file: its statements, the statements that did not parse, and their mistakes."""

    source: Source
    statements: tuple[syntax.Statement, ...]
    imports: tuple[syntax.Import, ...]
    broken: tuple[syntax.Broken, ...]
    diagnostics: tuple[Diagnostic, ...]


def parse(source: Source, declared: Set[str] = frozenset()) -> Parsed:
    """Parse every statement of a source by itself; ``declared`` names of imports are not operators. Never raises."""
    lexed = lex(source, declared)
    if lexed.beyond is not None:
        message = f"the text is too long: it has more than {MOST_TOKENS:,} words, numbers, signs and spaces"
        mistake = Diagnostic(
            "E22", message, span_of(source, lexed.beyond), fix="split it into several specifications"
        )
        return Parsed(source, (), (), (), (mistake,))
    statements: list[syntax.Statement] = []
    imports: list[syntax.Import] = []
    broken: list[syntax.Broken] = []
    strays = [stray_character(span_of(source, token)) for token in lexed.stray]
    diagnostics = list(strays)
    for tokens in lexed.statements:
        result = _statement(source, tokens)
        if isinstance(result, Diagnostic):
            span = span_of(source, tokens[0]).to(span_of(source, tokens[-1]))
            name = str(tokens[1]) if len(tokens) > 1 and tokens[1].type == "NAME" else ""
            broken.append(syntax.Broken(span=span, keyword=str(tokens[0]), name=name))
            if not any(span.start <= stray.span.start <= result.span.start for stray in strays):
                # otherwise a stray character, reported before, breaks the statement
                diagnostics.append(result)
        elif isinstance(result, syntax.Import):
            imports.append(result)
        else:
            statements.append(result)
    return Parsed(source, tuple(statements), tuple(imports), tuple(broken), tuple(diagnostics))


def _statement(source: Source, tokens: tuple[Token, ...]) -> syntax.Statement | syntax.Import | Diagnostic:
    parser = grammar().parse_interactive()
    fed = 0
    try:
        for token in tokens:
            parser.feed_token(token)
            fed += 1
        tree = parser.feed_eof(tokens[-1])  # type: ignore[no-untyped-call]  # Lark does not annotate it
    except UnexpectedToken:
        return explain(source, tokens, fed, _allowed_after(tokens[:fed]))
    if (depth := max(level for level, _ in _levels(tree))) > DEEPEST:
        message = f"this statement is nested {depth} levels deep; {DEEPEST} are allowed"
        fix = "define parts of it with `let`"
        return Diagnostic("E19", message, span_of(source, tokens[0]).to(span_of(source, tokens[-1])), fix=fix)
    return build(source, tree)


def _allowed_after(tokens: tuple[Token, ...]) -> set[str]:
    """Return the terminals that can follow; a new parser finds them, since the failed one has reduced too far."""
    parser = grammar().parse_interactive()
    for token in tokens:
        parser.feed_token(token)
    accepts: set[str] = parser.accepts()  # type: ignore[no-untyped-call]  # Lark does not annotate it
    return accepts


def _levels(tree: Tree[Token]) -> Iterator[tuple[int, Tree[Token]]]:
    """Yield every subtree with its depth, without recursion."""
    stack = [(1, tree)]
    while stack:
        level, node = stack.pop()
        yield level, node
        stack.extend((level + 1, child) for child in node.children if isinstance(child, Tree))
