"""Real rollouts that are asked of a machine, and tests at the ends of their range."""

import csv

import numpy as np
import pytest
from s2r_cart import SPEC, Cart

import s2r_spec as s2r
from s2r_spec.diagnose.ask import ask, plan, real_rollouts
from s2r_spec.diagnose.design import grid
from s2r_spec.diagnose.prepare import bench_of
from s2r_spec.errors import UsageError
from s2r_spec.space import Space


@pytest.fixture(scope="module")
def bench():
    spec = s2r.parse_spec(SPEC)
    return bench_of(spec, spec.requirements[0], Cart())


def test_ends_of_a_range_are_in_it_to_the_last_digit():
    # 0.3 + (0.9 - 0.3) is more than 0.9.
    space = Space.of({"a": (0.3, 0.9), "b": (-0.1, 0.3)})
    assert all((space.vector(test) == list(test.values())).all() for test in grid(space))
    assert (space.at(np.ones(2)) == [0.9, 0.3]).all()


def test_a_test_that_a_conversion_has_put_just_outside_is_at_the_end(bench):
    [(low, high), *_] = [(axis.low, axis.high) for axis in bench.spec.space.axes]
    name = bench.spec.space.names[0]
    given = ask(bench, Cart(), 6, 0)
    moved = [({**test, name: high + 1e-12}, trace) for test, trace in given]
    assert [test[name] for test, _ in real_rollouts(bench, moved, None, 0)] == [high] * 6
    far = [({**test, name: high + 0.01 * (high - low)}, trace) for test, trace in given]
    with pytest.raises(UsageError, match="outside"):
        real_rollouts(bench, far, None, 0)


def test_kept_rollouts_of_another_plan_are_refused_and_not_taken_for_its_tests(bench, tmp_path):
    first = ask(bench, Cart(), 10, 0, tmp_path)
    assert [test for test, _ in first] == [test for _, test in plan(bench, 10, 0)]
    for budget, seed in ((20, 0), (10, 1)):
        with pytest.raises(UsageError, match=r"was recorded with .*--real log:"):
            ask(bench, Cart(), budget, seed, tmp_path)


def test_a_run_that_was_killed_between_trace_and_row_gets_its_row(bench, tmp_path):
    ask(bench, Cart(), 6, 0, tmp_path)
    table = tmp_path / "rollouts.csv"
    whole = table.read_text()
    table.write_text("".join(whole.splitlines(keepends=True)[:-1]))

    class Asked(Cart):
        def rollout(self, params, seed):
            raise AssertionError("what is on disk is not asked for again")

    again = ask(bench, Asked(), 6, 0, tmp_path)
    assert len(again) == 6
    assert list(csv.reader(whole.splitlines())) == list(csv.reader(table.read_text().splitlines()))


def test_a_row_that_is_not_whole_is_told_with_its_line(bench, tmp_path):
    ask(bench, Cart(), 6, 0, tmp_path)
    table = tmp_path / "rollouts.csv"
    table.write_text(table.read_text().rstrip().rpartition(",")[0])
    with pytest.raises(UsageError, match=r"rollouts\.csv:7: "):
        ask(bench, Cart(), 6, 0, tmp_path)
