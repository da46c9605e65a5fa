"""Recordings that stand under another test than they were run at: the simulator's mean moves to that test.

The simulator is run at the tests of the row before and after, at those with one parameter's other sign, and with two
parameters of one unit exchanged. Where the comparison has the mean at such a test, it is not run again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.comparison import SEEDS, Comparison, affordable
from s2r_spec.diagnose.quality.faults import ChannelGroup, Fault, Undone, search
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.simulator.bench import Bench, Test, TestRun
from s2r_spec.space import key_of

Which = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Other:
    """Other tests of the n recordings, one each, and what is said of some of them; {count} of them, from {first} on."""

    tests: Sequence[Test]
    text: str
    imitates: str
    known: Which
    """(n,) whether there is such a test; the row after the last one is in no table."""


def labels(bench: Bench, c: Comparison, rollouts: Sequence[TestRun]) -> list[Fault]:
    """Run the simulator at other tests, and return what explains most of each kind of wrong label."""
    others = [one for one in _other_tests(bench, c, rollouts) if is_able(bench, one.tests)]
    means = {key_of(test): mean for test, mean in zip(c.tests, c.nominal, strict=True)}
    tests = {key_of(test): test for one in others for test in one.tests if key_of(test) not in means}
    faults = list(_assignment(c))
    if tests:
        seeds = affordable(bench, len(tests), SEEDS // 6, SEEDS)
        runs = c.view.simulate(bench, [({}, seed) for seed in range(seeds)], list(tests.values()))
        means |= dict(zip(tests, runs.mean(axis=0), strict=True))
    for one in others:
        moved = c.nominal - np.array([means[key_of(test)] for test in one.tests])
        if not np.isfinite(moved).all():
            continue
        # Those recordings that leave least so are of other tests.
        there, numbers = one.known.astype(float)[:, None, None], np.arange(len(moved))
        names = [str(k) for k in np.flatnonzero(one.known)]
        each = [moved / c.floor * (numbers == int(name))[:, None, None] for name in names]
        for undone in search(c, names, [1.0], (np.array([c.rest(c.recorded), *each]), there)):
            which = np.isin(numbers.astype(str), list(undone.group))
            text = one.text.format(count=len(undone.group), first=_first(c, which))
            faults.append((Finding("labels", "the tests", text, one.imitates), undone))
    return faults


def _other_tests(bench: Bench, c: Comparison, rollouts: Sequence[TestRun]) -> Iterable[_Other]:
    rows, n = [test for test, _ in rollouts], len(c.traces)
    places = [next(k for k, (_, trace) in enumerate(rollouts) if trace is mine) for mine in c.traces]
    for step, words, end in ((1, "the next one", len(rows) - 1), (-1, "the one before", 0)):
        text = (
            f"{{count}} of {n} compared recordings fit the test of {words} better than their own{{first}}. Is a line "
            f"of the table of tests doubled or missing?"
        )
        tests: list[Test] = [rows[place if place == end else place + step] for place in places]
        known = np.array([place != end for place in places])
        yield _Other(tests, text, "a shifted table of tests", known)
    every = np.ones(n, dtype=bool)
    for name in bench.spec.space.names:
        text = (
            f"the real rollouts fit tests with the opposite sign of {name} better than their own{{first}}. Has {name} "
            f"the same sign convention in the table of tests?"
        )
        if any(test[name] for test in c.tests):
            tests = [{**test, name: -test[name] or 0.0} for test in c.tests]
            yield _Other(tests, text, f"the opposite sign of {name}", every)
    units = bench.spec.space.units
    for a, b in combinations(sorted(bench.spec.space.names), 2):
        text = (
            f"the real rollouts fit tests with {a} and {b} exchanged better than their own{{first}}. If they are "
            f"exchanged, correct the table of tests"
        )
        if units.get(a) == units.get(b):
            tests = [{**test, a: test[b], b: test[a]} for test in c.tests]
            yield _Other(tests, text, f"{a} and {b} exchanged", every)


def is_able(bench: Bench, tests: Sequence[Mapping[str, float]]) -> bool:
    """Return whether the simulator can run these tests of the specification."""
    ranges = {parameter.name: parameter for parameter in bench.backend.parameters}
    return all(
        name not in ranges or ranges[name].low <= value <= ranges[name].high
        for test in tests
        for name, value in bench.matched.to_backend(test).items()
    )


def _assignment(c: Comparison) -> Iterable[Fault]:
    from scipy.optimize import linear_sum_assignment

    apart = (c.recorded[:, None] - c.nominal[None]) / c.floor
    _, order = linear_sum_assignment((apart**2).mean(axis=(2, 3)))
    moved = order != np.arange(len(order))
    if moved.any():
        text = (
            f"{int(moved.sum())} of {len(order)} compared recordings fit the test of another recording better than "
            f"their own{_first(c, moved)}. Are lines of the table of tests exchanged?"
        )
        finding = Finding("labels", "the tests", text, "an exchange of tests")
        yield finding, Undone(1.0, ChannelGroup(), c.recorded - c.nominal[order] + c.nominal)


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
