"""Records as plain JSON values: one rule for every object that a command prints."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

OPTIONAL: Mapping[str, bool] = {"optional": True}
"""Metadata of a field that the JSON object lacks where it is None; every other field is always there."""


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
        found = {each.name: getattr(value, each.name) for each in fields(value)}
        return {
            name: to_json(one, infinite)
            for name, one in found.items()
            if one is not None or name not in absent
        }
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {key: to_json(one, infinite) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(one, infinite) for one in value]
    return str(value) if infinite and isinstance(value, float) and not math.isfinite(value) else value


def line(record: Any, infinite: bool = False) -> str:
    """Return a record as one line of JSON.

    Raises:
        ValueError: a number in it is not finite, and ``infinite`` is not given.
    """
    return json.dumps(to_json(record, infinite), allow_nan=False)
