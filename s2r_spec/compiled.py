"""Compile the small functions that a backend calls in every tick, by Numba."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])

_kept: dict[Callable[..., Any], bool] = {}
"""Function → whether its machine code is kept on disk."""


def compiled(function: F) -> F:
    """Compile a function at its first call, and keep the machine code on disk for later processes.

    It is kept in the folder of the function's file, or in the user's cache if that folder cannot be written. Without
    either, every process compiles. The first compilation of a process is announced.

    Numba compares only the function's own file with its cache. So a compiled function may call compiled functions of
    its own file only; a test checks all of them. The arithmetic follows the source: nothing is reordered or fused,
    and a division by zero gives infinity instead of an error.
    """
    import numba  # here, because only backends compile functions

    _listen()
    try:
        made = numba.njit(cache=True, error_model="numpy")(function)
        _kept[function] = True
    except RuntimeError:  # no folder for the machine code
        made = numba.njit(error_model="numpy")(function)
        _kept[function] = False
    return cast(F, made)


def say(sentence: str) -> None:
    """Print a sentence on standard error. A worker process puts another function here: its parent prints."""
    print(sentence, file=sys.stderr, flush=True)


@cache
def _listen() -> None:
    """Announce when Numba begins to compile, because it takes much longer than a rollout."""
    from numba.core import event

    class Announcement(event.Listener):
        def on_start(self, event: Any) -> None:
            function = event.data["dispatcher"].py_func
            if function in _kept:
                _announce(function.__module__.partition(".")[0], _kept[function])

        def on_end(self, event: Any) -> None:
            pass

    event.register("numba:compile", Announcement())  # type: ignore[no-untyped-call]


@cache
def _announce(package: str, kept: bool) -> None:
    how = (
        "once per installation"
        if kept
        else "in each process, because no folder for their cache can be written"
    )
    say(f"note: compiling the functions of {package}, {how}; this may take half a minute of one core")
