"""What a check says while it runs, on stderr: a live line on a terminal, one quiet line a batch elsewhere."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from s2r_spec.certify.certificate import Certificate
from s2r_spec.certify.outward import between, wide
from s2r_spec.certify.search import Query
from s2r_spec.rollouts.journal import Record


class Live:
    """Shows rollouts done, the interval against ε, where the search looks, and the last ρ."""

    def __init__(self, console: Console, quiet: bool, symbol: str = "ρ") -> None:
        self._quiet, self._symbol = quiet, symbol
        self._console = console
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.completed:.0f} rollouts"),
            BarColumn(20),
            TextColumn("{task.fields[interval]}"),
            TextColumn("{task.fields[where]}"),
            TextColumn("{task.fields[last]}"),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=quiet or not console.is_terminal,
        )
        self._task = self._progress.add_task("check", total=None, interval="", where="", last="")

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        self._progress.stop()

    def batch(self, queries: list[Query], certificate: Certificate) -> None:
        """Show the interval so far and where the search looks next."""
        interval = (
            f"{self._symbol} in {between(-certificate.upper, -certificate.lower)} "
            f"(ε {wide(certificate.epsilon)} > {certificate.target:g})"
        )
        where = "next " + "; ".join(
            ", ".join(f"{k} {v:.3g}" for k, v in query.point.items()) for query in queries
        )
        # The width of the interval falls about as one over the square root of the rollouts.
        likely = int(certificate.rollouts * (certificate.epsilon / certificate.target) ** 2)
        self._progress.update(self._task, total=likely or None, interval=interval, where=where)
        if not self._quiet and not self._console.is_terminal:
            self._console.print(
                f"{certificate.rollouts} rollouts, {interval}, {where}", markup=False, soft_wrap=True
            )

    def rollout(self, record: Record) -> None:
        """Count a rollout that is on disk."""
        self._progress.update(self._task, advance=1, last=f"last ρ {record.rho:+.4f}")
