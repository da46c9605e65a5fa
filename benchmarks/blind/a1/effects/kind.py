"""What an effect of the generator is: how much of it there can be, in which numbers, and what it does to a twin."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from numpy.random import Generator

from benchmarks.blind.a1.twin import Twin

Values = Mapping[str, float]


@dataclass(frozen=True)
class Kind:
    """One effect.

    Attributes:
        name: the catalogue's where the catalogue has it.
        low, high: sizes from just material to large, in the effect's own measure.
        values: from random numbers and a size to the label's parameters, in the catalogue's units and meanings.
        apply: does these values to a twin; the random numbers are for what differs from robot to robot.
        relative_of: the effect of the catalogue that it resembles, if it is not in there.
        window: [s] in which it acts, from its values; None: all the time.
    """

    name: str
    low: float
    high: float
    values: Callable[[Generator, float], dict[str, float]]
    apply: Callable[[Twin, Generator, Values], None]
    relative_of: str | None = None
    window: Callable[[Values], tuple[float, float]] | None = None


def sign(rng: Generator, positive: float = 0.5) -> float:
    """Return 1 with this probability, else -1."""
    return 1.0 if rng.uniform() < positive else -1.0
