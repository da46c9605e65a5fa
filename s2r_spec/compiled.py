"""Compile the small functions that a backend calls in every tick, by Numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile a function at its first call, and cache the machine code on disk for later processes.

    Numba compares only the function's own file with its cache. So a compiled function may call compiled functions of
    its own file only; a test checks all of them. The arithmetic follows the source: nothing is reordered or fused,
    and a division by zero gives infinity instead of an error.
    """
    import numba  # here, because only backends compile functions

    return cast(F, numba.njit(cache=True, error_model="numpy")(function))
