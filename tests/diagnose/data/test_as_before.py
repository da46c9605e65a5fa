"""The new data side beside the old one, which is deleted with this file: the same traces, tests and sentences."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_spec.diagnose.ask import ask, real_rollouts
from s2r_spec.diagnose.ask import cut as old_cut
from s2r_spec.diagnose.ask import read_at as old_read_at
from s2r_spec.diagnose.data.campaign import campaign, plan
from s2r_spec.diagnose.data.rollouts import RealRollouts, cut, read_at, recorded
from s2r_spec.diagnose.data.split import split
from s2r_spec.diagnose.parted import Parted
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.errors import UsageError
from s2r_spec.trace import Trace
from tests.diagnose.data.pointer import Pointer, bench_of
from tests.diagnose.data.test_rollouts import some_tests

BENCH = bench_of()


def test_a_machine_without_protocols_runs_the_same_tests():
    new = campaign(BENCH, Pointer(), plan(BENCH, (), (), 12, 3), 3)
    old = real_rollouts(BENCH, ask(BENCH, Pointer(), 12, 3), None, 3)
    assert [test for test, _ in new.tests] == [test for test, _ in old]
    for (_, one), (_, other) in zip(new.tests, old, strict=True):
        np.testing.assert_array_equal(one["v"], other["v"])


@pytest.mark.parametrize("change", [{"vd": 3.0}, {}, "short", "renamed"])
def test_bad_recordings_get_the_same_sentences(change):
    test, trace = some_tests(1)[0]
    bad = {"short": (test, trace.between(0, 0.3)), "renamed": (test, trace.rename({"v": "w"}))}
    given = [*some_tests(9), bad[change] if isinstance(change, str) else (change, trace)]
    with pytest.raises(UsageError) as new:
        recorded(BENCH, given)
    with pytest.raises(UsageError) as old:
        real_rollouts(BENCH, given, None, 0)
    assert str(new.value) == str(old.value)


def test_traces_are_cut_and_read_as_before():
    rng = np.random.default_rng(0)
    for n in range(20):
        own = np.cumsum(rng.uniform(0.02, 0.06, 60)) + 3.0
        trace = Trace(own, {"x": rng.normal(size=(60, 2)), "on": (rng.uniform(size=60) > 0.5).astype(float)})
        for new, old in (
            (cut(trace, 0.1 * n), old_cut(trace, 0.1 * n)),
            (read_at(trace, 0.01, trace.duration + 0.01), old_read_at(trace, 0.01, trace.duration + 0.01)),
            (read_at(trace, 0.013), old_read_at(trace, 0.013)),
        ):
            np.testing.assert_allclose(new.times, old.times, atol=1e-9)
            assert dict(new.meta) == dict(old.meta)
            for name in ("x", "on"):
                np.testing.assert_allclose(new[name], old[name], atol=1e-6)


@pytest.mark.parametrize("failed", [(), (2,), (2, 5, 7)])
@pytest.mark.parametrize("count", [6, 12, 30])
def test_tests_are_held_out_as_before_and_protocols_never(count, failed):
    given = [
        (test, replace(trace, meta={"failure": "fall"}) if i in failed and count > 8 else trace)
        for i, (test, trace) in enumerate(some_tests(count))
    ]
    found = split(RealRollouts(tuple(given), ((Experiment("chirp"), given[0][1]),)), 4)
    before = Parted.of(given, 4)
    assert [t for t, _ in found.train.tests] == [t for t, _ in before.seen]
    assert [t for t, _ in found.held_out] == [t for t, _ in before.held]
    assert len(found.train.protocols) == 1
