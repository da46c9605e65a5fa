"""Specifications as LaTeX formulas."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import SpecError
from s2r_spec.lang.imports import imported_names
from s2r_spec.lang.parsing import parse
from s2r_spec.lang.source import Source

_TEMPORAL = {
    "always": r"\square", "eventually": r"\lozenge",
    "historically": r"\blacksquare", "once": r"\blacklozenge",
}  # fmt: skip
_UNTIL = {
    "until": r"\mathbin{\mathcal{U}}", "since": r"\mathbin{\mathcal{S}}",
    "release": r"\mathbin{\mathcal{R}}", "unless": r"\mathbin{\mathcal{W}}",
}  # fmt: skip
_STEP = {"next": r"\bigcirc", "prev": r"\ominus"}
_COMPARE = {"<=": r"\leq", ">=": r"\geq", "==": "=", "!=": r"\neq", "<": "<", ">": ">"}
_LOGIC = {"and": r"\wedge", "or": r"\vee", "->": r"\rightarrow", "<->": r"\leftrightarrow"}
_OUTER = {"abs": (r"\lvert ", r" \rvert"), "norm": (r"\lVert ", r" \rVert"), "sqrt": (r"\sqrt{", "}")}

# Precedence of a node; a node of lower precedence than its place needs is put in brackets.
_LEVEL: dict[type, int] = {
    syntax.Implication: 1, syntax.Junction: 2, syntax.Until: 3, syntax.Negation: 4, syntax.Temporal: 4,
    syntax.AdjacentSample: 4, syntax.Comparison: 5, syntax.Minus: 7,
}  # fmt: skip
_ARITHMETIC = {"+": 6, "-": 6, "*": 7, "^": 8}  # a fraction needs no brackets
_ATOM = 9


def to_latex(text: str, name: str = "<string>") -> str:
    """Return definitions and requirements as an ``align*`` environment; needs amsmath and amssymb.

    Raises:
        SpecError: the text does not parse.
    """
    source = Source.of(text, name)
    parsed = parse(source, imported_names(source))
    if parsed.diagnostics:
        raise SpecError(parsed.diagnostics)
    rows = list(_rows(parsed.statements))
    return "\n".join((r"\begin{align*}", " \\\\\n".join(rows), r"\end{align*}")) + "\n"


def _rows(statements: tuple[syntax.Statement, ...]) -> Iterator[str]:
    for statement in statements:
        if isinstance(statement, syntax.Const):
            value = _tex(statement.value) + _unit(statement.unit)
            yield f"  {_name(statement.name.text)} &:= {value}"
        elif isinstance(statement, syntax.Let):
            yield f"  {_name(statement.name.text)} &:= {_tex(statement.body)}"
        elif isinstance(statement, syntax.Require):
            yield f"  {_name(statement.name.text)} &: {_tex(statement.body)}"


def _tex(node: syntax.Expression, level: int = 0) -> str:
    text = _plain(node)
    own = _LEVEL.get(type(node), _ATOM)
    if isinstance(node, syntax.Arithmetic):
        own = _ARITHMETIC.get(node.operator.text, _ATOM)
    return rf"\left( {text} \right)" if own < level else text


def _plain(node: syntax.Expression) -> str:
    match node:
        case syntax.Number():
            return node.span.text.split("{")[0].strip() + _unit(node.unit)
        case syntax.Name():
            return _name(node.name)
        case syntax.Index():
            return rf"{_name(node.name.text)}[{node.index.span.text}]"
        case syntax.Truth():
            return r"\top" if node.value else r"\bot"
        case syntax.Call():
            arguments = ", ".join(map(_tex, node.arguments))
            before, after = _OUTER.get(
                node.function.text, (rf"\operatorname{{{_escape(node.function.text)}}}(", ")")
            )
            return f"{before}{arguments}{after}"
        case syntax.Minus():
            return f"-{_tex(node.operand, 8)}"
        case syntax.Arithmetic():
            return _arithmetic(node)
        case syntax.Comparison():
            first, *rest = (_tex(operand, 6) for operand in node.operands)
            signs = (_COMPARE[word.text] for word in node.operators)
            return first + "".join(f" {sign} {part}" for sign, part in zip(signs, rest, strict=True))
        case syntax.Negation():
            return rf"\neg {_tex(node.operand, 4)}"
        case syntax.AdjacentSample():
            return f"{_STEP[node.operator]} {_tex(node.operand, 4)}"
        case syntax.Temporal():
            return f"{_TEMPORAL[node.operator]}{_interval(node.interval)} {_tex(node.operand, 4)}"
        case syntax.Until():
            link = node.links[0]
            middle = _UNTIL[link.operator] + _interval(link.interval)
            return f"{_tex(node.left, 4)} {middle} {_tex(link.operand, 4)}"
        case syntax.Junction():
            return f" {_LOGIC[node.operator]} ".join(_tex(operand, 3) for operand in node.operands)
        case syntax.Implication():
            return f"{_tex(node.left, 2)} {_LOGIC[node.operator]} {_tex(node.right, 2)}"


def _arithmetic(node: syntax.Arithmetic) -> str:
    operator = node.operator.text
    if operator == "/":
        return rf"\frac{{{_tex(node.left)}}}{{{_tex(node.right)}}}"
    if operator == "^":
        return f"{_tex(node.left, 9)}^{{{_tex(node.right)}}}"
    if operator == "*":
        return rf"{_tex(node.left, 7)} \cdot {_tex(node.right, 8)}"
    signed = operator == "-" or isinstance(node.right, syntax.Minus)
    return f"{_tex(node.left, 6)} {operator} {_tex(node.right, 8 if signed else 6)}"


def _interval(interval: syntax.Interval | None) -> str:
    if interval is None:
        return ""
    ends = ", ".join(_bound(bound) for bound in (interval.low, interval.high))
    return f"_{{{'[' if interval.low_closed else '('}{ends}{']' if interval.high_closed else ')'}}}"


def _bound(bound: syntax.Bound) -> str:
    if bound.value is None:
        return r"\infty"
    unit = "" if bound.unit is None else rf"\,\mathrm{{{bound.unit.text}}}"
    return _tex(bound.value) + unit


def _unit(unit: syntax.Word | None) -> str:
    return rf"\,\mathrm{{{_escape(unit.text)}}}" if unit is not None and unit.text else ""


def _name(name: str) -> str:
    return _escape(name) if len(name) == 1 else rf"\mathit{{{_escape(name)}}}"


def _escape(text: str) -> str:
    return text.replace("_", r"\_").replace("%", r"\%").replace("*", r"\cdot ")
