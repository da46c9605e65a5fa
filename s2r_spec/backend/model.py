"""What a backend declares: its channels, the parameters of a test, and the catalogue of its effects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from s2r_spec.base.errors import UsageError, did_you_mean, one_of


@dataclass(frozen=True)
class Channel:
    """A channel that every trace of the backend has.

    Attributes:
        name: name in specs.
        unit: unit of all columns.
        description: meaning, in one line.
        width: number of columns.
        columns: name of each column ("FR hip"), for messages; empty if columns only have numbers.
    """

    name: str
    unit: str
    description: str
    width: int = 1
    columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.columns and len(self.columns) != self.width:
            raise UsageError(
                f"the channel {self.name} has {self.width} columns, but {len(self.columns)} names of columns: name all "
                f"or none"
            )


@dataclass(frozen=True)
class Parameter:
    """A test parameter that the backend accepts, with the range that it can run."""

    name: str
    unit: str
    low: float
    high: float
    default: float
    description: str

    def check(self, value: Any) -> float:
        """Return the value as a float in this parameter's unit.

        Args:
            value: a number in this unit, a text with a unit ("30 cm/s"), or a pint Quantity.

        Raises:
            UsageError: the value is not a number, lies outside the range, or has a unit that does not fit.
        """
        if not isinstance(value, float | int):
            value = self._read(value)
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise UsageError(
                f"{self.name} = {value!r} is not a number; its range is [{self.low:g}, {self.high:g}] {self.unit}"
            ) from None
        if not self.low <= number <= self.high:
            raise UsageError(
                f"{self.name} = {number:g} {self.unit} is outside the backend's range "
                f"[{self.low:g}, {self.high:g}] {self.unit}"
            )
        return number

    def _read(self, value: Any) -> Any:
        """Return a value that has a unit as a number in this parameter's unit; any other value unchanged."""
        from s2r_spec.lang.amounts import PintQuantity, read_amount
        from s2r_spec.lang.units import UnknownUnitError, parse_unit

        if not isinstance(value, str | PintQuantity):
            return value
        try:
            return read_amount(value, parse_unit(self.unit), self.name)
        except UnknownUnitError:
            raise UsageError(
                f"{self.name} = {value!r}: the backend declares it in {self.unit!r}, which is not a unit; give a number"
            ) from None


def refuse_unknown(name: str, parameters: Iterable[Parameter], params: Iterable[str]) -> None:
    """Refuse a test with an undeclared parameter, because the rollout would run a different test.

    Raises:
        UsageError: the backend does not declare one of them.
    """
    known = [parameter.name for parameter in parameters]
    for other in params:
        if other not in known:
            raise UsageError(
                f"the backend {name!r} has no parameter {other!r}{did_you_mean(other, known)}; it has {one_of(known)}"
            )


def read_test(name: str, parameters: Iterable[Parameter], params: Mapping[str, float]) -> dict[str, float]:
    """Return the value of every declared parameter; a missing one takes its default.

    Raises:
        UsageError: a parameter is not declared, is not a number, or is outside its range.
    """
    parameters = tuple(parameters)
    refuse_unknown(name, parameters, params)
    return {p.name: p.check(params.get(p.name, p.default)) for p in parameters}


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect; at its nominal value the effect does nothing.

    ``beside`` names another parameter of the effect without which this one does nothing, such as a friction whose part
    at one leg it is; "" for the first one that acts.
    """

    name: str
    unit: str
    low: float
    high: float
    nominal: float
    prior: str
    beside: str = ""


@dataclass(frozen=True)
class Effect:
    """One unmodelled piece of physics that a backend can add to itself."""

    name: str
    family: str
    physics: str
    parameters: tuple[EffectParameter, ...]
