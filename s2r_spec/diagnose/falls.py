"""Why real rollouts ended early: which effects alone end the simulator early at these tests, and not at others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.simulate import Bench, Job, Test, evenly, places_of, run_jobs
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.trace import Trace

ASKED = 3
"""Budget: tests at which real rollouts ended early that are asked about, at most; of those at which they did not, twice
as many. Doubled, fewer effects are suspected, at twice the time."""
SPARED = 1 / 3
"""Level: part of the latter at which an effect may end the simulator early, too. Doubled, more effects count."""
HALVINGS = 6
"""Budget: halvings of the way from nominal to the end of a range, to find the least of an effect that does it. Doubled,
the least is known 64 times as finely."""
SHOWN = 3
"""Definition: effects that a sentence names; it counts the others. Doubled, sentences get longer."""


@dataclass(frozen=True)
class Culprit:
    """An effect that may be why.

    Attributes:
        line: its parameter.
        coordinate: the least of it that ends the simulator early at all tests that were asked about.
        others: at how many of the other tests it does, too.
    """

    line: Line
    coordinate: float
    others: int

    def __str__(self) -> str:
        unit = f" {self.line.unit}" if self.line.unit else ""
        return f"{self.line.name} beyond {self.line.value(self.coordinate):.3g}{unit}"


@dataclass(frozen=True)
class Falls:
    """What the simulator does at tests at which real rollouts ended early.

    Attributes:
        nominal: whether it ends early there without any effect.
        culprits: effects, the least unusual first.
        others: at how many other tests these were tried.
    """

    nominal: bool
    culprits: tuple[Culprit, ...] = ()
    others: int = 0

    def __str__(self) -> str:
        if self.nominal:
            return "The simulator ends early at these tests, too"
        if not self.culprits:
            return (
                "No single effect of the catalogue ends the simulator early at these tests and not at others"
            )
        shown = self.culprits[:SHOWN]
        more = len(self.culprits) - len(shown)
        names = " or ".join(map(str, shown)) + (f" (or {more} more)" if more else "")
        few = max(each.others for each in shown)
        return (
            f"Alone, {names} ends the simulator early at these tests, and at "
            f"{f'at most {few}' if few else 'none'} of {self.others} other tests"
        )


def falls(
    bench: Bench,
    lines: Sequence[Line],
    rollouts: Sequence[tuple[Test, Trace]],
    seed: int,
    executor: Callable[[], Executor] | None = None,
) -> Falls | None:
    """Ask every effect of the catalogue; None where no real rollout ended early, or all did.

    The least of an effect that ends the simulator early at all of these tests is looked for, for it does so at the
    fewest others. That more of an effect ends what less of it ends is taken for granted.

    Args:
        bench: the simulator.
        lines: parameters of its effects.
        rollouts: (test, trace) of each real one.
        seed: of the simulator's rollouts.
        executor: makes a pool; None runs all here.
    """
    early, stood = _outcomes(rollouts)
    if not early or not stood:
        return None
    early, stood = (
        [of[n] for n in evenly(len(of), most)] for of, most in ((early, ASKED), (stood, 2 * ASKED))
    )

    def ended(tried: Sequence[tuple[Line, float]], tests: Sequence[Test]) -> NDArray[np.intp]:
        """Return at how many of the tests the simulator ends early, with each of these alone."""
        jobs = [Job(line.at(line.value(x)), _runs(tests, seed)) for line, x in tried]
        rows = run_jobs(bench, jobs, executor, read=_ended)
        return np.array([int(each.sum()) for each in rows], dtype=np.intp)

    if run_jobs(bench, [Job({}, _runs(early, seed))], executor, read=_ended)[0].all():
        return Falls(True)
    # An end that is nominal is no effect.
    ends = [(line, line.coordinate(end)) for line in lines if not line.base for end in (line.low, line.high)]
    asked = sorted(((line, x) for line, x in ends if x), key=lambda one: abs(one[1]))
    enough = [one for one, count in zip(asked, ended(asked, early), strict=True) if count == len(early)]
    low, high = np.zeros(len(enough)), np.array([x for _, x in enough])
    for _ in range(HALVINGS if enough else 0):
        middle = 0.5 * (low + high)
        found = ended([(line, x) for (line, _), x in zip(enough, middle.tolist(), strict=True)], early)
        low, high = np.where(found < len(early), middle, low), np.where(found < len(early), high, middle)
    least = [(line, x) for (line, _), x in zip(enough, high.tolist(), strict=True)]
    culprits = [
        Culprit(line, x, int(count))
        for (line, x), count in zip(least, ended(least, stood), strict=True)
        if count <= SPARED * len(stood)
    ]
    return Falls(False, tuple(sorted(culprits, key=lambda each: abs(each.coordinate))), len(stood))


def falls_alone(
    bench: Bench,
    rollouts: Sequence[tuple[Test, Trace]],
    seed: int,
    executor: Callable[[], Executor] | None = None,
) -> list[Test]:
    """Return the tests at which the simulator, with nothing added, ends early, and no real rollout does."""
    stood = _outcomes(rollouts)[1]
    jobs = [Job({}, (run,)) for run in _runs(stood, seed)]
    ended = run_jobs(bench, jobs, executor, read=_ended)
    return [test for test, rows in zip(stood, ended, strict=True) if rows.any()]


def always_early(rollouts: Sequence[tuple[Test, Trace]]) -> int:
    """Return how many tests there are that were run again and ended early every time."""
    places = places_of([test for test, _ in rollouts]).values()
    return sum(len(own) > 1 and all(rollouts[n][1].failure is not None for n in own) for own in places)


def _ended(bench: Bench, trace: Trace, test: Test) -> NDArray[np.float64]:
    return np.array([float(trace.failure is not None)])


def _outcomes(rollouts: Sequence[tuple[Test, Trace]]) -> tuple[list[Test], list[Test]]:
    """Return the different tests at which some rollout ended early, and those at which none did."""
    early: list[Test] = []
    stood: list[Test] = []
    for key, own in places_of([test for test, _ in rollouts]).items():
        fell = any(rollouts[n][1].failure is not None for n in own)
        (early if fell else stood).append(dict(key))
    return early, stood


def _runs(tests: Sequence[Test], seed: int) -> tuple[tuple[Test, int], ...]:
    return tuple((test, rollout_seed(seed, n, 0, Stream.CHECK)) for n, test in enumerate(tests))
