"""Check of a formula's time windows against the sample period of a trace."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from s2r_spec.base.errors import SamplingError
from s2r_spec.lang import formula as f
from s2r_spec.robustness.grid import SNAP
from s2r_spec.robustness.once import once

SMALLER_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Definition: units of time in logs, in seconds, the largest first."""


@dataclass(frozen=True)
class BoundedWindow:
    """A bounded time window, relative to an instant.

    Args:
        interval: distances of its nearer and farther end from the instant [s], and its place in the text.
        past: whether it lies before the instant.
    """

    interval: f.Interval
    past: bool

    @property
    def length(self) -> float:
        """Length of the window [s]."""
        return self.interval.high - self.interval.low


def windows(formula: f.Formula) -> Iterator[BoundedWindow]:
    """Yield every window of positive, finite length, of temporal operators and of functions of the past."""
    for node in f.walk(formula):
        match node:
            case f.Temporal() | f.Until():
                window = BoundedWindow(node.interval, node.operator in ("historically", "once", "since"))
            case f.Count() | f.Accumulated() | f.Delayed():
                window = BoundedWindow(f.Interval(0.0, node.seconds, True, True, node.span), True)
            case _:
                continue
        if 0.0 < window.length < math.inf:
            yield window


@once
def narrowest(formula: f.Formula) -> BoundedWindow | None:
    """Return the shortest of :func:`windows`; None if there is none."""
    return min(windows(formula), key=lambda window: window.length, default=None)


def refuse_short(window: BoundedWindow | None, period: float | None, name: str = "the sample period") -> None:
    """Refuse a window that is shorter than the time from one sample to the next.

    It has at most one sample, so the samples do not cover the rest of it.

    Args:
        window: the narrowest of a formula; None for none.
        period: median time from one sample to the next [s]; None for a single sample.
        name: name of the period in the message.

    Raises:
        SamplingError: it is shorter; the message names the likely unit of the times.
    """
    if window is None or period is None or window.length >= period * (1.0 - SNAP):
        return
    unit = next((unit for unit, size in SMALLER_UNITS.items() if period * size <= window.length), None)
    remedy = f"if the times are in {unit}, give --time-unit {unit}; " if unit else ""
    span = window.interval.span
    raise SamplingError(
        f"`{' '.join(span.text.split())}` ({span.place}) is {window.length:g} s long, shorter than "
        f"{name}, {period:.6g} s; {remedy}interpolation='hold' or 'linear' evaluates between samples"
    )
