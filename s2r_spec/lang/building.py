"""The syntax tree from Lark's parse tree: one row of :data:`_RULES` for each rule of the grammar."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, cast

from lark import Token, Tree

from s2r_spec.lang import formula as f
from s2r_spec.lang import syntax
from s2r_spec.lang.lexing import span_of
from s2r_spec.lang.source import Source

_Tree = Tree[Token]
_Child = _Tree | Token
_Part = Callable[[Source, list[_Child]], Any]
"""Returns a field of a node from the children of its parse tree."""


def build(source: Source, tree: _Tree) -> syntax.Statement | syntax.Import:
    """Return the syntax tree of one parsed statement."""
    return cast(syntax.Statement | syntax.Import, _node(source, tree))


def _node(source: Source, tree: _Child) -> Any:
    """Convert one subtree, bottom up; a token becomes a word, a unit without braces, a file without quotes."""
    if isinstance(tree, Token):
        text = tree[1:-1].strip() if tree.type in ("UNIT", "STRING") else str(tree)
        return syntax.Word(span=span_of(source, tree), text=text)
    rule = str(tree.data)
    if rule in _INNER:
        return _INNER[rule](source, tree.children)
    kind, parts = _RULES[rule]
    fields = {name: part(source, tree.children) for name, part in parts.items()}
    return kind(span=span_of(source, _end(tree, 0), _end(tree, -1)), **fields)


def _end(tree: _Child, position: Literal[0, -1]) -> Token:
    """Return the first (0) or last (−1) token of a tree; no rule of the grammar is empty."""
    while isinstance(tree, Tree):
        tree = tree.children[position]
    return tree


def _at(position: int) -> _Part:
    return lambda source, children: _node(source, children[position])


def _text(position: int) -> _Part:
    return lambda source, children: str(children[position])


def _number(position: int) -> _Part:

    def part(source: Source, children: list[_Child]) -> syntax.Number:
        token = cast(Token, children[position])
        return syntax.Number(span=span_of(source, token), value=float(token), unit=None)

    return part


def _is(position: int, text: str) -> _Part:
    return lambda source, children: str(children[position]) == text


def _always(value: str) -> _Part:
    return lambda source, children: value


def _maybe(kind: str) -> _Part:
    """Return the part of the first child of a token type or rule; None if there is none."""

    def part(source: Source, children: list[_Child]) -> Any:
        kinds = [child.type if isinstance(child, Token) else child.data for child in children]
        return _node(source, children[kinds.index(kind)]) if kind in kinds else None

    return part


def _all(kind: type[_Child]) -> _Part:
    return lambda source, children: tuple(
        _node(source, child) for child in children if isinstance(child, kind)
    )


def _links(source: Source, children: list[_Child]) -> tuple[syntax.UntilLink, ...]:
    links: list[syntax.UntilLink] = []
    interval = None
    for child in children[1:]:
        if isinstance(child, Token):
            word, interval = _node(source, child), None
        elif child.data == "interval":
            interval = _node(source, child)
        else:
            operand = _node(source, child)
            span = word.span.to(operand.span)
            link = syntax.UntilLink(
                span=span, operator=word.text, word=word, interval=interval, operand=operand
            )
            links.append(link)
    return tuple(links)


def _upper_bound(source: Source, children: list[_Child]) -> syntax.Bound:
    high = children[3]
    if isinstance(high, Token):
        return syntax.Bound(span=span_of(source, high), value=None, unit=None)
    return cast(syntax.Bound, _node(source, high))


_OPERANDS = {"operands": _all(Tree)}
_SIDES = {"left": _at(0), "right": _at(2)}
_UNIT = {"unit": _maybe("UNIT")}
_NAMED = {"name": _at(1)}
_RULES: dict[str, tuple[type[f.Node], dict[str, _Part]]] = {
    "signal": (
        syntax.Signal,
        _NAMED
        | _UNIT
        | {
            "dim": _maybe("dim"),
            "range": _maybe("range"),
            "boolean": lambda source, children: _maybe("BOOL")(source, children) is not None,
        },
    ),
    "param": (syntax.Param, _NAMED | _UNIT | {"default": _maybe("default"), "range": _maybe("range")}),
    "const": (syntax.Const, _NAMED | _UNIT | {"value": _at(-1)}),
    "let": (syntax.Let, _NAMED | {"body": _at(-1)}),
    "require": (syntax.Require, _NAMED | {"body": _at(-1)}),
    "certify": (syntax.Certify, {"name": _maybe("NAME"), "settings": _all(Tree)}),
    "import": (syntax.Import, {"path": _at(1)}),
    "setting": (syntax.Setting, {"key": _at(0), "value": _at(2)}),
    "range": (syntax.Range, {"low": _at(2), "high": _at(4)}),
    "number": (syntax.Number, _UNIT | {"value": lambda source, children: float(str(children[0]))}),
    "name": (syntax.Name, {"name": _text(0)}),
    "index": (syntax.Index, {"name": _at(0), "index": _number(2)}),
    "call": (syntax.Call, {"function": _at(0), "arguments": _all(Tree)}),
    "minus": (syntax.Minus, {"operand": _at(1)}),
    "arithmetic": (syntax.Arithmetic, _SIDES | {"operator": _at(1)}),
    "truth": (syntax.Truth, {"value": _is(0, "true")}),
    "comparison": (syntax.Comparison, _OPERANDS | {"operators": _all(Token)}),
    "negation": (syntax.Negation, {"operand": _at(1)}),
    "conjunction": (syntax.Junction, _OPERANDS | {"operator": _always("and")}),
    "disjunction": (syntax.Junction, _OPERANDS | {"operator": _always("or")}),
    "implies": (syntax.Implication, _SIDES | {"operator": _always("->")}),
    "iff": (syntax.Implication, _SIDES | {"operator": _always("<->")}),
    "temporal": (
        syntax.Temporal,
        {"operator": _text(0), "interval": _maybe("interval"), "operand": _at(-1)},
    ),
    "until": (syntax.Until, {"left": _at(0), "links": _links}),
    "step": (syntax.AdjacentSample, {"operator": _text(0), "operand": _at(1)}),
    "interval": (
        syntax.Interval,
        {"low": _at(1), "high": _upper_bound, "low_closed": _is(0, "["), "high_closed": _is(4, "]")},
    ),
    "bound": (syntax.Bound, {"value": _at(0), "unit": _maybe("NAME")}),
}
"""Rule → the node that it makes, and field → its part."""
_INNER: dict[str, _Part] = {"dim": _number(1), "default": _at(1), "group": _at(1)}
"""Rule without a node of its own → the part that stands for it."""
