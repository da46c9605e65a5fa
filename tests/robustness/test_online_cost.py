"""What a sample costs online: counted in calls and numbers looked at, not in time."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest

from s2r_spec.robustness.online import points, terms
from s2r_spec.robustness.online.tape import Sliding, SlidingLeast, Tape
from s2r_spec.spec import parse_spec

rng = np.random.default_rng(0)
X, Y = rng.uniform(-1, 1, (2, 6000)).tolist()


class Counter:
    """Counts calls of functions, and numbers in the bounds that are looked at, while something runs."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls = self.numbers = 0
        bound = terms.Term.bound

        def counted(*args):
            found = bound(*args)
            self.numbers += found.size
            return found

        monkeypatch.setattr(terms.Term, "bound", counted)

    def __call__(self, does: Callable[[], object]) -> tuple[int, int]:
        self.calls = self.numbers = 0

        def count(frame, event, argument) -> None:
            self.calls += event in ("call", "c_call")

        sys.setprofile(count)
        try:
            does()
        finally:
            sys.setprofile(None)
        return self.calls, self.numbers


@pytest.fixture
def counter(monkeypatch) -> Counter:
    return Counter(monkeypatch)


def held(recorder) -> int:
    """How many numbers everything that was built for a monitor has room for."""
    total, seen, stack = 0, set(), [*recorder.clock.streams, recorder.clock.positions, recorder.tapes]
    while stack:
        one = stack.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        match one:
            case Tape():
                total += one.data.size
            case Sliding():
                total += len(one.front) + len(one.back)
            case SlidingLeast():
                total += len(one.queue)
            case dict():
                stack.extend(one.values())
            case list() | tuple():
                stack.extend(one)
            case _:
                stack.extend(vars(one).values() if hasattr(one, "__dict__") else ())
    return total


def run(follows, first: int, last: int) -> None:
    for k in range(first, last):
        follows.update(k / 100, {"x": X[k], "y": Y[k]})


def per_sample(counter: Counter, follows, first: int, last: int) -> tuple[float, float]:
    """Return calls and numbers a sample, on average over some samples."""

    calls, numbers = counter(lambda: run(follows, first, last))
    return calls / (last - first), numbers / (last - first)


FORMULAS = [
    "always[0, W] x > 0",
    "once[0, W] historically[0.1, W] x > 0",
    "always[0, W] eventually[0, W] x > 0",
    "x > 0 until[0.05, W] y > 0",
    "x > 0 release[0, W] y > 0",
    "x > 0 unless[0, W] y > 0",
    "x > 0 since[0, W] y > 0",
    "mean(x, W) <= 1 and count(x > 0, W) <= 3 and delay(x, W) < 1 and duration(x > 0) < 1 {s}",
    "count(eventually[0, W] x > 0, W) < 1",
    "historically (x > 0 -> once (y > 0 since x > 0)) and integral(x) < 3 {s}",
]


@pytest.mark.parametrize("formula", FORMULAS)
def test_a_stream_costs_the_same_whatever_the_window_and_the_time(counter, formula: str) -> None:
    costs = {}
    for window in (0.1, 2):  # 10 and 200 samples
        spec = parse_spec(f"signal x signal y const W {{s}} = {window} require it: {formula}")
        stream = spec.robustness_stream(period=0.01)
        run(stream, 0, 500)
        size = held(stream._recorder)
        costs[window], numbers = per_sample(counter, stream, 500, 700)
        run(stream, 700, 1300)
        later, _ = per_sample(counter, stream, 1300, 1500)
        assert later == pytest.approx(costs[window], rel=0.05)
        assert held(stream._recorder) <= 1.3 * size
        assert numbers == 0
    assert costs[2] == pytest.approx(costs[0.1], rel=0.1)


@pytest.mark.parametrize(
    "formula",
    [
        "always[0, 50] (x > 0 -> always[0, W] y > 0)",
        "always (x > 0 -> y > 0 until[0, W] x > 0)",
        "x > -2 until[50, 55] (always[0, W] y > -2)",
    ],
)
def test_an_interval_looks_at_a_bounded_number_of_unsettled_instants(
    counter, monkeypatch, formula: str
) -> None:
    monkeypatch.setattr(points, "OFTEN", 32)
    costs = {}
    for window in (0.1, 0.3, 3):  # 10, 30 and 300 samples
        spec = parse_spec(f"signal x signal y const W {{s}} = {window} require it: {formula}")
        monitor = spec.monitor(period=0.01)
        run(monitor, 0, 700)
        costs[window] = per_sample(counter, monitor, 700, 1100)
        assert held(monitor._recorder) < 40 * (100 * window + 64)
    # up to OFTEN instants all are looked at for each sample, from there on no more than that on average
    assert costs[0.1][1] < costs[0.3][1]
    assert costs[3][1] < 1.5 * costs[0.3][1]
    assert max(calls for calls, _ in costs.values()) < 1.2 * costs[0.3][0]


@pytest.mark.parametrize("signals", ["signal x signal y", "signal x in [-1, 1] signal y in [-3, 3]"])
def test_an_answer_that_any_later_sample_may_bring_is_not_looked_for(counter, signals: str) -> None:
    spec = parse_spec(f"{signals} require it: always[0, 50] (x > 0 -> eventually[0, 1] y > 0)")
    monitor = spec.monitor(period=0.01)
    run(monitor, 0, 300)
    assert per_sample(counter, monitor, 300, 500)[1] == 0


def test_a_window_at_the_first_instant_needs_no_memory(counter) -> None:
    spec = parse_spec(
        "signal x signal y require it: always[0, 1000] x > -2 and (x > -2 until[0, 1000] y > 2)"
    )
    monitor = spec.monitor(period=0.01)
    first, numbers = per_sample(counter, monitor, 100, 500)
    run(monitor, 500, 1500)
    last, _ = per_sample(counter, monitor, 1500, 1700)
    assert (last, numbers) == (pytest.approx(first, rel=0.05), 0)
    assert held(monitor._recorder) <= 7 * 64
