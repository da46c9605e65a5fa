"""The declarations of a specification: signals, parameters, the test space, requirements."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from s2r_spec.base.errors import TraceError, UsageError, one_of, shortened, suggest
from s2r_spec.base.printable import one_line
from s2r_spec.lang import formula as f
from s2r_spec.lang.declarations import CertifySettings, Param, Signal
from s2r_spec.robustness.binding import names
from s2r_spec.robustness.horizon import horizon
from s2r_spec.robustness.reading import read_param
from s2r_spec.space import Axis, Space


@dataclass(frozen=True, eq=False)
class Declared:
    """A checked specification, before any trace.

    Args:
        name: its name in messages; the path if it was loaded.
        text: its text, with line feeds as line endings.
        imported: name → text of every file that it imports, directly or not.
        signals: name → declaration of a channel that a trace must have.
        params: name → declaration of a test parameter.
        formulas: requirement → its checked formula, in declared order.
        certify: requirement → settings, for those that have a ``certify`` line.
    """

    name: str
    text: str
    imported: Mapping[str, str]
    signals: Mapping[str, Signal]
    params: Mapping[str, Param]
    formulas: Mapping[str, f.Formula]
    certify: Mapping[str, CertifySettings]

    def __repr__(self) -> str:
        """Return one line: requirements, signals and parameters with their units."""
        signals, params = (", ".join(map(_with_unit, of.values())) for of in (self.signals, self.params))
        with_params = f"; params {params}" if params else ""
        return one_line(
            f"Spec({self.name!r}: {', '.join(self.requirements)}; signals {signals or 'none'}{with_params})"
        )

    @property
    def hash(self) -> str:
        """SHA-256 of the text and its imports, as hex digits; independent of line endings."""
        return hash_of(self.text, self.imported.values())

    @property
    def requirements(self) -> tuple[str, ...]:
        """Names of the requirements, in declared order."""
        return tuple(self.formulas)

    @property
    def space(self) -> Space:
        """The test space: every parameter with a range and no default, in declared order."""
        return Space(
            tuple(Axis(p.name, *p.range, p.unit) for p in self.params.values() if p.range and p.searched)
        )

    def read_params(self, texts: Iterable[str]) -> dict[str, float]:
        """Return name → value in the declared unit, from texts like ``vd=0.3`` or ``vd=30 cm/s``.

        Raises:
            UsageError: a text is not of this form, a name is unknown, or a unit does not fit.
        """
        return dict(read_param(self.params, text) for text in texts)

    def recorded_params(self, meta: Mapping[str, Any]) -> dict[str, float]:
        """Return parameter → value in the metadata of a trace, in the declared unit.

        Raises:
            TraceError: ``meta["params"]`` maps no names to numbers.
        """
        recorded = meta.get("params", {})
        if not isinstance(recorded, Mapping):
            raise TraceError('its meta "params" must map names of parameters to numbers')
        values = {name: recorded[name] for name in self.params if name in recorded}
        for name, value in values.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise TraceError(f"its parameter {name} = {shortened(repr(value))} is not a finite number")
        return {name: float(value) for name, value in values.items()}

    def unit(self, requirement: str) -> str:
        """Return the unit of ρ: "" if it has none, "mixed" if ρ combines margins of different dimensions."""
        unit = self._formula(requirement).unit
        return "" if unit is None else unit.text

    def channels(self, requirement: str | None = None) -> tuple[str, ...]:
        """Return the names of the signals that a requirement (or any) uses, in declared order."""
        used = {name for formula in self._chosen(requirement) for name in names(formula).signals}
        return tuple(name for name in self.signals if name in used)

    def horizon(self, requirement: str | None = None) -> float:
        """Return the duration that a trace needs to decide a requirement (or all) at its start [s].

        It is inf if an unbounded operator depends on the whole rest of a trace. ``next`` counts as 0, since its length
        is one sample period. A parameter as time bound counts with the greatest value of its range.
        """
        return max(horizon(formula) for formula in self._chosen(requirement))

    def _formula(self, requirement: str) -> f.Formula:
        if requirement not in self.formulas:
            raise UsageError(
                f"{self.name} has no requirement {requirement!r}{suggest(requirement, self.formulas)} "
                f"it has {one_of(self.formulas)}"
            )
        return self.formulas[requirement]

    def _chosen(self, requirement: str | None) -> Sequence[f.Formula]:
        return tuple(self.formulas.values()) if requirement is None else (self._formula(requirement),)


def hash_of(text: str, imported: Iterable[str]) -> str:
    """Return the SHA-256 of a specification's text and of its imports' texts, as hex digits."""
    return hashlib.sha256("\0".join((text, *imported)).encode()).hexdigest()


def _with_unit(one: Signal | Param) -> str:
    """Return a declaration as ``vd [m/s]``."""
    return f"{one.name} [{one.unit}]" if one.unit else one.name
