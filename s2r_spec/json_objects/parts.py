"""Parts that the objects of several commands share."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from annotated_types import Ge, Interval
from typing_extensions import TypedDict

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Record = TypeVar("Record", bound="DataclassInstance")

Count = Annotated[int, Ge(0)]
Magnitude = Annotated[float, Ge(0)]
Probability = Annotated[float, Interval(ge=0, le=1)]
Level = Annotated[float, Interval(gt=0, lt=1)]
"""A probability that is neither impossible nor sure, such as δ."""
Point = dict[str, float]
"""Test parameter → value, in the unit that the specification declares."""
Failures = dict[str, Annotated[int, Ge(1)]]
"""Word for a failure → number of rollouts that ended with it."""
ExitCode = Literal[0, 1, 3]


class Open(TypedDict):
    """An object that may have further fields."""


@dataclass(frozen=True, kw_only=True)
class Location:
    """The place of a requirement in the files.

    Attributes:
        file: the specification.
        line: counted from 1.
    """

    file: str
    line: Annotated[int, Ge(1)]


def extended(kind: type[Record], record: Any, **more: Any) -> Record:
    """Return a record of a kind, with the fields that it shares with another record, and these more."""
    own = {each.name for each in fields(kind)}
    shared = {each.name for each in fields(record) if each.init} & own
    return kind(**{name: getattr(record, name) for name in shared} | more)
