"""A ``certify`` line as text, and a specification with another one in its place."""

from __future__ import annotations

from collections.abc import Sequence

from s2r_spec.base.errors import UsageError
from s2r_spec.lang import syntax
from s2r_spec.lang.declarations import CertifySettings
from s2r_spec.lang.imports import imported_names
from s2r_spec.lang.parsing import parse
from s2r_spec.lang.printing import format_text
from s2r_spec.lang.source import Source


def certify_line(requirement: str, settings: CertifySettings, units: Sequence[str]) -> str:
    """Return the line in the standard layout, without a line feed at its end.

    ``units`` are those of the lengthscales, one for each axis of the test space, "" for none.
    """
    words = [f"{name} = {_number(getattr(settings, name))}" for name in ("delta", "epsilon", "B", "R")]
    if settings.kernel is not None:
        pairs = zip(settings.kernel.lengthscales, units, strict=True)
        scales = ", ".join(f"{_number(one)} {{{unit}}}" if unit else _number(one) for one, unit in pairs)
        words.append(f"kernel = {settings.kernel.name}({scales})")
    words.append(f"fall = {_number(settings.fall)}")
    own = ((name, getattr(settings, name)) for name in ("gap_epsilon", "gap_B", "gap_R"))
    words += [f"{name} = {_number(value)}" for name, value in own if value is not None]
    return format_text(f"certify {requirement}: {', '.join(words)}").rstrip("\n")


def _number(value: float | None) -> str:
    """Return a setting as people write it: 1e-6, not 1e-06."""
    mantissa, mark, exponent = f"{value:g}".partition("e")
    return f"{mantissa}{mark}{int(exponent)}" if mark else mantissa


def with_certify_line(text: str, name: str, requirement: str, line: str) -> tuple[str, int]:
    """Return a specification whose certify line of a requirement is another one, and the number of that line.

    A specification without such a line gets it at its end. Comments inside the old line go with it; all other text
    stays.

    Raises:
        UsageError: a statement does not parse.
    """
    source = Source.of(text, name)
    parsed = parse(source, imported_names(source))
    if parsed.diagnostics:
        raise UsageError(f"{name} does not parse, so that no line can be put into it")
    own = [
        item
        for item in parsed.statements
        if isinstance(item, syntax.Certify) and item.name is not None and item.name.text == requirement
    ]
    if own:
        start, end = own[0].span.start, own[0].span.end
        written, number = source.text[:start] + line + source.text[end:], own[0].span.line
    else:
        before = source.text if source.text.endswith("\n") else source.text + "\n"
        written, number = f"{before}{line}\n", before.count("\n") + 1
    return (written.replace("\n", "\r\n") if "\r\n" in text else written), number
