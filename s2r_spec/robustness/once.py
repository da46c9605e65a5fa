"""What follows from a formula alone is found once, however many traces it is evaluated on."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar, TypeVarTuple

T = TypeVar("T")
R = TypeVar("R")
Rest = TypeVarTuple("Rest")


def once(find: Callable[[T, *Rest], R]) -> Callable[[T, *Rest], R]:
    """Let a function remember what it last found for an object, for as long as the object lives.

    For frozen objects: they are told apart by identity, for to hash a formula is to
    walk all of it. Further arguments are compared; other ones take the place of the last.
    """
    known: dict[int, tuple[weakref.ref[T], tuple[*Rest], R]] = {}

    @wraps(find)
    def found(subject: T, *rest: *Rest) -> R:
        key = id(subject)
        entry = known.get(key)
        if entry is not None and entry[1] == rest:
            return entry[2]
        result = find(subject, *rest)
        known[key] = weakref.ref(subject, lambda _: known.pop(key, None)), rest, result
        return result

    return found
