"""A cache for results that depend only on a formula, for use with many traces."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar, TypeVarTuple

T = TypeVar("T")
R = TypeVar("R")
Rest = TypeVarTuple("Rest")


def once(compute: Callable[[T, *Rest], R]) -> Callable[[T, *Rest], R]:
    """Cache a function's last result for each object, for as long as the object lives.

    The objects must be frozen. They are compared by identity, since the hash of a formula takes a walk over all of it.
    A call with other further arguments replaces the result.
    """
    results: dict[int, tuple[weakref.ref[T], tuple[*Rest], R]] = {}

    @wraps(compute)
    def cached(subject: T, *rest: *Rest) -> R:
        key = id(subject)
        entry = results.get(key)
        if entry is not None and entry[1] == rest:
            return entry[2]
        result = compute(subject, *rest)
        results[key] = weakref.ref(subject, lambda _: results.pop(key, None)), rest, result
        return result

    return cached
