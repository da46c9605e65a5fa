"""Recorded rollouts, those that are held out, and the tests that represent them."""

from dataclasses import replace

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.diagnose.ask import cut as old_cut
from s2r_spec.diagnose.ask import read_at as old_read_at
from s2r_spec.diagnose.ask import real_rollouts
from s2r_spec.diagnose.data.rollouts import RealRollouts, cut, read_at, recorded
from s2r_spec.diagnose.data.space_filling import representative, spread, star
from s2r_spec.diagnose.data.split import split
from s2r_spec.diagnose.parted import Parted
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.errors import UsageError
from s2r_spec.space import Space
from s2r_spec.trace import Trace
from tests.diagnose.data.pointer import SPEC, TIMES, Pointer, bench_of
from tests.errors import naming, states

BENCH = bench_of()


def some_tests(count):
    speeds = np.linspace(0.2, 1.0, 9)
    return [
        ({"vd": float(v)}, Pointer().rollout({"vd": float(v)}, i))
        for i, v in enumerate(np.resize(speeds, count))
    ]


def runs_of(protocol, count, machine=None, **params):
    return [(params, (machine or Pointer()).run(protocol, params, i)) for i in range(count)]


def test_protocols_stand_beside_tests_in_the_simulator_s_units():
    slow = Pointer("cm/s")
    given = [*some_tests(6), *runs_of("chirp", 2, slow), *runs_of("chirp", 1, slow, amplitude=0.5)]
    found = recorded(BENCH, given)
    half = Experiment("chirp", (("amplitude", 0.5),))
    assert [e for e, _ in found.protocols] == [Experiment("chirp"), Experiment("chirp"), half]
    assert [len(runs) for e, runs in found.by_experiment(BENCH).items() if e.protocol] == [2, 1]
    np.testing.assert_allclose(found.protocols[0][1]["v"], Pointer().run("chirp", {}, 0)["v"], rtol=1e-12)
    assert recorded(BENCH, given, passive=True).protocols == ()
    wrong = Trace(TIMES, {"v": TIMES}, {"v": "kg"}, {"protocol": "chirp"})
    with pytest.raises(UsageError, match=naming("'v'", "kg", "m/s")):
        recorded(BENCH, [*given, ({}, wrong)])
    late = Trace(TIMES * 1000, {"v": TIMES}, {}, {"protocol": "chirp"})
    with pytest.raises(UsageError, match=naming("real rollout 9", "1000 s", "ms")):
        recorded(BENCH, [*given, ({}, late)])


def test_runs_that_the_simulator_does_not_have_become_notes():
    alone = bench_of(replace(Pointer(), offered=Pointer().offered[1:]))
    given = [
        *some_tests(6),
        *runs_of("chirp", 2),
        *runs_of("coast", 1),
        ({"amplitude": 3.0}, runs_of("coast", 1)[0][1]),
    ]
    found = recorded(alone, given)
    assert [e.protocol for e, _ in found.protocols] == ["coast"]
    assert states(found.notes[0], "2 runs", "'chirp'", "coast")
    assert states(found.notes[1], "1 run", "'coast'", "amplitude = 3")
    assert states(recorded(BENCH, given, 7).notes[0], "7", "10")


def test_a_folder_has_protocols_and_values_that_the_spec_fixes(tmp_path):
    fixed = s2r.parse_spec(SPEC.text.replace("in [0.2, 1]", "= 0.5 {m/s}").replace(", kernel = rbf(0.5)", ""))
    for i, (_, trace) in enumerate([*some_tests(8), *runs_of("chirp", 2)]):
        s2r.write_trace(trace, tmp_path / f"r{i}.npz")
    rows = "".join(f"r{i},,{50 if i < 6 else 70},\n" for i in range(8))
    (tmp_path / "rollouts.csv").write_text(
        f"id,protocol,vd [cm/s],amplitude\n{rows}r8,chirp,,\nr9,chirp,,0.4\n"
    )
    found = recorded(bench_of(spec=fixed), s2r.load_backend(f"log:{tmp_path}"))
    assert [test for test, _ in found.tests] == [{}] * 6
    assert [dict(e.params) for e, _ in found.protocols] == [{}, {"amplitude": 0.4}]
    assert states(found.notes[0], "2", "vd")


@pytest.mark.parametrize(
    ("spoil", "facts"),
    [
        (lambda runs: runs[:5], ["5", "6"]),
        (lambda runs: [*runs, ({}, runs[0][1])], ["real rollout 9", "'vd'"]),
        (lambda runs: [*runs, ({"vd": 3.0}, runs[0][1])], ["real rollout 9", "vd = 3 m/s"]),
        (
            lambda runs: [*runs, (runs[0][0], runs[0][1].between(0, 0.3))],
            ["real rollout 9", "0.3 s", "failure"],
        ),
        (lambda runs: [*runs, (runs[0][0], runs[0][1].rename({"v": "w"}))], ["real rollout 9", "'v'"]),
        (
            lambda runs: [*runs, (runs[0][0], Trace(TIMES, {"v": TIMES / (TIMES != 0.6)}))],
            ["real rollout 9", "NaN"],
        ),
        (lambda runs: [*runs, "noise"], ["str"]),
    ],
)
@pytest.mark.filterwarnings("ignore:divide")
def test_bad_recordings_get_the_sentence_that_they_had(spoil, facts):
    given = spoil(some_tests(9))
    with pytest.raises(UsageError, match=naming(*facts)) as new:
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


def test_what_a_campaign_set_apart_is_held_out():
    found = split(RealRollouts(tuple(some_tests(12))), 0, apart=6)
    assert [t for t, _ in found.held_out] == [t for t, _ in some_tests(6)]
    assert len(found.train.tests) == 6


def test_representative_tests_do_not_depend_on_the_order():
    space = Space.of({"a": (0.0, 1.0), "b": (0.0, 100.0)})
    tests = spread(space, 40, 3)
    first = representative(tests, space)
    assert len(first) == 5
    assert all(test in tests for test in first)
    rng = np.random.default_rng(1)
    for _ in range(5):
        assert representative([tests[i] for i in rng.permutation(40)], space) == first
    unit = np.array([[t["a"], t["b"] / 100.0] for t in tests])
    chosen = np.array([[t["a"], t["b"] / 100.0] for t in first])
    assert np.linalg.norm(unit[:, None] - chosen, axis=2).min(axis=1).max() < 0.45
    assert sorted(map(str, representative(star(space), space))) == sorted(map(str, star(space)))
    assert representative([{}, {}], Space(())) == [{}]
    assert representative(tests[:2] * 3, space, 4) == representative(tests[:2], space)
