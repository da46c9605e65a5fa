"""Progress of a long command: its stages, and the part of each that is done."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import TYPE_CHECKING

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
from s2r_spec.cli.terminal.progress import ProgressView, duration_words

if TYPE_CHECKING:
    from s2r_spec.diagnose.data.cost import Cost, Expected

EVERY = 60.0
"""Budget: time [s] between two lines on the same stage without a terminal."""


class Stages(ProgressView):
    """Called with (stage, done, of): a live bar on a terminal, elsewhere one line for each stage and each minute.

    ``opening`` is printed before the first stage.
    """

    _screen: Progress

    def __init__(
        self, console: Console, quiet: bool, clock: Callable[[], float] = monotonic, opening: str = ""
    ) -> None:
        super().__init__(console, quiet, clock, opening)
        self._screen = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=quiet or not console.is_terminal,
        )
        self._task = self._screen.add_task("", total=None)
        self._stage, self._printed_at = "", 0.0

    def __call__(self, stage: str, done: int, of: int) -> None:
        """Show the progress of a stage: ``done`` of ``of``, or ``done`` rollouts if ``of`` is 0 (unknown)."""
        stage = one_line(stage)
        self._open()
        now = self._clock()
        lines = not self._console.is_terminal
        if stage != self._stage:
            self._stage, self._printed_at = stage, now
            self._screen.reset(self._task)
            if lines:
                self._say(f"{stage}: {of}" if of else stage)
        elif lines and now - self._printed_at >= EVERY:
            self._printed_at = now
            self._say(f"{stage}: {f'{done} of {of}' if of else f'{done} rollouts'} so far")
        self._screen.update(self._task, description=stage, completed=done, total=of or None)

    def expect(self, cost: Cost) -> None:
        """Print what the command will cost; that no test is held out is printed even with ``--quiet``."""
        self._open()
        real, simulated = cost.real, cost.simulated
        if real is not None:
            self._say(f"on {real.backend}: up to {_words(real)}")
        what = "every effect is simulated already"
        if simulated.rollouts:
            what = f"about {_words(simulated)} on one core, to simulate every effect"
        further = "" if cost.held_out is None else "; the estimate runs further ones"
        self._say(f"on {simulated.backend}: {what}{further}")
        if cost.held_out == 0:
            way = f"; a budget of {cost.enough} would hold some out" if cost.enough is not None else ""
            self._say(f"note: no test is held out, so no held-out gap will be measured{way}", always=True)


def _words(expected: Expected) -> str:
    return f"{expected.rollouts:,} rollouts, about {duration_words(expected.seconds)}"
