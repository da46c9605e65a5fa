"""The generator of blind cases: apart from what it is to check, faithful to its labels, and as it says."""

import ast
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.emps import cases, generate
from benchmarks.blind.emps.cases import KINDS, make_case, plan
from benchmarks.blind.emps.kinds import KNOWN, NEAR, UNLIKE
from benchmarks.blind.emps.machine import STEP, TICK, Machine, arrivals
from benchmarks.blind.emps_compare import SIDE, voltages, without_noise
from s2r_emps import EmpsBackend
from s2r_emps.noise import Noise
from s2r_spec.recordings.recorded import LogBackend
from s2r_spec.spec import load_spec

ROOT = Path(__file__).parents[2]
CATALOGUE = {effect.name: effect for effect in EmpsBackend().effects()}


def imported(path):
    """Return every name that a file imports, at any depth."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def test_the_generator_knows_neither_the_simulators_dynamics_nor_the_diagnosis():
    known = ("backend", "logs", "protocols", "space", "spec", "trace")
    allowed = (*(f"s2r_spec.{module}" for module in known), "s2r_emps.moves")
    for path in (ROOT / "benchmarks" / "blind" / "emps").glob("*.py"):
        ours = {name for name in imported(path) if name.split(".")[0].startswith(("s2r", "benchmarks"))}
        assert all(name.startswith((*allowed, "benchmarks.blind.emps.")) for name in ours), path


def test_every_member_of_the_catalogue_can_be_a_cause_and_unknown_ones_are_not_in_it():
    assert set(KNOWN) == set(CATALOGUE)
    others = {kind.name: kind.relative_of for kind in (*UNLIKE, *NEAR)}
    assert not set(others) & set(CATALOGUE)
    assert {kind.relative_of for kind in UNLIKE} == {None}
    assert {kind.relative_of for kind in NEAR} <= set(CATALOGUE)


@pytest.mark.parametrize(("kind", "count"), list(zip(KINDS, (1, 2, 3, 1, 0), strict=True)))
def test_labels_say_what_was_put_in_within_the_catalogues_ranges(kind, count):
    rng = np.random.default_rng(0)
    for _ in range(40):
        label = plan(rng, kind, 20).label
        assert label["kind"] == kind
        assert len(label["effects"]) == count
        if kind == "unknown":
            assert not set(label["effects"]) & set(CATALOGUE)
            continue
        assert label["relative_of"] is None
        for name, values in label["effects"].items():
            known = {p.name: p for p in CATALOGUE[name].parameters}
            assert next(iter(known)) in values  # later ones say how it acts, and may be absent
            assert all(known[key].low <= value <= known[key].high for key, value in values.items())


def test_half_of_the_unknown_ones_are_relatives():
    rng = np.random.default_rng(1)
    relatives = [plan(rng, "unknown", 20).label["relative_of"] is not None for _ in range(200)]
    assert 0.4 < np.mean(relatives) < 0.6


@pytest.mark.parametrize("budget", generate.BUDGETS)
def test_tests_fill_the_test_space_and_a_third_is_repeated_three_times(budget):
    space = load_spec(cases.SPEC).space
    tests = cases.drawn_tests(np.random.default_rng(2), budget)
    assert len(tests) == budget
    for axis in space.axes:
        values = [test[axis.name] for test in tests]
        assert axis.low <= min(values) < axis.low + 0.2 * axis.width
        assert axis.high - 0.2 * axis.width < max(values) <= axis.high
    counts = sorted(tests.count(test) for test in {tuple(t.items()): t for t in tests}.values())
    assert set(counts) == {1, 3}
    assert counts.count(3) == pytest.approx(len(counts) / 3, abs=1)


def test_a_set_has_the_mixture_that_was_announced():
    kinds = generate.kinds_of(np.random.default_rng(3), 200)
    assert [kinds.count(kind) for kind in KINDS] == [100, 40, 10, 30, 20]
    assert kinds[:100] != sorted(kinds[:100])


@pytest.fixture
def case(monkeypatch):
    monkeypatch.setattr(cases, "DURATION", 0.15)
    # A run that short has no ρ: what the effects move is told by where it ends.
    monkeypatch.setattr(cases, "_rho", lambda trace, test: float(trace["q"][-1]))
    return make_case(np.random.default_rng(4), "pair", budget=5, held_out=1)


def test_a_case_comes_again_from_its_seed(case):
    again = make_case(np.random.default_rng(4), "pair", budget=5, held_out=1)
    assert again.label == case.label
    assert case.label["moved"] > 0
    for (test, trace), (same, other) in zip(case.rollouts, again.rollouts, strict=True):
        assert test == same
        np.testing.assert_array_equal(trace["q"], other["q"])


def test_a_case_on_disk_is_a_folder_of_rollouts_that_tells_nothing(case, tmp_path):
    generate.write_case(case, "0a1b", tmp_path)
    logged = LogBackend(str(tmp_path / "public" / "0a1b"))
    assert [p.name for p in logged.parameters] == ["speed", "accel", "payload"]
    assert {c.name: c.unit for c in logged.channels} == {c.name: c.unit for c in EmpsBackend().channels}
    spec = load_spec(tmp_path / "public" / "0a1b" / "spec.stl")
    for params, trace in logged.recorded():
        assert dict(trace.meta) == {}
        assert set(spec.params) <= set(params)
    public = {path.name for path in (tmp_path / "public").rglob("*") if path.is_file()}
    assert public == {"rollouts.csv", "spec.stl", *(f"run-{k:02d}.npz" for k in range(5))}
    assert (tmp_path / "sealed" / "0a1b.json").exists()
    assert len(LogBackend(str(tmp_path / "sealed" / "0a1b")).recorded()) == 1


def test_the_other_code_path_is_the_same_machine():
    """Nominal against nominal: the step, the joint between motor and carriage, and the resolution differ."""
    ours = EmpsBackend(noise=Noise.off(), duration=0.6).rollout(SIDE, 0)
    theirs = without_noise([cases.Machine()], SIDE, 601)
    assert 1e-8 < np.abs(theirs["q"][0] - ours["q"]).max() < 3e-6


def test_every_name_means_the_same_in_both():
    for name, (correlation, slope) in voltages(1100).items():
        assert correlation > 0.6, name
        assert 0.5 < slope < 2.0, name  # other laws: the number means the same to within a factor of two


def test_no_command_is_at_the_drive_before_the_delay():
    late = arrivals(np.random.default_rng(0), 8, Machine(delay=0.0025, jitter=0.0))
    times = STEP * np.arange(late.size) + 1e-9
    np.testing.assert_array_equal(late, np.floor((times - 0.0025) / TICK).clip(-1).astype(int))
    assert late[0] == -1
    assert arrivals(np.random.default_rng(0), 8, Machine())[0] == 0
