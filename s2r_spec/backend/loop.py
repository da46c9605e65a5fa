"""The control loop of a backend whose files state it, and loops with a mistake that a machine may have instead."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

from s2r_spec.backend.capabilities import Finding
from s2r_spec.trace import Trace


@dataclass(frozen=True)
class LoopMistake:
    """A mistake of code around a controller.

    Attributes:
        quantity: a term of the observation, "target", or another quantity of the loop.
        words: what is wrong with it, to be read after the quantity.
        equation: the equation that holds instead.
        keys: keys of the backend's file that state the loop with the mistake; "" where none can.
    """

    quantity: str
    words: str
    equation: str
    keys: str = ""

    @property
    def name(self) -> str:
        """Quantity and words, as a sentence without its full stop."""
        return f"{self.quantity} {self.words}"


@dataclass(frozen=True)
class Replayed:
    """Which loop a log shows, by running loops on its recorded state.

    Attributes:
        mistakes: of the most probable loop; () for that of the files.
        probability: of this loop, among those that were tried.
        rivals: the next loops, each with its probability; of loops that do the same on these logs, the first.
        share: what the most probable loop leaves of the output, as a part of the output's rms.
        files: what the loop of the files leaves.
        output: the channel that was compared.
        explained: whether the most probable loop explains the output.
        channels: those that the controller's input and the output are made from.
    """

    mistakes: tuple[LoopMistake, ...]
    probability: float
    rivals: tuple[tuple[tuple[LoopMistake, ...], float], ...]
    share: float
    files: float
    output: str
    explained: bool
    channels: frozenset[str] = frozenset()


@runtime_checkable
class HasLoop(Protocol):
    """A backend whose files state its control loop: what a policy sees, and what becomes of its action."""

    def loop(self, trace: Trace) -> Iterator[Finding]:
        """Yield what a recorded trace says of each equation of the loop, tick by tick and without a simulation."""

    def replayed(self, traces: Sequence[Trace]) -> Replayed | None:
        """Return which loop recordings show, by its policy on their state; None where they have too little for it."""

    def as_logged(self, traces: Sequence[Trace]) -> Self:
        """Return this backend with channels of the instants that recordings have, where conventions differ."""

    def mistakes(self) -> Mapping[LoopMistake, Self]:
        """Return the mistakes that the files make possible, and for each this backend with that loop."""

    def with_mistakes(self, mistakes: Sequence[LoopMistake]) -> Self:
        """Return this backend with the loop of the last of these mistakes, whose keys have those before it."""
