"""Checks of a parsed file as a whole: a rule takes the file and yields every place that breaks it.

Checks that need names and units are made with the expressions (:mod:`s2r_spec.lang.checking`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import Diagnostic, suggestion
from s2r_spec.lang.formula import walk
from s2r_spec.lang.parsing import Parsed
from s2r_spec.lang.source import Span


def _some_requirement(parsed: Parsed) -> Iterator[Diagnostic]:
    """Report a file without a ``require`` line, unless a statement did not parse."""
    if any(isinstance(item, syntax.Require) for item in parsed.statements) or parsed.broken:
        return
    end = len(parsed.source.text.rstrip())
    place = Span(parsed.source, max(0, end - 1), end)
    fix = "add a line such as `require slow: always (v <= 1 {m/s})`"
    yield Diagnostic("E10", "this specification has no requirement", place, fix=fix)


def _unique_names(parsed: Parsed) -> Iterator[Diagnostic]:
    """Report every second declaration of a name; signals, parameters, lets and requirements share one namespace."""
    first: dict[str, syntax.Word] = {}
    for item in parsed.statements:
        if isinstance(item, syntax.Certify):
            continue
        word = item.name
        if word.text in first:
            message, before = f"`{word.text}` is declared twice", first[word.text].span
            yield Diagnostic("E08", message, word.span, before, "give one of them another name")
        first.setdefault(word.text, word)


def _complete_params(parsed: Parsed) -> Iterator[Diagnostic]:
    for item in parsed.statements:
        if isinstance(item, syntax.Param) and item.range is None and item.default is None:
            name, unit = item.name.text, "" if item.unit is None else f" {{{item.unit.text}}}"
            message = f"the parameter `{name}` has neither a range nor a default"
            fix = f"write `param {name}{unit} in [low, high]` or `= value`"
            yield Diagnostic("E09", message, item.name.span, fix=fix)


def _chained_until(parsed: Parsed) -> Iterator[Diagnostic]:
    """Report the second operator of every ``a until b until c``, which has no agreed meaning."""
    for node in walk(*parsed.statements):
        if isinstance(node, syntax.Until) and len(node.links) > 1:
            first, second = node.links[0].word.span.text, node.links[1].word.span
            message = f"`{second.text}` after `{first}` could be read in two ways"
            fix = f"write `(a {first} b) {second.text} c` or `a {first} (b {second.text} c)`"
            yield Diagnostic("E11", message, second, fix=fix)


def _certify_targets(parsed: Parsed) -> Iterator[Diagnostic]:
    """Report ``certify`` lines for an unknown requirement, and second lines for one or for all."""
    required = [item.name.text for item in parsed.statements if isinstance(item, syntax.Require)]
    unparsed = {broken.name for broken in parsed.broken}
    first: dict[str | None, Span] = {}
    for item in parsed.statements:
        if not isinstance(item, syntax.Certify):
            continue
        name = None if item.name is None else item.name.text
        place = item.span if item.name is None else item.name.span
        if name in unparsed:
            continue
        if name is not None and name not in required:
            fix = suggestion(name, required) or f"write `require {name}: …` first"
            yield Diagnostic("E15", f"there is no requirement `{name}`", place, fix=fix)
        elif name in first:
            own = "there is already a certify line for all requirements"
            message = own if name is None else f"`{name}` already has a certify line"
            yield Diagnostic("E15", message, place, first[name], "put all settings on one certify line")
        first.setdefault(name, place)


RULES: tuple[Callable[[Parsed], Iterator[Diagnostic]], ...] = (
    _some_requirement, _unique_names, _complete_params, _chained_until, _certify_targets,
)  # fmt: skip
