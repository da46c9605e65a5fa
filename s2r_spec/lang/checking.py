"""The check of a whole specification, which reports all of its mistakes together."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from s2r_spec.lang import formula as f
from s2r_spec.lang import syntax
from s2r_spec.lang.constants import constant
from s2r_spec.lang.declarations import CertifySettings, Document, Param, Signal
from s2r_spec.lang.diagnostics import Diagnostic, SpecError
from s2r_spec.lang.expressions import check, condition, quantity, range_of
from s2r_spec.lang.imports import gather
from s2r_spec.lang.parsing import DEEPEST, Parsed
from s2r_spec.lang.rules import RULES
from s2r_spec.lang.scope import Declaration, Definition, Mistake, Scope, fail, unit_of
from s2r_spec.lang.settings import certify_settings
from s2r_spec.lang.source import Source, Span

_WIDEST = 100_000


def check_text(text: str, name: str = "<string>", stored: Mapping[str, str] | None = None) -> Document:
    """Return the checked specification of a text; ``name``, usually its path, stands in messages.

    It reads its imports from ``stored``, name → text, or from disk without that.

    Raises:
        SpecError: the text has mistakes; the error lists all of them.
    """
    parsed, imports = gather(Source.of(text, name), stored)
    if any(mistakes.code == "E22" for mistakes in parsed.diagnostics):
        raise SpecError(parsed.diagnostics)  # the rest of a text that is too long was not read
    checker = _Checker(parsed, imports)
    mistakes = {*parsed.diagnostics, *(mistake for rule in RULES for mistake in rule(parsed)), *checker.run()}
    if mistakes:
        raise SpecError(mistakes)
    return checker.document()


class _Checker:
    """Checks the statements from top to bottom; each can use the declarations above it."""

    def __init__(self, parsed: Parsed, imports: tuple[Source, ...]) -> None:
        self.parsed = parsed
        self.imports = imports
        self.requirements: dict[str, f.Formula] = {}
        self.certify: dict[str, CertifySettings] = {}
        self.depths: dict[int, int] = {}
        self.scope = Scope(
            poisoned={broken.name for broken in parsed.broken if broken.name},
            later={
                item.name.text: item.name.span
                for item in parsed.statements
                if not isinstance(item, syntax.Certify)
            },
        )

    def run(self) -> Iterator[Diagnostic]:
        """Check every statement; ``certify`` lines last, when the whole test space is known."""
        for statement in self.parsed.statements:
            if isinstance(statement, syntax.Certify):
                continue
            name = statement.name.text
            try:
                declared = self._declare(statement)
            except Mistake as mistake:
                self.scope.poisoned.add(name)
                yield from mistake.diagnostics
                continue
            if name not in self.scope.declared:  # the first of two declarations counts
                self.scope.declared[name] = declared
                if isinstance(statement, syntax.Require) and isinstance(declared, Definition):
                    assert isinstance(declared.body, f.Formula)
                    self.requirements[name] = declared.body
        yield from self._check_certify()

    def _check_certify(self) -> Iterator[Diagnostic]:
        """Check the ``certify`` lines; a requirement's own line overrides the line for all."""
        lines = [line for line in self.parsed.statements if isinstance(line, syntax.Certify)]
        for line in sorted(lines, key=lambda line: line.name is None):
            names = list(self.requirements) if line.name is None else [line.name.text]
            for name in names:
                try:
                    settings = certify_settings(line, self.requirements.get(name), self.scope)
                except Mistake as mistake:
                    yield from mistake.diagnostics
                else:
                    own = self.certify.get(name)
                    self.certify[name] = settings if own is None else own.over(settings)

    def document(self) -> Document:
        """Return the checked document; valid only if there were no mistakes."""
        declared = self.scope.declared
        return Document(
            self.parsed.source,
            self.imports,
            {name: item for name, item in declared.items() if isinstance(item, Signal)},
            {name: item for name, item in declared.items() if isinstance(item, Param)},
            self.requirements,
            self.certify,
        )

    def _declare(self, statement: syntax.Statement) -> Declaration:
        scope = self.scope
        assert statement.name is not None
        span = statement.name.span
        match statement:
            case syntax.Signal(name=word, dim=dim):
                unit = unit_of(statement.unit)
                if dim is not None and not (dim.value.is_integer() and 1 <= dim.value <= _WIDEST):
                    fail("E17", f"a vector has 1 to {_WIDEST} components, not `{dim.span.text}`", dim.span)
                width = 1 if dim is None else int(dim.value)
                range_ = range_of(statement.range, scope, unit, word.text)
                vector, boolean = dim is not None, statement.boolean
                return Signal(word.text, unit.text, width, range_, vector, boolean, unit, span)
            case syntax.Param(name=word):
                unit = unit_of(statement.unit)
                range_ = range_of(statement.range, scope, unit, word.text)
                if range_ is not None and not math.isfinite(range_[1] - range_[0]):
                    assert statement.range is not None
                    message = f"the range of `{word.text}` is wider than the largest number, 1.8e308"
                    fail("E09", message, statement.range.span, "make the range narrower")
                default = None
                if statement.default is not None:
                    default = quantity(statement.default, scope, unit, f"the default of `{word.text}`")
                    if range_ is not None and not range_[0] <= default <= range_[1]:
                        limits = f"[{range_[0]:g}, {range_[1]:g}]"
                        message = f"the default of `{word.text}` is outside its range {limits}"
                        fail("E09", message, statement.default.span)
                return Param(word.text, unit.text, range_, default, unit, span)
            case syntax.Const():
                return Definition(self._constant(statement), span)
            case syntax.Let(body=body):
                checked = check(body, scope)
                self._depth(checked, span)
                number = constant(checked) if isinstance(checked, f.Value) and checked.width == 1 else None
                if number is not None and isinstance(checked, f.Value):
                    # evaluated once, so that a chain of definitions is not evaluated repeatedly
                    checked = f.Number(span=checked.span, unit=checked.unit, value=number)
                return Definition(checked, span)
            case syntax.Require(body=body):
                formula = condition(body, scope, "`require`")
                self._depth(formula, span)
                return Definition(formula, span)
            case _:
                raise AssertionError(statement)

    def _constant(self, statement: syntax.Const) -> f.Number:
        name = statement.name.text
        if statement.unit is not None:
            unit = unit_of(statement.unit)
            number = quantity(statement.value, self.scope, unit, f"`{name}`")
            return f.Number(span=statement.span, unit=unit, value=number)
        checked = check(statement.value, self.scope)
        own = checked.unit if isinstance(checked, f.Value) else None
        number = quantity(statement.value, self.scope, own, f"`{name}`")
        return f.Number(span=statement.span, unit=own, value=number)

    def _depth(self, node: f.Node, span: Span) -> None:
        if self._levels(node) > DEEPEST + 20:
            deep = f"`{span.text}` is nested more than {DEEPEST} levels deep"
            fail("E19", f"{deep}, counting the definitions that it uses", span)

    def _levels(self, node: f.Node) -> int:
        # each statement adds a bounded number of levels, so the recursion depth is bounded
        if id(node) not in self.depths:
            self.depths[id(node)] = 1 + max((self._levels(child) for child in f.children(node)), default=0)
        return self.depths[id(node)]
