"""The account of the instants at which a requirement is evaluated.

Identity: all stamps of all signals in a window, and its begin, are for each signal own + held + interpolated + missing.
:mod:`s2r_spec.logs.account` has the part from the file to the trace.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.robustness.stream import SignalMessages
from s2r_spec.trace.messages import Span

_PIECE = 2**18
"""Budget: stamps that are counted at a time."""


@dataclass(frozen=True)
class Instants:
    """The instants at which a signal is evaluated: own + held + interpolated + missing of them all."""

    own: int
    held: int
    interpolated: int
    missing: int


def instants_of(
    streams: Mapping[str, SignalMessages], silent: Mapping[str, Sequence[Span]], start: float, end: float
) -> dict[str, Instants]:
    """Return signal → its instants from a start to an end [s].

    ``silent``: signal → spans without a valid value, after the start [s].
    """
    own = {one.topic: one.messages.times for one in streams.values()}
    inner = {key: _inside(times, start, end) for key, times in own.items()}
    sizes = {key: int(np.count_nonzero(np.diff(part))) + 1 if part.size else 0 for key, part in inner.items()}
    distinct = _distinct(list(inner.values()), start, end)
    instants = {}
    for name, stream in streams.items():
        missing = 0
        for begin, stop in silent[name]:
            after = math.nextafter(start + begin, math.inf)
            before = math.nextafter(start + stop, -math.inf)
            parts = [_inside(part, after, before) for part in inner.values()]
            missing += np.unique(np.concatenate([*parts, [start] * (begin < 0.0 < stop)])).size
        rest = distinct - sizes[stream.topic] - missing
        held, interpolated = (0, rest) if stream.messages.linear else (rest, 0)
        instants[name] = Instants(sizes[stream.topic], held, interpolated, missing)
    return instants


def _inside(times: FloatArray, start: float, end: float) -> FloatArray:
    return times[np.searchsorted(times, start) : np.searchsorted(times, end, side="right")]


def _distinct(parts: Sequence[FloatArray], start: float, end: float) -> int:
    """Return the number of distinct times of sorted arrays, with the start; a piece of time after the other."""
    pieces = sum(part.size for part in parts) // _PIECE + 1
    borders = np.linspace(start, end, pieces + 1)[1:-1]
    cuts = [[0, *np.searchsorted(part, borders).tolist(), part.size] for part in parts]
    count = 0 if any(part.size and part[0] == start for part in parts) else 1
    for k in range(pieces):
        count += np.unique(
            np.concatenate([part[at[k] : at[k + 1]] for part, at in zip(parts, cuts, strict=True)])
        ).size
    return count
