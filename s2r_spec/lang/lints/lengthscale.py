"""Lengthscales longer than the range of their parameter: often a number in another unit."""

from __future__ import annotations

from collections.abc import Iterator

from s2r_spec.lang import syntax
from s2r_spec.lang.declarations import Document, Param
from s2r_spec.lang.lints.finding import LintWarning, nodes
from s2r_spec.lang.parsing import Parsed
from s2r_spec.lang.units import PLAIN, Unit, UnknownUnitError, parse_unit

_TURNED = {"rad": "deg", "rad/s": "deg/s", "s": "ms"}
_PREFIXES = ("c", "m", "u")


def long_lengthscale(parsed: Parsed, document: Document) -> Iterator[LintWarning]:
    """``matern52(150 {m})`` for a parameter in [-0.3, 0.3] m means that the parameter has almost no influence."""
    axes = [param for param in document.params.values() if param.searched]
    for statement in nodes(parsed):
        if not isinstance(statement, syntax.Certify):
            continue
        written = next(
            (setting.value for setting in statement.settings if setting.key.text == "kernel"), None
        )
        settings = document.certify.get(
            statement.name.text if statement.name else next(iter(document.certify))
        )
        if not isinstance(written, syntax.Call) or settings is None or settings.kernel is None:
            continue
        places = written.arguments if len(written.arguments) > 1 else written.arguments * len(axes)
        for place, axis, length in zip(places, axes, settings.kernel.lengthscales, strict=False):
            low, high = axis.range or (length, length)
            if length > high - low > 0:
                message = (
                    f"the lengthscale of `{axis.name}`, {_with_unit(length, axis.unit)}, is "
                    f"{length / (high - low):.3g} times its range"
                )
                yield LintWarning("L08", message, place.span, _fix(length, axis, high - low))


def _fix(length: float, axis: Param, width: float) -> str:
    for unit in _alternatives(axis.measure):
        converted = unit.to(axis.measure)(length)
        if width / 100 <= converted <= width:
            return f"if {length:g} {unit.text} is meant, write `{length:g} {{{unit.text}}}`"
    return "a lengthscale is the distance between two tests over which E ρ is still related"


def _alternatives(unit: Unit) -> Iterator[Unit]:
    """Yield units of the same dimension that may have been meant."""
    if unit == PLAIN:
        return
    for text in (_TURNED.get(unit.text, ""), *(prefix + unit.text for prefix in _PREFIXES)):
        try:
            other = parse_unit(text)
        except UnknownUnitError:
            continue
        if text and other.fits(unit) and not other.offset:
            yield other


def _with_unit(number: float, unit: str) -> str:
    return f"{number:g} {unit}".rstrip()
