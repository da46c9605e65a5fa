"""Recordings that stand under another test than they were run at: undone by comparing with the simulator there.

Each comparison has the nominal rollouts at its tests. At the tests of the row before and after, at those with one
parameter's other sign, and with two parameters of one unit exchanged, the simulator is run a few times more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.comparison import Comparison, scatter_of
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.recordings import Rollout
from s2r_spec.diagnose.quality.suspects import Suspect
from s2r_spec.diagnose.simulate import Bench, Test
from s2r_spec.space import key_of

FloatArray = NDArray[np.float64]
Which = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Other:
    """Other tests of the same recordings.

    Attributes:
        tests: one a recording.
        text: what is said of them; {count} are of these, and {first} is the word on the first sample.
        imitates: see :class:`Finding`.
        known: (n,) whether there is such a test; the row after the last one is in no table.
        parts: which of the recordings, (n,) each, may be of these tests.
    """

    tests: Sequence[Test]
    text: str
    imitates: str
    known: Which
    parts: Sequence[Which]


def labels(
    bench: Bench,
    c: Comparison,
    rollouts: Sequence[Rollout],
    executor: Callable[[], Executor] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Suspect]:
    """Run the simulator at other tests, and return what explains most of each kind of wrong label."""
    others = [one for one in _others(bench, c, rollouts) if _able(bench, one.tests)]
    tests = {key_of(test): test for one in others for test in one.tests}
    if not tests:
        return _assigned(c)
    seeds = c.affordable(len(tests))
    runs = c.simulated(bench, {}, list(tests.values()), seeds, executor, progress)
    of_test, found = dict(zip(tests, runs, strict=True)), []
    for one in others:
        there = np.stack([of_test[key_of(test)] for test in one.tests])
        if not np.isfinite(there).all():
            continue
        mean = there.mean(axis=1)
        scatter = scatter_of((there - mean[:, None]) / c.floor)
        options = [_of_part(c, one, part, mean, scatter) for part in one.parts]
        found.append(min(options, key=lambda option: option[0])[1])
    return [*found, *_assigned(c)]


def _others(bench: Bench, c: Comparison, rollouts: Sequence[Rollout]) -> list[_Other]:
    """Return the tests that the recordings may have been run at."""
    rows, n = [test for test, _ in rollouts], len(c.traces)
    places = [next(k for k, (_, trace) in enumerate(rollouts) if trace is mine) for mine in c.traces]
    every = np.ones(n, dtype=bool)
    # From some row on, or up to some row, or all of them.
    parts = [np.arange(n) >= k for k in range(n)] + [np.arange(n) <= k for k in range(n - 1)]
    found = []
    for step, words, end in ((1, "the next one", len(rows) - 1), (-1, "the one before", 0)):
        text = (
            f"{{count}} of {n} compared recordings fit the test of {words} better than their own{{first}}. Is a line "
            f"of the table of tests doubled or missing?"
        )
        tests = [rows[place if place == end else place + step] for place in places]
        known = np.array([place != end for place in places])
        found.append(_Other(tests, text, "a shifted table of tests", known, parts))
    for name in bench.spec.space.names:
        text = (
            f"the real rollouts fit tests with the opposite sign of {name} better than their own{{first}}. Has {name} "
            f"the same sign convention in the table of tests?"
        )
        tests = [{**test, name: -test[name] or 0.0} for test in c.tests]
        if any(test[name] for test in c.tests):
            found.append(_Other(tests, text, f"the opposite sign of {name}", every, [every]))
    units = bench.spec.space.units
    for a, b in combinations(sorted(bench.spec.space.names), 2):
        text = (
            f"the real rollouts fit tests with {a} and {b} exchanged better than their own{{first}}. If they are "
            f"exchanged, correct the table of tests"
        )
        tests = [{**test, a: test[b], b: test[a]} for test in c.tests]
        if units.get(a) == units.get(b):
            found.append(_Other(tests, text, f"{a} and {b} exchanged", every, [every]))
    return found


def _able(bench: Bench, tests: Sequence[Mapping[str, float]]) -> bool:
    """Return whether the backend can run all of these tests."""
    ranges = {parameter.name: parameter for parameter in bench.backend.parameters}
    return all(
        name not in ranges or ranges[name].low <= value <= ranges[name].high
        for test in tests
        for name, value in bench.matched.to_backend(test).items()
    )


def _of_part(
    c: Comparison, one: _Other, part: Which, mean: FloatArray, scatter: FloatArray
) -> tuple[float, Suspect]:
    """Return by how much ℓ is larger where a part of the recordings is of other tests, and the suspect of that."""
    there = c.elsewhere(mean, scatter, part)
    counts = (one.known | ~part).astype(float)[:, None, None]
    gain = there.misfit(c.recorded, there=counts) - c.misfit(c.recorded, there=counts) + there.volume
    text = one.text.format(count=int((part & one.known).sum()), first=_first(c, part))
    return gain, _suspect(c, there, text, one.imitates, counts)


def _assigned(c: Comparison) -> list[Suspect]:
    """Return the assignment of recordings to the tests that were compared, if it is not the identity."""
    from scipy.optimize import linear_sum_assignment

    apart = (c.recorded[:, None] - c.nominal[None]) / c.floor
    _, order = linear_sum_assignment((apart**2).mean(axis=(2, 3)))
    moved = order != np.arange(len(order))
    if not moved.any():
        return []
    text = (
        f"{int(moved.sum())} of {len(order)} compared recordings fit the test of another recording better than their "
        f"own{_first(c, moved)}. Are lines of the table of tests exchanged?"
    )
    there = c.elsewhere(c.nominal[order], c.scatter[order], moved)
    return [_suspect(c, there, text, "an exchange of tests")]


def _suspect(
    c: Comparison, there: Comparison, text: str, imitates: str, counts: FloatArray | float = 1.0
) -> Suspect:
    """Return the suspect that the recordings are of the tests of another comparison."""
    said = Finding("labels", "the tests", text, imitates)
    return Suspect(said, c.recorded, there, counts, there.volume - c.volume)


def _first(c: Comparison, which: Which) -> str:
    """Return by how much a channel of some recordings is off in the first sample, where one is, in words."""
    first = np.abs(c.recorded - c.nominal)[which, 0]
    far = (first / c.floor).max(axis=0)
    k = int(far.argmax())
    if far[k] < 3.0:
        return ""
    column = c.columns[k]
    much = f"{float(first[:, k].max()):.2g} {column.unit}".rstrip()
    return f" (the first sample of {column.name} is off by up to {much})"
