"""Makes mutants of a module: its text with one small fault, by Cosmic Ray's operators and one of our own.

Not mutated, for no test should catch it:

- text, numbers in f-strings included: tests assert the code, file, line and name of an error, not its sentence;
- ``strict=True`` of zip: the lengths are equal, and it says so;
- annotations, and what is for the type checker alone: they are not evaluated;
- arguments of decorators: ``frozen=True`` guards against careless code, and mypy holds it;
- decorators: without ``@dataclass`` nothing works, and without ``@cache`` all is as before, and slower.
"""

from __future__ import annotations

import ast
import pickle
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import zip_longest
from typing import Any

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import MutationVisitor
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator

Position = tuple[int, int]
"""Line from 1 and column from 0, in characters."""

PAIRS = (
    ("min", "max"),
    ("minimum", "maximum"),
    ("fmin", "fmax"),
    ("argmin", "argmax"),
    ("any", "all"),
    ("floor", "ceil"),
    ("ROUND_FLOOR", "ROUND_CEILING"),
    ("zeros", "ones"),
)
OPPOSITES = dict(PAIRS) | {right: left for left, right in PAIRS}


class Opposite(Operator):  # type: ignore[misc]
    """Takes the other extreme, quantifier or rounding: the typical fault of code about bounds."""

    def mutation_positions(self, node: Any) -> Iterator[tuple[Position, Position]]:
        named = node.type == "name" and node.value in OPPOSITES
        if named and not (node.parent.type == "argument" and node.parent.children[0] is node):
            yield node.start_pos, node.end_pos

    def mutate(self, node: Any, index: int) -> Any:
        node.value = OPPOSITES[node.value]
        return node

    @classmethod
    def examples(cls) -> tuple[tuple[str, str], ...]:
        return (("min(a)", "max(a)"),)


BINARY = {
    "Add": ["Sub"], "Sub": ["Add"], "Mul": ["Div"], "Div": ["Mul"], "FloorDiv": ["Mul"], "Mod": ["Mul"],
    "Pow": ["Mul"], "LShift": ["RShift"], "RShift": ["LShift"], "BitAnd": ["BitOr"], "BitOr": ["BitAnd"],
    "BitXor": ["BitAnd"],
}  # fmt: skip
"""Each operator by the one that is nearest to it: the others of Cosmic Ray's eleven fail at once on numbers."""
COMPARED = {
    "Lt": ["LtE", "GtE"], "LtE": ["Lt", "Gt"], "Gt": ["GtE", "LtE"], "GtE": ["Gt", "Lt"], "Eq": ["NotEq"],
    "NotEq": ["Eq"], "Is": ["IsNot"], "IsNot": ["Is"],
}  # fmt: skip
"""A limit that moves by nothing, and its opposite."""
OPERATORS = (
    *(f"ReplaceBinaryOperator_{old}_{new}" for old, others in BINARY.items() for new in others),
    *(f"ReplaceComparisonOperator_{old}_{new}" for old, others in COMPARED.items() for new in others),
    "ReplaceUnaryOperator_Delete_USub",
    "ReplaceUnaryOperator_Delete_Invert",
    "ReplaceUnaryOperator_Delete_Not",
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "AddNot",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "NumberReplacer",
    "ExceptionReplacer",
    "ZeroIterationForLoop",
)


@dataclass(frozen=True)
class Site:
    """Where an operator can put a fault: the ``occurrence``-th of its places in a module."""

    line: int
    name: str
    operator: Any
    occurrence: int


@dataclass(frozen=True)
class Mutant:
    """One fault in a module.

    Attributes:
        operator: what made it.
        line: where it is, from 1.
        was: the line without the fault, without its indentation.
        now: the line with it.
        code: the whole module with it.
    """

    operator: str
    line: int
    was: str
    now: str
    code: str


def sites(code: str) -> list[Site]:
    """Return where faults can be in a module's text, in the order of its lines."""
    spared, nodes = spans(code), list(ast_nodes(get_ast(code)))
    operators: list[tuple[str, Any]] = [(name, get_operator(f"core/{name}")()) for name in OPERATORS]
    found = []
    for name, operator in (*operators, ("Opposite", Opposite())):
        positions = [place for node in nodes for place in operator.mutation_positions(node)]
        for occurrence, (start, _) in enumerate(positions):
            if not any(first <= start < last for first, last in spared):
                found.append(Site(start[0], name, operator, occurrence))
    return sorted(found, key=lambda site: (site.line, site.name, site.occurrence))


def sample(of: Sequence[Site], count: int | None, seed: str) -> list[Site]:
    """Return at most ``count`` of the sites, drawn at random; all of them for None."""
    return random.Random(seed).sample(of, len(of) if count is None else min(count, len(of)))


@cache
def _tree(code: str) -> bytes:
    return pickle.dumps(get_ast(code))  # much faster to read than the text


def mutant(code: str, site: Site) -> Mutant | None:
    """Return the mutant of a module's text at a site; None where it is no Python."""
    changed = MutationVisitor(site.occurrence, site.operator).walk(pickle.loads(_tree(code))).get_code()
    try:
        compile(changed, "mutant", "exec")
    except (SyntaxError, ValueError):
        return None
    rows = zip_longest(code.splitlines(), changed.splitlines(), fillvalue="")
    was, now = next((pair for pair in rows if pair[0] != pair[1]), ("", ""))
    return Mutant(site.name, site.line, was.strip(), now.strip(), changed) if was != now else None


def spans(code: str) -> list[tuple[Position, Position]]:
    """Return where nothing is mutated."""
    lines = code.splitlines()

    def column(line: int, offset: int) -> int:
        return len(lines[line - 1].encode()[:offset].decode())  # ast counts bytes

    def span(node: ast.expr | ast.stmt) -> tuple[Position, Position]:
        end = node.end_lineno or node.lineno, node.end_col_offset or 0
        return (node.lineno, column(node.lineno, node.col_offset)), (end[0], column(*end))

    return [span(node) for node in _spared(ast.parse(code))]


def _spared(tree: ast.Module) -> Iterator[ast.expr | ast.stmt]:
    for node in ast.walk(tree):
        match node:
            case ast.JoinedStr():
                yield node
            case ast.arg(annotation=ast.expr() as annotation) | ast.AnnAssign(annotation=annotation):
                yield annotation
            case ast.Call(func=ast.Name(id="zip"), keywords=[keyword]):
                yield keyword.value
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):
                yield node
        if isinstance(node, ast.FunctionDef) and node.returns is not None:
            yield node.returns
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield from node.decorator_list
