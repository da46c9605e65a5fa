"""The generator of blind turtlebots: apart from what it is to check, faithful to its labels, and as it says."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.emps.cases import KINDS
from benchmarks.blind.emps.generate import write_case
from benchmarks.blind.outsiders import cases as outsiders
from benchmarks.blind.outsiders.cases import BUDGET, DIFFERENT, drawn_tests, make_case, size_of
from benchmarks.blind.turtlebot import machine
from benchmarks.blind.turtlebot.causes import KNOWN, NEAR, UNLIKE
from benchmarks.blind.turtlebot.disturbances import coloured, messages
from benchmarks.blind.turtlebot.plant import SUB, H, Numbers
from benchmarks.blind.turtlebot_compare import compared, path, rho, spread, theirs
from s2r_spec.backend import load_backend
from s2r_spec.recordings.recorded import LogBackend
from s2r_spec.spec import load_spec

FOLDER = Path(machine.__file__).parent
CATALOGUE = {effect.name: effect for effect in load_backend("turtlebot").effects()}
TESTS = spread(6)


def small(kind):
    """Return a case of six rollouts, of which two say how far the effects move ρ."""
    with pytest.MonkeyPatch.context() as patch:
        for name, count in {"BUDGET": 6, "DIFFERENT": 4, "PROBES": 2}.items():
            patch.setattr(outsiders, name, count)
        return make_case(machine, np.random.default_rng(5), kind)


def test_the_generator_takes_the_controller_and_nothing_else_of_the_simulator():
    taken = set()
    for file in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("s2r"):
                taken |= {f"{node.module}.{alias.name}" for alias in node.names}
            elif isinstance(node, ast.Import):
                assert not any(alias.name.startswith("s2r") for alias in node.names), file
    assert taken == {"s2r_turtlebot.command", "s2r_turtlebot.Constants", "s2r_spec.trace.Trace"}


def test_every_member_of_the_catalogue_can_be_a_cause_and_unknown_ones_are_not_in_it():
    assert [cause.name for cause in KNOWN] == list(CATALOGUE)
    others = {cause.name: cause.relative_of for cause in machine.UNKNOWN}
    assert len(others) == len(UNLIKE) + len(NEAR) == 2 * len(NEAR)
    assert not set(others) & set(CATALOGUE)
    assert {cause.relative_of for cause in UNLIKE} == {None}
    assert {cause.relative_of for cause in NEAR} <= set(CATALOGUE)


@pytest.mark.parametrize("cause", KNOWN, ids=lambda cause: cause.name)
def test_sizes_are_within_the_catalogues_ranges_and_large_enough_to_be_named(cause):
    parameter, *_ = CATALOGUE[cause.name].parameters
    assert (cause.parameter, cause.nominal) == (parameter.name, parameter.nominal)
    drawn = [size_of(cause, np.random.default_rng(seed)) for seed in range(40)]
    assert min(map(abs, drawn)) >= 0.25
    assert all(parameter.low < cause.made(size) < parameter.high for size in drawn)
    assert (min(drawn) < 0.0) == cause.signed


@pytest.mark.parametrize(("kind", "count"), list(zip(KINDS, (1, 2, 3, 1, 0), strict=True)))
def test_a_case_has_the_effects_of_its_kind_and_a_background_of_all_others(kind, count):
    case = small(kind)
    assert len(case.rollouts) == 6
    label = case.label
    assert (label["kind"], len(label["effects"])) == (kind, count)
    assert set(label["background"]) == set(CATALOGUE) - set(label["effects"])
    assert ("moved" in label) == bool(count)


def test_a_cause_that_acts_somewhere_or_at_some_time_has_that_in_its_label(monkeypatch):
    monkeypatch.setattr(outsiders, "drawn_tests", lambda spec, rng: TESTS[:1])
    found = {}
    for seed in range(40):
        label = make_case(machine, np.random.default_rng(seed), "unknown").label
        found |= {name: (values, label) for name, values in label["effects"].items()}
    assert set(found) >= {"stall", "estimate_jump", "square_slip"}
    values, label = found["stall"]
    window = [values["since"], values["since"] + values["time"]]
    assert label["where"]["window"] == pytest.approx(window, abs=1e-3)
    values, label = found["estimate_jump"]
    assert label["where"]["place"][0] == pytest.approx(values["place"], abs=1e-3)
    assert list(found["square_slip"][0]) == ["coefficient"]
    assert found["square_slip"][1]["relative_of"] == "turning_slip"


def test_a_written_case_is_read_as_it_was_run_and_runs_the_same_again(tmp_path):
    case = small("unknown")
    write_case(case, "0123", tmp_path, machine.SPEC)
    recorded = LogBackend(str(tmp_path / "public" / "0123")).recorded()
    assert json.loads((tmp_path / "sealed" / "0123.json").read_text())["effects"]
    for (test, one), (same, other) in zip(case.rollouts, recorded, strict=True):
        assert test == same
        assert list(one.channels) == list(other.channels)
        for name in one.channels:
            np.testing.assert_array_equal(one[name], other[name])
    assert small("unknown").label == case.label


def test_a_machine_is_run_thirty_times_at_twenty_tests():
    drawn = drawn_tests(load_spec(machine.SPEC), np.random.default_rng(0))
    assert len(drawn) == BUDGET == 30
    assert len({tuple(test.values()) for test in drawn}) == DIFFERENT == 20


def test_without_effects_the_machine_is_near_its_simulator():
    rng, simulator = np.random.default_rng(1), load_backend("turtlebot")
    body = machine.drawn_body(rng)
    real = [machine.drive(body, test, seed) for test in TESTS for seed in range(4)]
    one, other = ([simulator.rollout(test, k + seed) for test in TESTS for seed in range(4)] for k in (0, 4))
    for made, simulated in zip(real, one, strict=True):
        assert made.units == simulated.units
        assert list(made.channels) == list(simulated.channels)
        np.testing.assert_allclose(made.times, simulated.times)
    at = [test for test in TESTS for _ in range(4)]
    # From one run to another ρ moves by 2.8 mm. The integrators' steps make 1.7 mm of a difference.
    assert abs(np.mean(rho(real, at) - rho(one, at))) < 0.004
    assert np.std(rho(real, at) - rho(one, at)) < 1.5 * np.std(rho(other, at) - rho(one, at))
    assert np.std(path(real) - path(one)) < 1.2 * np.std(path(other) - path(one))


@pytest.mark.parametrize("cause", KNOWN, ids=lambda cause: cause.name)
def test_a_member_does_about_what_the_catalogue_says_but_by_another_law(cause):
    correlation, slope, _, _ = compared(cause, (cause.sizes[0] * cause.sizes[1]) ** 0.5, TESTS)
    # A limit of each wheel takes from the turning what the catalogue's takes from the speed.
    assert 0.75 < correlation < 1.0 - 1e-6
    assert slope == pytest.approx(1.0, abs=0.6 if cause.name == "speed_limit" else 0.2)


@pytest.mark.parametrize("cause", machine.UNKNOWN, ids=lambda cause: cause.name)
def test_an_unknown_cause_of_the_largest_size_moves_the_robot(cause):
    values = {cause.name: cause.made(cause.sizes[1])}
    assert np.std(path(theirs(values, TESTS[:3])) - path(theirs({}, TESTS[:3]))) > 0.003


@pytest.mark.parametrize(("gamma", "grain", "delay"), [(0.0, 1.0, 0.12), (1.0, 1.0, 0.12), (1.0, 5.0, 0.03)])
def test_commands_are_late_by_the_labels_delay_and_jitter(gamma, grain, delay):
    newest = messages(np.random.default_rng(0), Numbers(latency=delay, jitter=0.3, gamma=gamma, grain=grain))[
        0
    ]
    steps = np.arange(newest.size)
    late = H * (steps // SUB - newest)[newest >= 0] * SUB
    assert late.mean() == pytest.approx(delay, abs=0.002)
    assert late.std() > 0.1 * delay
    assert (np.diff(newest) >= 0).all()
    assert H * np.argmax(newest >= 0) > 0.3 * delay


def test_wheels_stand_until_the_first_command_arrives():
    run = machine.drive({"latency": 0.1}, TESTS[0], 0)
    assert np.ptp(run["x"][:6]) == 0.0
    assert np.ptp(run["x"][:8]) > 0.0


def test_slip_has_the_simulators_deviation_over_a_second_and_a_colour():
    p = Numbers(slip_noise=0.1, colour=0.05)
    errors = np.hstack([coloured(np.random.default_rng(seed), p) for seed in range(20)])
    seconds = errors.reshape(2, -1, 1000).mean(axis=2)
    np.testing.assert_allclose(seconds.std(axis=1), 0.1, rtol=0.2)
    assert np.corrcoef(errors[0, :-20], errors[0, 20:])[0, 1] == pytest.approx(np.exp(-0.4), abs=0.05)
