"""Progress of a search on stderr: a live view on a terminal, elsewhere one line for each batch."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import Self

from rich.console import Console, RenderableType
from rich.live import Live as Screen
from rich.progress import Progress
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from s2r_spec.base.printable import one_line
from s2r_spec.certify.bound.certificate import Certificate
from s2r_spec.certify.bound.rounding import interval_text, width_text
from s2r_spec.certify.search.observers import Observer, Phase
from s2r_spec.certify.search.search import Query
from s2r_spec.cli.terminal.remaining import Pace, RolloutForecast
from s2r_spec.runs.journal import Record

_LAST = 24
_BLOCKS = "▁▂▃▄▅▆▇█"


@dataclass
class SearchProgress:
    """Progress of a search.

    Attributes:
        phase: the search that runs; None before the first one.
        queries: the tests of the batch that runs.
        rollouts: number of rollouts on disk, including the rollouts of an earlier process.
        here: number of them that this process ran.
        since: time at which this process began its first one [s].
        forecast: what was known of the end before the search; None without settings.
        tests: number and sum of ρ of the rollouts at each test.
    """

    phase: Phase | None = None
    certificate: Certificate | None = None
    queries: Sequence[Query] = ()
    rollouts: int = 0
    here: int = 0
    since: float = 0.0
    pace: Pace = field(default_factory=Pace)
    forecast: RolloutForecast | None = None
    tests: dict[tuple[float, ...], tuple[int, float]] = field(default_factory=dict)
    last: deque[float] = field(default_factory=lambda: deque(maxlen=_LAST))

    @property
    def units(self) -> Mapping[str, str]:
        """Test parameter → unit."""
        return self.phase.units if self.phase is not None else {}

    @property
    def worst(self) -> float | None:
        """The lowest mean ρ at a test with at least two rollouts; None before there is one."""
        return min((total / count for count, total in self.tests.values() if count > 1), default=None)

    def left(self) -> int | None:
        """Return an estimate of the rollouts that are left; None before there is one."""
        if self.phase is None:
            return None
        total: float | None = self.phase.budget
        if self.forecast is not None:
            total = self.forecast.total(self.certificate, self.worst)
        if total is None:
            return None
        # The batch that runs is finished in any case.
        done = self.certificate.rollouts if self.certificate is not None else 0
        running = done + sum(query.replicates for query in self.queries)
        return max(0, math.ceil(max(total, running)) - self.rollouts)

    def seconds_left(self) -> float | None:
        """Return an estimate of the time left [s], at the pace of this process; None if there is none."""
        left = self.left()
        if left is None or self.forecast is None:
            return None
        return self.pace.seconds(left, self.forecast.batches(self.rollouts, self.rollouts + left) - 1)


class ProgressView:
    """A live screen on a terminal, elsewhere lines; ``opening`` is printed before the first of them."""

    _screen: Screen | Progress | None = None

    def __init__(
        self, console: Console, quiet: bool, clock: Callable[[], float] = monotonic, opening: str = ""
    ) -> None:
        self._console, self._quiet, self._clock, self._opening = console, quiet, clock, opening

    def __enter__(self) -> Self:
        if self._screen is not None:
            self._screen.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._screen is not None:
            self._screen.stop()

    def _open(self) -> None:
        """Print the opening, once."""
        if self._opening:
            self._say(self._opening)
        self._opening = ""

    def _say(self, sentence: str, always: bool = False) -> None:
        if always or not self._quiet:
            self._console.print(one_line(sentence), markup=False, soft_wrap=True)


class Live(ProgressView, Observer):
    """Shows the rollouts done and left, the interval and its target width, the next tests, and the last ρ.

    ``opening`` is printed when the first search begins, after all errors of its settings.
    """

    def __init__(
        self, console: Console, quiet: bool, clock: Callable[[], float] = monotonic, opening: str = ""
    ) -> None:
        super().__init__(console, quiet, clock, opening)
        self._state = SearchProgress(since=clock())
        if console.is_terminal and not quiet:
            self._screen = Screen(
                console=console, get_renderable=self.view, transient=True, refresh_per_second=4
            )

    def begin(self, phase: Phase) -> None:
        """Begin another search. If it has an operator, the screen is left to the operator's dialogue."""
        self._state = SearchProgress(phase=phase, since=self._clock(), pace=Pace(paired=phase.symbol == "Δ"))
        self._open()
        if phase.settings is not None and not self._quiet:
            self._state.forecast = RolloutForecast.of(phase.settings)
            self._state.since = self._clock()
        if phase.attended and self._screen is not None:
            self._screen.stop()
            self._screen = None

    def batch(self, queries: list[Query], certificate: Certificate) -> None:
        """Show the interval so far and the next tests."""
        self._state.certificate, self._state.queries = certificate, queries
        self._state.pace.batch(self._clock())
        if self._screen is None and not self._quiet:
            done, upcoming = f"{certificate.rollouts} rollouts", f"next {_next(self._state)}"
            self._say(", ".join([done, _interval(self._state), upcoming, *_left_words(self._state)]))

    def rollout(self, record: Record, new: bool = True) -> None:
        """Count a rollout that is on disk."""
        state = self._state
        state.rollouts += 1
        state.here += new
        if new:
            state.pace.rollout(self._clock())
        if not state.here:
            state.since = self._clock()
        count, total = state.tests.get(key := tuple(record.params.values()), (0, 0.0))
        state.tests[key] = count + 1, total + record.rho
        state.last.append(record.rho)
        if new and state.phase is not None and state.phase.attended:
            failure = "" if record.failure is None else f" ({record.failure})"
            self._say(f"{self._rollout_words(record)}: ρ = {record.rho:+.4f}{failure}")

    def crash(self, record: Record) -> None:
        """Report immediately that a rollout ended without a trace."""
        counts = f"it counts as ρ = {record.rho:g}, as the spec declares"
        self._say(f"{self._rollout_words(record)}: {record.failure}; {counts}")

    def _rollout_words(self, record: Record) -> str:
        test = _test(record.params, self._state.units)
        return f"rollout {record.query}.{record.replicate} at {test}"

    def view(self) -> RenderableType:
        """Return the live view of the present state."""
        state, now = self._state, self._clock()
        table = Table.grid(padding=(0, 2))
        table.add_column(style="dim", no_wrap=True)
        table.add_column(overflow="fold")
        if state.phase is None:
            table.add_row("starting", "")
            return table
        left = state.left()
        total = None if left is None else state.rollouts + left
        bar = ProgressBar(total=total, completed=state.rollouts, width=24, pulse=total is None)
        progress = Table.grid(padding=(0, 2))
        progress.add_row(
            bar,
            Text(one_line(f"{state.rollouts} of {state.phase.backend}")),
            *_left_words(state),
            f"{now - state.since:.0f} s so far",
        )
        table.add_row("rollouts", progress)
        if state.certificate is not None:
            table.add_row("interval", Text(one_line(_interval(state))))
            table.add_row("next", Text(one_line(_next(state))))
        if state.last:
            lowest = f"lowest of the last {len(state.last)} {min(state.last):+.4f}"
            words = f"{_spark(state.last)}  {state.last[-1]:+.4f}, {lowest}"
            table.add_row("last ρ", Text(words))
        return table


def _interval(state: SearchProgress) -> str:
    certificate, phase = state.certificate, state.phase
    assert certificate is not None
    symbol, unit = (phase.symbol, f" {phase.unit}" if phase.unit else "") if phase is not None else ("ρ", "")
    return (
        f"{symbol} in {interval_text(-certificate.upper, -certificate.lower)}{unit} "
        f"({width_text(certificate.epsilon)} wide, target {certificate.target:g})"
    )


def _next(state: SearchProgress) -> str:
    return "; ".join(f"{_test(query.point, state.units)} ({query.replicates}×)" for query in state.queries)


def _left_words(state: SearchProgress) -> list[str]:
    left, seconds = state.left(), state.seconds_left()
    took = "" if seconds is None else f" ({duration_words(seconds)})"
    return [] if left is None else [f"about {left} rollouts left{took}"]


def duration_words(seconds: float) -> str:
    """Return a time [s] as people read it."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 100 * 60 else f"{seconds / 3600:.1f} h"


def _test(params: Mapping[str, float], units: Mapping[str, str]) -> str:
    return ", ".join(f"{name} = {value:.3g} {units.get(name, '')}".rstrip() for name, value in params.items())


def _spark(values: Sequence[float]) -> str:
    """Return one block for each value, its height relative to the least and the greatest."""
    low, high = min(values), max(values)
    steps = len(_BLOCKS) - 1
    return "".join(_BLOCKS[round(steps * (value - low) / ((high - low) or 1.0))] for value in values)
