"""Compilation, by Numba, of the small functions that every tick of a backend runs through."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile a function at its first call, and keep the machine code on disk for later processes.

    Numba looks only at the function's own file to see whether what it kept is
    out of date. So a compiled function calls compiled functions of its own file
    alone; a test holds all of them to it. Arithmetic is that of the source:
    nothing is reordered or fused, and a division by zero gives infinity, not an error.
    """
    import numba  # here: nothing but a backend is compiled

    return cast(F, numba.njit(cache=True, error_model="numpy")(function))
