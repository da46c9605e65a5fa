"""Warnings about legal text that is seldom meant: one function for each lint, grouped by subject.

A lint states the meaning of a text in s2r, its meaning in other tools, and an unambiguous way to write it.
If brackets are enough, the lint has the edit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

from s2r_spec.lang import formula as f
from s2r_spec.lang import syntax
from s2r_spec.lang.checking import check_text
from s2r_spec.lang.constants import constant
from s2r_spec.lang.declarations import Document, Param
from s2r_spec.lang.imports import imported_names
from s2r_spec.lang.parsing import Parsed, parse
from s2r_spec.lang.source import Source, Span
from s2r_spec.lang.units import PLAIN, Unit, UnknownUnitError, parse_unit

CODES = {
    "L01": "a temporal operator stands before and, or or ->; tools differ in its scope",
    "L02": "and and or are mixed without brackets",
    "L03": "implications are chained without brackets",
    "L04": "the robustness of == is never positive",
    "L05": "a bound is multiplied by a sign that can be 0",
    "L06": "a declaration is not used",
    "L07": "a condition always or never holds in the declared range of a signal",
    "L08": "a lengthscale is longer than the range of its parameter",
}
"""Stable codes: a code never changes its meaning."""

_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
_TURNED = {"rad": "deg", "rad/s": "deg/s", "s": "ms"}
_PREFIXES = ("c", "m", "u")


@dataclass(frozen=True)
class LintWarning:
    """One warning.

    Args:
        code: a key of :data:`CODES`.
        message: one sentence without a full stop.
        span: the place.
        fix: the text to write instead.
        edits: (position, text to insert), which do not change the meaning.
    """

    code: str
    message: str
    span: Span
    fix: str = ""
    edits: tuple[tuple[int, str], ...] = ()

    def __str__(self) -> str:
        picture = f"warning[{self.code}]: {self.message}\n{self.span.picture()}"
        margin = " " * len(str(self.span.line))
        return f"{picture}\n{margin} = {self.fix}" if self.fix else picture


def lint(text: str, name: str = "<string>") -> tuple[LintWarning, ...]:
    """Return the findings of all lints in a specification, in the order of the text.

    Raises:
        SpecError: the text has mistakes.
    """
    document = check_text(text, name)
    source = Source.of(text, name)
    parsed = parse(source, imported_names(source))
    findings = [finding for rule in _LINTS for finding in rule(parsed, document)]
    return tuple(sorted(findings, key=lambda finding: (finding.span.start, finding.code)))


def apply_fixes(text: str, findings: Iterable[LintWarning]) -> str:
    """Return the text with every edit of the findings; its meaning stays the same."""
    text = Source.of(text).text
    edits = sorted((edit for finding in findings for edit in finding.edits), reverse=True)
    for place, inserted in edits:
        text = text[:place] + inserted + text[place:]
    return text


# operators whose grouping differs between tools; brackets make it explicit


def _temporal_reach(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``always p and q`` is ``(always p) and q`` here, and ``always (p and q)`` in MoonLight."""
    for node in f.walk(*parsed.statements):
        if not isinstance(node, syntax.Junction | syntax.Implication):
            continue
        word = node.operator
        for operand in node.operands[:-1] if isinstance(node, syntax.Junction) else (node.left,):
            if isinstance(operand, syntax.Temporal) and not _has_brackets(operand) and _open(operand):
                message = (
                    f"the scope of `{operand.operator}` ends before `{word}`; in MoonLight it goes further"
                )
                yield _put_in_brackets("L01", message, operand)


def _open(node: syntax.Temporal) -> bool:
    """Return whether no bracket shows the end of a temporal operator or of the operators right after it."""
    inner: syntax.Expression = node
    while isinstance(inner, syntax.Temporal | syntax.AdjacentSample | syntax.Negation):
        inner = inner.operand
        if _has_brackets(inner):
            return False
    return True


def _mixed_junction(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``p and q or r`` is ``(p and q) or r``."""
    for node in f.walk(*parsed.statements):
        if isinstance(node, syntax.Junction) and node.operator == "or":
            for inner in node.operands:
                if (
                    isinstance(inner, syntax.Junction)
                    and inner.operator == "and"
                    and not _has_brackets(inner)
                ):
                    yield _put_in_brackets("L02", "`and` binds tighter than the `or` beside it", inner)


def _chained_implication(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``p -> q -> r`` is ``p -> (q -> r)`` here, and ``(p -> q) -> r`` in RTAMT."""
    for node in f.walk(*parsed.statements):
        if isinstance(node, syntax.Implication) and node.operator == "->":
            right = node.right
            if isinstance(right, syntax.Implication) and right.operator == "->" and not _has_brackets(right):
                message = "`->` groups to the right in s2r, and to the left in RTAMT"
                yield _put_in_brackets("L03", message, right)


def _has_brackets(node: f.Node) -> bool:
    text, span = node.span.source.text, node.span
    return text[: span.start].rstrip().endswith("(") and text[span.end :].lstrip().startswith(")")


def _put_in_brackets(code: str, message: str, node: f.Node) -> LintWarning:
    edits = (node.span.start, "("), (node.span.end, ")")
    return LintWarning(code, message, node.span, "put it in brackets", edits)


# comparisons


def _equality(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """The robustness of ``a == b`` is −abs(a − b): at best 0, and then any noise breaks it."""
    for node in f.walk(*parsed.statements):
        if isinstance(node, syntax.Comparison):
            texts = [" ".join(operand.span.text.split()) for operand in node.operands]
            for word, (left, right) in zip(node.operators, pairwise(texts), strict=True):
                if word.text == "==":
                    message = "the robustness of `==` is never positive"
                    fix = f"give a tolerance: `abs({left} - {right}) <= tolerance`"
                    yield LintWarning("L04", message, word.span, fix)


def _vanishing_sign(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``sign(vd) * (v - vd) <= tol`` says nothing at vd = 0."""
    for node in f.walk(*parsed.statements):
        if not isinstance(node, syntax.Arithmetic) or node.operator.text != "*":
            continue
        for call in (node.left, node.right):
            if isinstance(call, syntax.Call) and call.function.text == "sign" and _can_vanish(call, document):
                argument = " ".join(call.span.text.split()).removeprefix("sign(").removesuffix(")")
                message = f"where `{argument}` is 0, its sign is 0, too, and the product bounds nothing"
                fix = f"use `overshoot(x, {argument.strip()})`, whose direction is never 0"
                yield LintWarning("L05", message, call.span, fix)


def _can_vanish(call: syntax.Call, document: Document) -> bool:
    """Return whether the argument may be 0, judged by a parameter's range."""
    (argument,) = call.arguments
    param = document.params.get(argument.name) if isinstance(argument, syntax.Name) else None
    return param is None or param.range is None or param.range[0] <= 0 <= param.range[1]


def _settled_by_range(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``v <= 60`` always holds for a signal declared in [-50, 50]."""
    nodes = {id(node): node for formula in document.requirements.values() for node in f.walk(formula)}
    for node in nodes.values():
        if isinstance(node, f.Comparison) and node.operator in _MIRRORED:
            yield from _range_warnings(node, document)


def _range_warnings(node: f.Comparison, document: Document) -> Iterator[LintWarning]:
    for operand, other, operator in (
        (node.left, node.right, node.operator),
        (node.right, node.left, _MIRRORED[node.operator]),
    ):
        bound = constant(other)
        range_ = document.signals[operand.name].range if isinstance(operand, f.SignalValue) else None
        if bound is None or range_ is None or not isinstance(operand, f.SignalValue):
            continue
        low, high = range_ if operator[0] == "<" else (-range_[1], -range_[0])
        limit = bound if operator[0] == "<" else -bound
        if high <= limit or low > limit:
            holds, text = "always" if high <= limit else "never", " ".join(node.span.text.split())
            declared = f"`{operand.name}` is declared in [{range_[0]:g}, {range_[1]:g}]"
            message = f"`{text}` {holds} holds: {declared}"
            yield LintWarning("L07", message, node.span, "change the bound, or the range")


# declarations


def _unused(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """A trace need not have an unused signal. A searched parameter is used by the backend."""
    nodes = list(f.walk(*parsed.statements))
    used = {node.name for node in nodes if isinstance(node, syntax.Name)}
    used |= {node.name.text for node in nodes if isinstance(node, syntax.Index)}
    used |= {param.name for param in document.params.values() if param.searched}
    for statement in parsed.statements:
        if isinstance(statement, syntax.Signal | syntax.Param | syntax.Const | syntax.Let):
            word = statement.name
            if word.text not in used:
                yield LintWarning("L06", f"`{word.text}` is not used", word.span, "remove it")


def _long_lengthscale(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``matern52(150 {m})`` for a parameter in [-0.3, 0.3] m, often a number in another unit.

    With such a lengthscale the parameter has almost no influence.
    """
    axes = [param for param in document.params.values() if param.searched]
    for line in parsed.statements:
        if not isinstance(line, syntax.Certify):
            continue
        written = next((setting.value for setting in line.settings if setting.key.text == "kernel"), None)
        settings = document.certify.get(line.name.text if line.name else next(iter(document.certify)))
        if not isinstance(written, syntax.Call) or settings is None or settings.kernel is None:
            continue
        places = written.arguments if len(written.arguments) > 1 else written.arguments * len(axes)
        for place, axis, length in zip(places, axes, settings.kernel.lengthscales, strict=False):
            low, high = axis.range or (length, length)
            if length > high - low > 0:
                scale = f"the lengthscale of `{axis.name}`, {length:g} {axis.unit}".rstrip()
                message = f"{scale}, is {length / (high - low):.3g} times its range"
                yield LintWarning("L08", message, place.span, _other_unit(length, axis, high - low))


def _other_unit(length: float, axis: Param, width: float) -> str:
    """Return the remedy: a unit of the same dimension that may have been meant."""
    own = axis.measure
    texts = [_TURNED.get(own.text, ""), *(prefix + own.text for prefix in _PREFIXES)]
    for unit in filter(None, map(_find, texts if own != PLAIN else [])):
        if unit.text and unit.fits(own) and not unit.offset and width / 100 <= unit.to(own)(length) <= width:
            return f"if {length:g} {unit.text} is meant, write `{length:g} {{{unit.text}}}`"
    return "a lengthscale is the distance between two tests over which E ρ is still related"


def _find(text: str) -> Unit | None:
    try:
        return parse_unit(text)
    except UnknownUnitError:
        return None


_LINTS: tuple[Callable[[Parsed, Document], Iterator[LintWarning]], ...] = (
    _temporal_reach, _mixed_junction, _chained_implication, _equality, _vanishing_sign, _unused, _settled_by_range,
    _long_lengthscale,
)  # fmt: skip
