"""Recorded rollouts, those that are held out, and the tests that represent them."""

from dataclasses import replace

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.diagnose.data.rollouts import RealRollouts, convert_units, read_at, recorded_rollouts, truncate
from s2r_spec.diagnose.data.space_filling import representative, spread, star
from s2r_spec.diagnose.data.split import split
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
    found = recorded_rollouts(BENCH, given)
    half = Experiment("chirp", (("amplitude", 0.5),))
    assert [e for e, _ in found.protocols] == [Experiment("chirp"), Experiment("chirp"), half]
    assert [len(runs) for e, runs in found.by_experiment(BENCH).items() if e.protocol] == [2, 1]
    np.testing.assert_allclose(found.protocols[0][1]["v"], Pointer().run("chirp", {}, 0)["v"], rtol=1e-12)
    assert recorded_rollouts(BENCH, given, passive=True).protocols == ()
    wrong = Trace(TIMES, {"v": TIMES}, {"v": "kg"}, {"protocol": "chirp"})
    with pytest.raises(UsageError, match=naming("'v'", "kg", "m/s")):
        recorded_rollouts(BENCH, [*given, ({}, wrong)])
    late = Trace(TIMES * 1000, {"v": TIMES}, {}, {"protocol": "chirp"})
    with pytest.raises(UsageError, match=naming("real rollout 9", "1000 s", "ms")):
        recorded_rollouts(BENCH, [*given, ({}, late)])


def test_runs_that_the_simulator_does_not_have_become_notes():
    alone = bench_of(replace(Pointer(), offered=Pointer().offered[1:]))
    given = [
        *some_tests(6),
        *runs_of("chirp", 2),
        *runs_of("coast", 1),
        ({"amplitude": 3.0}, runs_of("coast", 1)[0][1]),
    ]
    found = recorded_rollouts(alone, given)
    assert [e.protocol for e, _ in found.protocols] == ["coast"]
    assert states(found.notes[0], "2 runs", "'chirp'", "coast")
    assert states(found.notes[1], "1 run", "'coast'", "amplitude = 3")
    assert states(recorded_rollouts(BENCH, given, 7).notes[0], "7", "10")


def test_a_folder_has_protocols_and_values_that_the_spec_fixes(tmp_path):
    fixed = s2r.parse_spec(SPEC.text.replace("in [0.2, 1]", "= 0.5 {m/s}").replace(", kernel = rbf(0.5)", ""))
    for i, (_, trace) in enumerate([*some_tests(8), *runs_of("chirp", 2)]):
        s2r.write_trace(trace, tmp_path / f"r{i}.npz")
    rows = "".join(f"r{i},,{50 if i < 6 else 70},\n" for i in range(8))
    (tmp_path / "rollouts.csv").write_text(
        f"id,protocol,vd [cm/s],amplitude\n{rows}r8,chirp,,\nr9,chirp,,0.4\n"
    )
    found = recorded_rollouts(bench_of(spec=fixed), s2r.load_backend(f"log:{tmp_path}"))
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
def test_bad_recordings_get_a_sentence(spoil, facts):
    given = spoil(some_tests(9))
    with pytest.raises(UsageError, match=naming(*facts)):
        recorded_rollouts(BENCH, given)


def test_a_test_that_a_conversion_has_put_just_outside_is_at_the_end():
    trace = Pointer().rollout({"vd": 1.0}, 0)
    found = recorded_rollouts(BENCH, [({"vd": 1.0 + 1e-12}, trace)] * 6)
    assert [test for test, _ in found.tests] == [{"vd": 1.0}] * 6


def test_a_trace_has_the_simulator_s_unit_and_length():
    times = np.arange(301) / 100 + 7.0
    trace = Trace(times, {"v": np.where(times < 7.05, np.inf, 3.6), "w": times}, {"v": "km/h", "w": "m"})
    found = convert_units(trace, Pointer())
    assert np.isnan(found["v"][:5]).all()
    np.testing.assert_allclose(found["v"][5:], 1.0)
    assert dict(found.units) == {"v": "m/s", "w": "m"}
    assert truncate(trace, 1.0).duration == pytest.approx(1.0)
    fell = replace(trace, meta={"failure": "fall"})  # the time of a fall is information
    assert truncate(fell, 1.0) is fell
    assert truncate(trace, 2.99) is trace


def test_between_its_samples_a_flag_is_what_it_was():
    own = np.array([0.0, 0.1, 0.25, 0.4])
    trace = Trace(own + 3.0, {"x": 2.0 * own, "on": np.array([0.0, 1.0, 0.0, 1.0])}, {"x": "m"})
    found = read_at(trace, 0.05)
    np.testing.assert_allclose(found.times, 0.05 * np.arange(9))
    np.testing.assert_allclose(found["x"], 0.1 * np.arange(9), atol=1e-12)
    np.testing.assert_array_equal(found["on"], [0, 0, 1, 1, 1, 0, 0, 0, 1])
    # One that ends within its own last period before the horizon keeps its last values; a shorter one does not.
    np.testing.assert_allclose(read_at(trace, 0.05, 0.5)["x"][-3:], 0.8)
    assert read_at(trace, 0.05, 0.6).duration == pytest.approx(0.4)


def test_a_window_shorter_than_the_time_between_samples_is_read_at_the_simulator_s():
    short = bench_of(spec=s2r.parse_spec(SPEC.text.replace("[0.5, 0.9 s]", "[0.885 s, 0.895 s]")))
    runs = some_tests(6)
    slow = [(test, trace.resample(0.03)) for test, trace in runs]
    for (test, found), (_, trace) in zip(recorded_rollouts(short, slow).tests, runs, strict=True):
        np.testing.assert_allclose(np.diff(found.times), 0.01)
        assert short.rho(found, test) == pytest.approx(short.rho(trace, test), abs=0.1)
    assert len(recorded_rollouts(BENCH, slow).tests[0][1]) == len(slow[0][1])


@pytest.mark.parametrize(
    ("count", "tests", "held"), [(6, 6, 0), (11, 9, 0), (12, 9, 4), (27, 9, 9), (12, 1, 4), (8, 1, 0)]
)
def test_whole_tests_are_held_out_and_protocols_never(count, tests, held):
    given = [(some_tests(9)[i % tests][0], trace) for i, (_, trace) in enumerate(some_tests(count))]
    found = split(RealRollouts(tuple(given), ((Experiment("chirp"), given[0][1]),)), 4)
    assert len(found.held_out) == pytest.approx(held, abs=1 if tests > 1 and held else 0)
    assert len(found.held_out) + len(found.train.tests) == count
    assert len(found.train.protocols) == 1
    if tests > 1:
        assert not {t["vd"] for t, _ in found.held_out} & {t["vd"] for t, _ in found.train.tests}


@pytest.mark.parametrize(("failed", "left_out"), [(1, 1), (2, 0)])
def test_a_few_accidents_are_left_out(failed, left_out):
    given = [
        (t, replace(x, meta={"failure": "fall"}) if i < failed else x)
        for i, (t, x) in enumerate(some_tests(15))
    ]
    found = split(RealRollouts(tuple(given)), 0)
    assert len(found.train.tests) + len(found.held_out) == 15 - left_out


def test_what_a_campaign_set_apart_is_held_out():
    found = split(RealRollouts(tuple(some_tests(12))), 0, apart=6)
    assert [t for t, _ in found.held_out] == [t for t, _ in some_tests(6)]
    assert len(found.train.tests) == 6


def test_representative_tests_do_not_depend_on_the_order():
    space = Space.of({"a": (0.0, 1.0), "b": (0.0, 100.0)})
    tests = spread(space, 40, 3)
    first = representative(tests, space, 5)
    assert len(first) == 5
    assert all(test in tests for test in first)
    rng = np.random.default_rng(1)
    for _ in range(5):
        assert representative([tests[i] for i in rng.permutation(40)], space, 5) == first
    unit = np.array([[t["a"], t["b"] / 100.0] for t in tests])
    chosen = np.array([[t["a"], t["b"] / 100.0] for t in first])
    assert np.linalg.norm(unit[:, None] - chosen, axis=2).min(axis=1).max() < 0.45
    assert sorted(map(str, representative(star(space), space))) == sorted(map(str, star(space)))
    assert representative([{}, {}], Space(())) == [{}]
    assert representative(tests[:2] * 3, space, 4) == representative(tests[:2], space)
