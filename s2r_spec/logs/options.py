"""Options that say how logs are read: the columns of channels and times, and the unit of times."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import dataclass

from s2r_spec.base.errors import UsageError
from s2r_spec.logs.times import time_units

TIME = "t"
"""Definition: name of the times, as ``--map`` takes it."""


@dataclass(frozen=True)
class TimeOptions:
    """What the user says of the times, if anything.

    Args:
        unit: unit of times that are plain numbers.
        times: path of the array of times, its last part, or two joined by "+".
    """

    unit: str | None = None
    times: str | None = None


def map_argument(name: str) -> str:
    """Return the argument of ``--map`` that takes the times from a column, in quotes where a shell needs them."""
    return shlex.quote(f"{TIME}={name}")


def unit_of_option(text: str | None) -> str | None:
    """Return the unit after a check that it is a unit of time.

    Raises:
        UsageError: the text is not a unit of time.
    """
    if text is not None and time_units.size(text) is None:
        raise UsageError(f"time-unit {text!r} is not a unit of time; write s, ms, us, ns or min")
    return text


def read_map(texts: Iterable[str]) -> dict[str, str]:
    """Return channel → column, from texts like ``vx=velocity.x``.

    Raises:
        UsageError: a text is not of this form, or a name is mapped twice.
    """
    names: dict[str, str] = {}
    for text in texts:
        name, _, column = (part.strip() for part in text.partition("="))
        if not name or not column:
            raise UsageError(f"--map {text!r} is not name=column, such as --map vx=velocity.x")
        if names.get(name, column) != column:
            raise UsageError(f"--map maps {name!r} twice, to {names[name]!r} and to {column!r}; map it once")
        names[name] = column
    return names
