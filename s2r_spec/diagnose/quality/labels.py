"""Recordings that stand under another test than they were run at: undone by comparing with the simulator there.

Each comparison has the nominal rollouts at its tests. At the tests of the row before and after, at those with one
parameter's other sign, and with two parameters of one unit exchanged, the simulator is run a few times more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.quality.comparison import (
    BUDGET,
    FEWEST,
    SEEDS,
    Comparison,
    Rollout,
    sampled,
    scatter_of,
)
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.quality.suspects import Suspect
from s2r_spec.diagnose.simulate import Bench, Job, Test, run_jobs
from s2r_spec.space import key_of

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Other:
    """Other tests of the same recordings.

    Attributes:
        kind: "row", "sign" or "exchange".
        words: what the mistake would be.
        nominal: (n, T, c) of the simulator there.
        scatter: (n, s, T · c) of one rollout there; see :class:`Comparison`.
        known: (n,) whether there is such a test; the row after the last one is in no table.
    """

    kind: str
    words: str
    nominal: FloatArray
    scatter: FloatArray
    known: NDArray[np.bool_]


def others(
    bench: Bench,
    c: Comparison,
    rollouts: Sequence[Rollout],
    executor: Callable[[], Executor] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Other]:
    """Run the simulator at the tests that the recordings may have been run at."""
    rows = [test for test, _ in rollouts]
    places = [next(k for k, (_, trace) in enumerate(rollouts) if trace is mine) for mine in c.traces]
    wanted: list[tuple[str, str, list[Test]]] = []
    for step, words in ((1, "the next one"), (-1, "the one before")):
        wanted.append(("row", words, [rows[min(max(k + step, 0), len(rows) - 1)] for k in places]))
    for name in bench.spec.space.names:
        mirrored: list[Test] = [{**test, name: -test[name] or 0.0} for test in c.tests]
        if any(test[name] for test in c.tests):
            wanted.append(("sign", name, mirrored))
    units = bench.spec.space.units
    for a, b in permutations(bench.spec.space.names, 2):
        if a < b and units.get(a) == units.get(b):
            wanted.append(
                ("exchange", f"{a} and {b}", [{**test, a: test[b], b: test[a]} for test in c.tests])
            )
    wanted = [(kind, words, tests) for kind, words, tests in wanted if _able(bench, tests)]
    keys = {key_of(test): test for _, _, tests in wanted for test in tests}
    if not keys:
        return []
    seeds = int(np.clip(BUDGET / (c.cost * len(keys)), FEWEST, SEEDS))
    jobs = [Job({}, tuple((test, seed) for seed in range(seeds))) for test in keys.values()]
    read = partial(sampled, c.columns, c.times)
    ran = run_jobs(bench, jobs, executor, progress, read)
    shape = (seeds, len(c.times), len(c.columns))
    found = {key: values.reshape(shape) for key, values in zip(keys, ran, strict=True)}
    out = []
    for kind, words, tests in wanted:
        rollouts_there = np.stack([found[key_of(test)] for test in tests])
        if np.isfinite(rollouts_there).all():
            mean = rollouts_there.mean(axis=1)
            scatter = scatter_of((rollouts_there - mean[:, None]) / c.floor)
            known = np.ones(len(tests), dtype=bool)
            if kind == "row":
                end = 0 if words == "the one before" else len(rows) - 1
                known = np.array([place != end for place in places])
            out.append(Other(kind, words, mean, scatter, known))
    return out


def _able(bench: Bench, tests: Sequence[Mapping[str, float]]) -> bool:
    """Return whether the backend can run all of these tests."""
    ranges = {parameter.name: parameter for parameter in bench.backend.parameters}
    return all(
        name not in ranges or ranges[name].low <= value <= ranges[name].high
        for test in tests
        for name, value in bench.matched.to_backend(test).items()
    )


def labels(c: Comparison, other: Sequence[Other]) -> list[Suspect]:
    """Return what explains most of each kind of wrong label."""
    found = []
    n = len(c.traces)
    for one in other:
        whole = c.elsewhere(one.nominal, one.scatter, np.ones(n, dtype=bool))
        if one.kind == "row":
            # From some row on, or up to some row, or all of them.
            parts = [np.arange(n) >= k for k in range(n)] + [np.arange(n) <= k for k in range(n - 1)]
            options = [c.elsewhere(one.nominal, one.scatter, part) for part in parts]
            counts = [(one.known | ~part).astype(float)[:, None, None] for part in parts]
            k = min(range(len(options)), key=lambda k: _gain(c, options[k], counts[k]))
            count = int((parts[k] & one.known).sum())
            text = (
                f"{count} of {n} compared recordings fit the test of {one.words} better than their own"
                f"{begins(c, parts[k])}. Is a line of the table of tests doubled or missing?"
            )
            found.append(_suspect(c, options[k], text, "a shifted table of tests", counts[k]))
        elif one.kind == "sign":
            text = (
                f"the real rollouts fit tests with the opposite sign of {one.words} better than their own"
                f"{begins(c)}. Has {one.words} the same sign convention in the table of tests?"
            )
            found.append(_suspect(c, whole, text, f"the opposite sign of {one.words}"))
        else:
            text = (
                f"the real rollouts fit tests with {one.words} exchanged better than their own{begins(c)}. If they are "
                f"exchanged, correct the table of tests"
            )
            found.append(_suspect(c, whole, text, f"{one.words} exchanged"))
    return [*found, *_assigned(c)]


def _assigned(c: Comparison) -> list[Suspect]:
    """Return the assignment of recordings to the tests that were compared, if it is not the identity."""
    from scipy.optimize import linear_sum_assignment

    apart = (c.recorded[:, None] - c.nominal[None]) / c.floor
    costs = (apart**2).mean(axis=(2, 3))
    _, order = linear_sum_assignment(costs)
    moved = order != np.arange(len(order))
    if not moved.any():
        return []
    count = int(moved.sum())
    text = (
        f"{count} of {len(order)} compared recordings fit the test of another recording better than their own"
        f"{begins(c, moved)}. Are lines of the table of tests exchanged?"
    )
    there = c.elsewhere(c.nominal[order], c.scatter[order], moved)
    return [_suspect(c, there, text, "an exchange of tests")]


def _gain(c: Comparison, there: Comparison, counts: FloatArray) -> float:
    """Return by how much ℓ is larger with other tests; the recordings count by (n, 1, 1)."""
    return there.misfit(c.recorded, there=counts) - c.misfit(c.recorded, there=counts) + there.volume


def _suspect(
    c: Comparison, there: Comparison, text: str, imitates: str, counts: FloatArray | float = 1.0
) -> Suspect:
    """Return the suspect that the recordings are of the tests of another comparison."""
    said = Finding("labels", "the tests", text, imitates)
    return Suspect(said, c.recorded, there, counts, there.volume - c.volume)


def begins(c: Comparison, which: NDArray[np.bool_] | None = None) -> str:
    """Return by how much a channel is off in the first sample, where one is, in words."""
    first = np.abs(c.recorded - c.nominal)[:, 0]
    if which is not None:
        first = first[which]
    far = (first / c.floor).max(axis=0)
    k = int(far.argmax())
    if far[k] < 3.0:
        return ""
    column = c.columns[k]
    much = f"{float(first[:, k].max()):.2g} {column.unit}".rstrip()
    return f" (the first sample of {column.name} is off by up to {much})"
