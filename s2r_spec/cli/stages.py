"""What a long command says while it runs: its stages, each with how much of it is done."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from s2r_spec.printable import one_line


class Stages:
    """Called with (stage, done, of); a live bar on a terminal, a line a stage elsewhere."""

    def __init__(self, console: Console, quiet: bool) -> None:
        self._quiet, self._console = quiet, console
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
        """Show how far a stage is."""
        stage = one_line(stage)
        if stage != self._stage:
            self._stage = stage
            self._progress.reset(self._task)
            if not self._quiet and not self._console.is_terminal:
                self._console.print(f"{stage}: {of}", markup=False, soft_wrap=True)
        self._progress.update(self._task, description=stage, completed=done, total=of)
