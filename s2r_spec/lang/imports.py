"""A file merged with all files that it imports: declarations of an imported file come first."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from os.path import dirname, join, normpath

from s2r_spec.base.errors import UsageError
from s2r_spec.lang import syntax
from s2r_spec.lang.diagnostics import Diagnostic
from s2r_spec.lang.files import read_text
from s2r_spec.lang.parsing import Parsed, parse
from s2r_spec.lang.source import Source

DEEPEST = 50
"""Budget: longest chain of files that import one another; Python's stack ends after about 300."""


def gather(source: Source, stored: Mapping[str, str] | None = None) -> tuple[Parsed, tuple[Source, ...]]:
    """Return the statements of a source and of its imports, and the imported sources, each once.

    A path is relative to the file that imports it. All files are in ``stored``, name → text, or else on disk.
    """
    files: dict[str, Parsed] = {}
    parsed = _gather(source, (normpath(source.name),), files, stored)
    return parsed, tuple(file.source for file in files.values())


def imported_names(source: Source) -> frozenset[str]:
    """Return the names that imported files declare: they are not short names of operators here."""
    _, files = gather(source)
    return frozenset(name for file in files for name in _declared_names([parse(file)]))


def _gather(
    source: Source, chain: tuple[str, ...], files: dict[str, Parsed], stored: Mapping[str, str] | None
) -> Parsed:
    parts: list[Parsed] = []
    mistakes: list[Diagnostic] = []
    own = parse(source)
    for line in own.imports:
        # "parts/../a.stl" is "a.stl"; otherwise a file could import itself unnoticed
        name = normpath(join(dirname(source.name), line.path.text))
        if name in chain:
            mistakes.append(Diagnostic("E21", f"`{name}` imports itself", line.path.span))
        elif len(chain) > DEEPEST:
            sentence = f"`{name}` is imported by a chain of more than {DEEPEST} files"
            mistakes.append(Diagnostic("E21", sentence, line.path.span))
        elif name not in files:
            try:
                text = _read(name, stored)
            except UsageError as error:
                mistakes.append(Diagnostic("E21", str(error), line.path.span))
                continue
            imported = _gather(Source.of(text, name), (*chain, name), files, stored)
            files[name] = replace(imported, source=Source.of(text, name))
            parts.append(imported)
    if own.imports:
        # parsed again with the imported names: a declared letter is not an operator
        own = parse(source, frozenset(_declared_names(files.values())))
    parts.append(replace(own, diagnostics=(*own.diagnostics, *mistakes)))
    return Parsed(
        source,
        tuple(statement for part in parts for statement in part.statements),
        own.imports,
        tuple(statement for part in parts for statement in part.broken),
        tuple(diagnostic for part in parts for diagnostic in part.diagnostics),
    )


def _read(name: str, stored: Mapping[str, str] | None) -> str:
    if stored is None:
        return read_text(name)
    if name not in stored:
        raise UsageError(f"{name} is not among the stored imports")
    return stored[name]


def _declared_names(files: Iterable[Parsed]) -> Iterator[str]:
    for parsed in files:
        for statement in parsed.statements:
            if not isinstance(statement, syntax.Certify | syntax.Require):
                yield statement.name.text
