"""Records as plain JSON values: one rule for every object that a command prints."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from operator import attrgetter
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    NotRequired,
    TypeVar,
    cast,
    get_args,
    get_type_hints,
)

from typing_extensions import TypedDict

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Record = TypeVar("Record", bound="DataclassInstance")

Point = dict[str, float]
"""Test parameter → value, in the unit that the specification declares."""
Ends = tuple[float, float]
ExitCode = Literal[0, 1, 3]

OPTIONAL: Mapping[str, bool] = {"optional": True}
"""Metadata of a field that the JSON object lacks where it is None; every other field is always there."""
DIGITS = "digits"
"""Metadata of a field: the number of decimals that the JSON object of a :class:`Shown` has."""


class Open(TypedDict):
    """An object that may have further fields."""


class Shown:
    """A record whose JSON object has other entries than the record has fields.

    ``JSON`` has these entries in their order: "name" of an attribute, "name=path" of an attribute of an attribute,
    or "*name" of a mapping or record whose entries are the object's. A method of a path is called. The type of an
    entry is that of the attribute. Its description is its row in the record's docstring, or the docstring of the
    property.
    """

    JSON: ClassVar[str]

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """Return pydantic's schema of the JSON object."""
        return handler(_describe(cast(Any, cls)))


def _entries(record: type[Shown]) -> dict[str, str]:
    pairs = (entry.partition("=") for entry in record.JSON.split())
    return {name: path or name for name, _, path in pairs}


@cache
def _describe(record: Any) -> Any:
    """Return a typed dictionary with the types of the entries, and descriptions of those that the record lacks."""
    types: dict[str, Any] = {}
    rows, bases = ["Attributes:"], []
    own_fields, optional = {each.name for each in fields(record)}, optional_fields(record)
    summary, _, own = (record.__doc__ or "").partition("\n\n")
    for name, path in _entries(record).items():
        kind, words = _kind(record, path.removeprefix("*"))
        if name.startswith("*"):
            spread = _describe(kind) if issubclass(kind, Shown) else kind
            types |= get_type_hints(spread, include_extras=True)
            bases.append(spread)
            continue
        if name in optional:
            (kind,) = (each for each in get_args(kind) if each is not type(None))
            kind = NotRequired[kind]
        types[name] = kind
        hidden = path != name and name in own_fields  # by an entry of the same name
        if words and (hidden or f" {name}: " not in own):
            rows.append(f"    {name}: {words}")
    made = TypedDict(record.__name__, types)  # type: ignore[misc]
    made.__orig_bases__ = (*bases, record)  # type: ignore[attr-defined]
    made.__doc__ = "\n".join([summary, "", *rows])
    return made


def _kind(record: type, path: str) -> tuple[Any, str]:
    """Return the type at the end of a path of attributes, and the docstring of a property there."""
    name, _, rest = path.partition(".")
    if name == "__str__":
        return str, ""
    attribute: Any = getattr(record, name, None)
    function = getattr(attribute, "fget", None) or getattr(attribute, "func", None)
    if function is None and callable(attribute):
        function = attribute
    hints = get_type_hints(function or record, include_extras=True)
    kind = hints["return" if function else name]
    if rest:
        return _kind(kind, rest)
    words = "" if callable(attribute) or not function else (function.__doc__ or "").split("\n\n")[0]
    return kind, words[:1].lower() + words[1:]


def extend(kind: type[Record], record: Any, **more: Any) -> Record:
    """Return a record of a kind, with the fields that it shares with another record, and these more."""
    own = {each.name for each in fields(kind)}
    shared = {each.name for each in fields(record) if each.init} & own
    return kind(**{name: getattr(record, name) for name in shared} | more)


def optional_fields(record: Any) -> frozenset[str]:
    """Return the names of the fields of a record, or of its class, that are optional."""
    return frozenset(each.name for each in fields(record) if each.metadata.get("optional"))


def to_json(value: Any, infinite: bool = False) -> Any:
    """Return a record as plain JSON values: its fields in their order, an enumeration as its value.

    Args:
        value: a dataclass, or what a field of one holds.
        infinite: whether a number that is not finite becomes its word: "inf", "-inf" or "nan".
    """
    if is_dataclass(value):
        absent = optional_fields(value)
        own = isinstance(value, Shown)
        kind: Any = type(value)
        paths = _entries(kind) if own else {each.name: each.name for each in fields(value)}
        digits = {each.name: each.metadata[DIGITS] for each in fields(value) if DIGITS in each.metadata}
        shown: dict[str, Any] = {}
        for name, path in paths.items():
            one = attrgetter(path.removeprefix("*"))(value)
            if one is None and name in absent:
                continue
            one = to_json(one() if own and callable(one) else one, infinite)
            one = round(one, digits[path]) if own and path in digits else one
            shown |= one if name.startswith("*") else {name: one}
        return shown
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {key: to_json(one, infinite) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(one, infinite) for one in value]
    return str(value) if infinite and isinstance(value, float) and not math.isfinite(value) else value


def document(record: Any) -> str:
    """Return a record as indented JSON text.

    Raises:
        ValueError: a number in it is not finite.
    """
    return json.dumps(to_json(record), allow_nan=False, indent=2, ensure_ascii=False)


def line(record: Any, infinite: bool = False) -> str:
    """Return a record as one line of JSON.

    Raises:
        ValueError: a number in it is not finite, and ``infinite`` is not given.
    """
    return json.dumps(to_json(record, infinite), allow_nan=False)
