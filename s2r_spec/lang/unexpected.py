"""Messages for a statement that does not parse, with words in place of the grammar's terminals."""

from __future__ import annotations

from collections.abc import Sequence, Set

from lark import Token

from s2r_spec.lang.diagnostics import Diagnostic, suggestion
from s2r_spec.lang.lexing import ALIASES, STATEMENTS, span_of
from s2r_spec.lang.source import Source, Span

_WORDS = {
    "NAME": "a name", "NUMBER": "a number", "UNIT": "a unit in braces", "INF": "`inf`", "IN": "`in`",
    "LPAR": "`(`", "RPAR": "`)`", "LSQB": "`[`", "RSQB": "`]`", "COMMA": "`,`", "COLON": "`:`",
    "BOOL": "`bool`", "STRING": "a file in quotes", "EQ": "`=`", "ASSIGN": "`:=`", "$END": "the end of the statement",
}  # fmt: skip
_EXPRESSION = frozenset({"NUMBER", "NAME", "LPAR", "MINUS"})
_FORMULA = _EXPRESSION | {"NOT", "TEMPORAL", "STEP", "TRUE", "FALSE"}
_OPERATORS = frozenset(
    {"PLUS", "MINUS", "TIMES", "DIV", "POW", "CMP", "AND", "OR", "IMPLIES", "IFF", "UNTIL"}
)
_NAMES = "a name is a letter from a to z, followed by letters, digits and `_`"
_MEANT = {
    "~": "not", "¬": "not", "∧": "and", "∨": "or", "→": "->", "⇒": "->", "↔": "<->", "⇔": "<->", "≤": "<=", "≥": ">=",
    "≠": "!=", "□": "always", "◻": "always", "◇": "eventually", "◊": "eventually", "⊤": "true", "⊥": "false",
    "∞": "inf", "−": "-", "·": "*", "×": "*",
}  # fmt: skip
"""Sign in textbooks → its spelling in this language."""
_CLOSING = {"LPAR": ("RPAR", ")"), "LSQB": ("RSQB", "]")}
_KEYWORDS = tuple(word.lower() for word in STATEMENTS)
_ANY_KEYWORD = "signal, param, const, let, require, certify or import"


def stray_character(span: Span) -> Diagnostic:
    """Return the diagnostic of a character that begins no token."""
    fix = {
        "{": "write a unit in braces, on one line, such as {m/s}",
        "}": "write a unit in braces, on one line, such as {m/s}",
        "'": "write names without quotes",
        '"': "write names without quotes",
        ".": f"{_NAMES}; write the name of a file in quotes",
        ";": "remove the semicolon; a statement ends where the next one begins",
    }.get(span.text)
    if fix is None and (span.text == "_" or span.text.isalpha()):
        fix = _NAMES
    if fix is None and span.text in _MEANT:
        fix = f"write `{_MEANT[span.text]}`"
    fix = fix or "remove it"
    return Diagnostic("E01", f"the character `{span.text}` has no meaning here", span, fix=fix)


def explain(source: Source, tokens: Sequence[Token], position: int, allowed: Set[str]) -> Diagnostic:
    """Return the diagnostic of the token at ``position``, or of the end, that cannot follow the tokens before it.

    The ``allowed`` terminals could stand there.
    """
    if position == len(tokens):
        return _end(source, tokens, allowed)
    token = tokens[position]
    span = span_of(source, token)
    if position == 0:
        guess = suggestion(str(token), _KEYWORDS)
        message = f"a statement cannot begin with `{span.text}`"
        return Diagnostic("E01", message, span, fix=guess or f"begin with {_ANY_KEYWORD}")
    taken = _taken_alias(source, tokens, position)
    if taken is not None:
        return taken
    message = f"unexpected `{span.text}`, expected {_expectation(allowed)}"
    return Diagnostic("E01", message, span, fix=_hint(source, tokens, position, allowed))


def _end(source: Source, tokens: Sequence[Token], allowed: Set[str]) -> Diagnostic:
    last = span_of(source, tokens[-1])
    opened = _unclosed_bracket(tokens)
    if opened is not None and (closing := _CLOSING[opened.type])[0] in allowed:
        place = span_of(source, opened)
        message = f"this `{place.text}` is never closed"
        fix = f"write `{closing[1]}` after `{last.text}` in line {last.line}, or remove this"
        return Diagnostic("E01", message, place, fix=fix)
    after = Span(source, last.end - 1, last.end)
    return Diagnostic(
        "E01", f"the statement ends after `{last.text}`, expected {_expectation(allowed)}", after
    )


def _unclosed_bracket(tokens: Sequence[Token]) -> Token | None:
    """Return the innermost bracket that is still open. An interval may close with either kind."""
    stack: list[Token] = []
    for token in tokens:
        if token.type in ("LPAR", "LSQB"):
            stack.append(token)
        elif token.type in ("RPAR", "RSQB") and stack:
            stack.pop()
    return stack[-1] if stack else None


def _expectation(allowed: Set[str]) -> str:
    rest = set(allowed)
    words = []
    if rest >= _FORMULA:
        words.append("a condition or a number")
        rest -= _FORMULA | {"LSQB"}
    elif rest >= _EXPRESSION:
        words.append("a number")
        rest -= _EXPRESSION | {"LSQB"}
    if rest & _OPERATORS:
        # after a complete operand, an operator or a closing or separating sign can follow
        words.append("an operator")
        if "COLON" in rest:  # a colon may separate the ends of an interval
            rest -= {"COLON", "NAME"} | ({"COMMA"} if "RPAR" in rest else set())
        rest -= _OPERATORS | {"UNIT", "LPAR", "LSQB"}
    words += [_WORDS[terminal] for terminal in sorted(rest) if terminal in _WORDS]
    if set(allowed) == STATEMENTS:
        return _ANY_KEYWORD
    return " or ".join((", ".join(words[:-1]), words[-1])) if len(words) > 1 else words[0]


def _hint(source: Source, tokens: Sequence[Token], position: int, allowed: Set[str]) -> str:
    token, before = tokens[position], tokens[position - 1]
    here = span_of(source, token)
    first_on_line = span_of(source, before).line < here.line
    guess = suggestion(str(token), _KEYWORDS)
    if token.type == "NAME" and first_on_line and guess:
        return guess
    if token == "|" and "NUMBER" in allowed:
        return f"write `abs({_between_bars(source, tokens[position:])})`"
    if token.type in ("RSQB", "RPAR") and "COMMA" in allowed and "RPAR" not in allowed:
        return "an interval has two ends, such as [0, 0.5 s]"
    if first_on_line and token.type in ("TEMPORAL", "NOT", "STEP"):
        return "write a requirement as `require name: …`"
    if tokens[0].type == "SIGNAL" and position == 2 and token.type == "COMMA":
        return "declare one signal at a time: `signal x  signal y`"
    if tokens[0].type == "SIGNAL" and position == 2 and token.type == "DIV":
        return f"{_NAMES}; --map v=a/b gives the name of a channel in a file"
    if token == "t" and before.type == "LSQB" and tokens[position - 2].type == "NAME":
        return f"write `{tokens[position - 2]}`: a signal is always read at the current time"
    if token == "xor":
        return "write `not (… <-> …)`"
    if token.type == "NAME" and before.type == "NUMBER":
        return "write a unit in braces, such as {m/s}"
    if token.type == "EQ" and "CMP" in allowed:
        return "to compare, write `<=`, `>=` or `==`"
    if before.type == "REQUIRE" and token.type != "NUMBER":
        return "a requirement has a name: `require slow: always …`"
    if before.type in STATEMENTS and token.type not in ("NAME", "NUMBER"):
        return f"`{here.text}` is a keyword and cannot be a name"
    if before.type == "BOOL":
        return "a boolean signal has neither unit nor range"
    if token.type == "UNIT" and tokens[0].type in ("SIGNAL", "PARAM", "CONST"):
        return "write the unit right after the name"
    return ""


def _between_bars(source: Source, tokens: Sequence[Token]) -> str:
    closing = next((i for i, token in enumerate(tokens) if i > 1 and token == "|"), None)
    if closing is None:
        return "…"
    return " ".join(span_of(source, tokens[1], tokens[closing - 1]).text.split())


def _taken_alias(source: Source, tokens: Sequence[Token], position: int) -> Diagnostic | None:
    """Explain ``F[0,1] φ`` where F is declared: there F is not ``eventually``."""
    for name in reversed(tokens[2:position]):
        if name.type != "NAME" or name not in ALIASES:
            continue
        _, word = ALIASES[str(name)]
        span = span_of(source, name)
        message = f"`{name}` is declared here, so it does not mean `{word}`"
        return Diagnostic("E07", message, span, fix=f"write `{word}`, or declare another name")
    return None
