"""The syntax tree from Lark's parse tree: one method for each rule of the grammar, named after it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, cast

from lark import Token, Tree

from s2r_spec.lang import syntax
from s2r_spec.lang.lexing import span_of
from s2r_spec.lang.source import Source, Span

_Tree = Tree[Token]
_Child = _Tree | Token


def build(source: Source, tree: _Tree) -> syntax.Statement | syntax.Import:
    """Return the syntax tree of one parsed statement."""
    return cast(syntax.Statement | syntax.Import, _Builder(source).node(tree))


class _Builder:
    """Converts parse trees of one source, bottom up."""

    def __init__(self, source: Source) -> None:
        self.source = source

    def node(self, tree: _Child) -> Any:
        """Convert one subtree; a token becomes a word."""
        if isinstance(tree, Token):
            return self.word(tree)
        make: Callable[[Span, list[_Child]], Any] = getattr(self, f"_{tree.data}")
        return make(span_of(self.source, _end(tree, 0), _end(tree, -1)), tree.children)

    def word(self, token: Token) -> syntax.Word:
        """Return a token's text and place; a unit without its braces, a file without its quotes."""
        text = token[1:-1].strip() if token.type in ("UNIT", "STRING") else str(token)
        return syntax.Word(span=span_of(self.source, token), text=text)

    def number(self, token: Token) -> syntax.Number:
        """Return a number without a unit."""
        return syntax.Number(span=span_of(self.source, token), value=float(token), unit=None)

    def maybe(self, children: list[_Child], kind: str) -> Any:
        """Return the converted child of the token type or rule ``kind``; None if there is none."""
        for child in children:
            if (child.type if isinstance(child, Token) else child.data) == kind:
                return self.node(child)
        return None

    def trees(self, children: list[_Child], *but: str) -> tuple[Any, ...]:
        """Return the converted children that are not tokens, except children of the rules in ``but``."""
        return tuple(
            self.node(child) for child in children if isinstance(child, Tree) and child.data not in but
        )

    # statements

    def _signal(self, span: Span, children: list[_Child]) -> syntax.Signal:
        dim, range_ = self.maybe(children, "dim"), self.maybe(children, "range")
        unit = self.maybe(children, "UNIT")
        boolean = self.maybe(children, "BOOL") is not None
        name = self.node(children[1])
        return syntax.Signal(span=span, name=name, dim=dim, boolean=boolean, unit=unit, range=range_)

    def _param(self, span: Span, children: list[_Child]) -> syntax.Param:
        default, range_ = self.maybe(children, "default"), self.maybe(children, "range")
        unit = self.maybe(children, "UNIT")
        return syntax.Param(span=span, name=self.node(children[1]), unit=unit, default=default, range=range_)

    def _const(self, span: Span, children: list[_Child]) -> syntax.Const:
        unit = self.maybe(children, "UNIT")
        return syntax.Const(span=span, name=self.node(children[1]), unit=unit, value=self.node(children[-1]))

    def _let(self, span: Span, children: list[_Child]) -> syntax.Let:
        return syntax.Let(span=span, name=self.node(children[1]), body=self.node(children[-1]))

    def _require(self, span: Span, children: list[_Child]) -> syntax.Require:
        return syntax.Require(span=span, name=self.node(children[1]), body=self.node(children[-1]))

    def _certify(self, span: Span, children: list[_Child]) -> syntax.Certify:
        return syntax.Certify(span=span, name=self.maybe(children, "NAME"), settings=self.trees(children))

    def _import(self, span: Span, children: list[_Child]) -> syntax.Import:
        return syntax.Import(span=span, path=self.node(children[1]))

    def _setting(self, span: Span, children: list[_Child]) -> syntax.Setting:
        return syntax.Setting(span=span, key=self.node(children[0]), value=self.node(children[2]))

    def _dim(self, span: Span, children: list[_Child]) -> syntax.Number:
        return self.number(cast(Token, children[1]))

    def _default(self, span: Span, children: list[_Child]) -> syntax.Expression:
        return cast(syntax.Expression, self.node(children[1]))

    def _range(self, span: Span, children: list[_Child]) -> syntax.Range:
        low, high = self.trees(children)
        return syntax.Range(span=span, low=low, high=high)

    def _group(self, span: Span, children: list[_Child]) -> syntax.Expression:
        return cast(syntax.Expression, self.node(children[1]))

    # numbers

    def _number(self, span: Span, children: list[_Child]) -> syntax.Number:
        number = self.number(cast(Token, children[0]))
        return syntax.Number(span=span, value=number.value, unit=self.maybe(children, "UNIT"))

    def _name(self, span: Span, children: list[_Child]) -> syntax.Name:
        return syntax.Name(span=span, name=str(children[0]))

    def _index(self, span: Span, children: list[_Child]) -> syntax.Index:
        return syntax.Index(
            span=span, name=self.node(children[0]), index=self.number(cast(Token, children[2]))
        )

    def _call(self, span: Span, children: list[_Child]) -> syntax.Call:
        return syntax.Call(span=span, function=self.node(children[0]), arguments=self.trees(children))

    def _minus(self, span: Span, children: list[_Child]) -> syntax.Minus:
        return syntax.Minus(span=span, operand=self.node(children[1]))

    def _arithmetic(self, span: Span, children: list[_Child]) -> syntax.Arithmetic:
        left, operator, right = map(self.node, children)
        return syntax.Arithmetic(span=span, operator=operator, left=left, right=right)

    # conditions

    def _truth(self, span: Span, children: list[_Child]) -> syntax.Truth:
        return syntax.Truth(span=span, value=str(children[0]) == "true")

    def _comparison(self, span: Span, children: list[_Child]) -> syntax.Comparison:
        operators = tuple(self.word(child) for child in children if isinstance(child, Token))
        return syntax.Comparison(span=span, operators=operators, operands=self.trees(children))

    def _negation(self, span: Span, children: list[_Child]) -> syntax.Negation:
        return syntax.Negation(span=span, operand=self.node(children[1]))

    def _conjunction(self, span: Span, children: list[_Child]) -> syntax.Junction:
        return syntax.Junction(span=span, operator="and", operands=self.trees(children))

    def _disjunction(self, span: Span, children: list[_Child]) -> syntax.Junction:
        return syntax.Junction(span=span, operator="or", operands=self.trees(children))

    def _implies(self, span: Span, children: list[_Child]) -> syntax.Implication:
        left, right = self.trees(children)
        return syntax.Implication(span=span, operator="->", left=left, right=right)

    def _iff(self, span: Span, children: list[_Child]) -> syntax.Implication:
        left, right = self.trees(children)
        return syntax.Implication(span=span, operator="<->", left=left, right=right)

    def _temporal(self, span: Span, children: list[_Child]) -> syntax.Temporal:
        operator = cast(syntax.TemporalOp, str(children[0]))
        return syntax.Temporal(
            span=span,
            operator=operator,
            interval=self.maybe(children, "interval"),
            operand=self.node(children[-1]),
        )

    def _until(self, span: Span, children: list[_Child]) -> syntax.Until:
        left, *rest = children
        links: list[syntax.UntilLink] = []
        word, interval = cast(Token, rest[0]), None
        for child in rest:
            if isinstance(child, Token):
                word, interval = child, None
            elif child.data == "interval":
                interval = self.node(child)
            else:
                operand = self.node(child)
                place = self.word(word)
                operator = cast(syntax.UntilOp, str(word))
                links.append(
                    syntax.UntilLink(
                        span=place.span.to(operand.span),
                        operator=operator,
                        word=place,
                        interval=interval,
                        operand=operand,
                    )
                )
        return syntax.Until(span=span, left=self.node(left), links=tuple(links))

    def _step(self, span: Span, children: list[_Child]) -> syntax.AdjacentSample:
        operator = cast(syntax.StepOp, str(children[0]))
        return syntax.AdjacentSample(span=span, operator=operator, operand=self.node(children[1]))

    def _interval(self, span: Span, children: list[_Child]) -> syntax.Interval:
        opening, low, _, high, closing = children
        if isinstance(high, Token):
            end = syntax.Bound(span=span_of(self.source, high), value=None, unit=None)
        else:
            end = self.node(high)
        return syntax.Interval(
            span=span,
            low=self.node(low),
            high=end,
            low_closed=str(opening) == "[",
            high_closed=str(closing) == "]",
        )

    def _bound(self, span: Span, children: list[_Child]) -> syntax.Bound:
        unit = self.maybe(children[1:], "NAME")
        return syntax.Bound(span=span, value=self.node(children[0]), unit=unit)


def _end(tree: _Child, position: Literal[0, -1]) -> Token:
    """Return the first (0) or last (−1) token of a tree; no rule of the grammar is empty."""
    while isinstance(tree, Tree):
        tree = tree.children[position]
    return tree
