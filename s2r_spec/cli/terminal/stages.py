"""Progress of a long command: its stages, and the part of each that is done."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from s2r_spec.base.printable import one_line
from s2r_spec.cli.terminal.progress import duration_words

if TYPE_CHECKING:
    from s2r_spec.diagnose.data.cost import Cost, Expected

EVERY = 60.0
"""Budget: time [s] between two lines on the same stage without a terminal."""


class Stages:
    """Called with (stage, done, of): a live bar on a terminal, elsewhere one line for each stage and each minute.

    ``opening`` is printed before the first stage.
    """

    def __init__(
        self, console: Console, quiet: bool, clock: Callable[[], float] = monotonic, opening: str = ""
    ) -> None:
        self._opening = opening
        self._quiet, self._console, self._clock, self._printed_at = quiet, console, clock, 0.0
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=quiet or not console.is_terminal,
        )
        self._task = self._progress.add_task("", total=None)
        self._stage = ""

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        self._progress.stop()

    def __call__(self, stage: str, done: int, of: int) -> None:
        """Show the progress of a stage: ``done`` of ``of``, or ``done`` rollouts if ``of`` is 0 (unknown)."""
        stage = one_line(stage)
        self._open()
        now = self._clock()
        lines = not self._quiet and not self._console.is_terminal
        if stage != self._stage:
            self._stage, self._printed_at = stage, now
            self._progress.reset(self._task)
            if lines:
                self._console.print(f"{stage}: {of}" if of else stage, markup=False, soft_wrap=True)
        elif lines and now - self._printed_at >= EVERY:
            self._printed_at = now
            words = f"{done} of {of}" if of else f"{done} rollouts"
            self._console.print(f"{stage}: {words} so far", markup=False, soft_wrap=True)
        self._progress.update(self._task, description=stage, completed=done, total=of or None)

    def expect(self, cost: Cost) -> None:
        """Print what the command will cost; that no test is held out is printed even with ``--quiet``."""
        self._open()
        if not self._quiet:
            real, simulated = cost.real, cost.simulated
            if real is not None:
                self._say(f"on {real.backend}: up to {_words(real)}")
            more = "the estimate runs further ones"
            kept = f"on {simulated.backend}: every effect is simulated already; {more}"
            self._say(
                f"on {simulated.backend}: about {_words(simulated)} on one core, to simulate every effect; {more}"
                if simulated.rollouts
                else kept
            )
        if not cost.held_out:
            way = f"; a budget of {cost.enough} would hold some out" if cost.enough is not None else ""
            self._say(f"note: no test is held out, so no held-out gap will be measured{way}")

    def _open(self) -> None:
        """Print the opening, once."""
        if self._opening and not self._quiet:
            self._say(self._opening)
        self._opening = ""

    def _say(self, sentence: str) -> None:
        self._console.print(one_line(sentence), markup=False, soft_wrap=True)


def _words(expected: Expected) -> str:
    return f"{expected.rollouts:,} rollouts, about {duration_words(expected.seconds)}"
