"""The blind generator is another code path than the simulator, and still the same robot."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.a1 import cases, rollout
from benchmarks.blind.a1.effects import KNOWN, UNKNOWN
from benchmarks.blind.a1.generate import plan, write_case
from benchmarks.blind.a1.plant import Plant
from benchmarks.blind.a1.rollout import Runner
from benchmarks.blind.a1.twin import Twin
from s2r_sim import SimBackend
from s2r_sim.effects import CATALOGUE
from s2r_sim.plant.channels import CHANNELS
from s2r_spec import load_spec
from s2r_spec.recordings.recorded import LogBackend

ROOT = Path(__file__).parents[2]
SPEC = load_spec(ROOT / "specs" / "a1_velocity.stl")

# The system under test, and the figures of the robot; nothing of the simulator's plant, effects, noise or sensors.
SHARED = {
    "s2r_sim.controller.base_task",
    "s2r_sim.controller.trot",
    "s2r_sim.controller.estimator",
    "s2r_sim.robot.constants",
    "s2r_sim.controller.gains",
    "s2r_sim.robot.signals",
}


def imported(path):
    """Return every module that a file imports, and the names that it takes from it."""
    found = {}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name: set() for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.setdefault(node.module, set()).update(alias.name for alias in node.names)
    return found


def test_the_generator_takes_nothing_of_the_simulator_but_the_system_under_test():
    for path in sorted((ROOT / "benchmarks" / "blind" / "a1").rglob("*.py")):
        modules = imported(path)
        of_sim = {name for name in modules if name.split(".")[0] == "s2r_sim"}
        assert of_sim <= (SHARED if path.name == "robot.py" else set()), path
        assert {name for name in modules if name.split(".")[0] == "s2r_spec"} <= {
            "s2r_spec.spec",
            "s2r_spec.trace",
        }, path
        if path.name == "robot.py":
            assert modules["s2r_sim.controller.estimator"] == {"replay"}


def test_nothing_of_the_package_can_import_the_generator():
    for path in [*(ROOT / "s2r_spec").rglob("*.py"), *(ROOT / "backends").rglob("*.py")]:
        assert not {name for name in imported(path) if name.split(".")[0] == "benchmarks"}, path


@pytest.fixture(scope="module")
def runner():
    return Runner(Twin())


@pytest.fixture(scope="module")
def trace(runner):
    return runner.run(0.3, np.random.default_rng(1))


def test_a_trace_has_the_channels_of_the_simulator(trace):
    assert list(trace.channels) == [channel.name for channel in CHANNELS]
    for channel in CHANNELS:
        assert trace.units[channel.name] == channel.unit
        assert trace[channel.name].shape == ((751,) if channel.width == 1 else (751, channel.width))


def test_the_nominal_robot_walks_as_in_the_simulator(trace):
    simulated = SimBackend().rollout({"vd": 0.3}, seed=1)
    gap = [SPEC.robustness(each, params={"vd": 0.3})["walking"] for each in (trace, simulated)]
    assert abs(gap[0] - gap[1]) < 0.01
    late = slice(250, None)
    for name, most in (("vx", 0.005), ("height", 0.002), ("pitch", 0.004), ("tau", 1.0), ("foot_force", 6.0)):
        assert np.abs(trace[name][late].mean(axis=0) - simulated[name][late].mean(axis=0)).max() < most, name


@pytest.fixture
def short_warm_up(monkeypatch):
    """Let a robot trot in place for a fifth of the time before its first run."""
    monkeypatch.setattr(rollout, "WARM_UP", 100)


@pytest.mark.parametrize(
    ("effect", "values", "known"),
    [
        ("encoder_offset", {"hip": 0.0, "thigh": 0.0, "calf": 0.04}, 0.3),
        ("attitude_bias", {"roll": -2.0, "pitch": 0.0}, 0.1),
        ("backlash", {"half_gap": 0.015}, 0.5),
    ],
)
def test_it_logs_joints_and_attitude_by_the_sensors_of_the_robot(short_warm_up, effect, values, known):
    """From base to foot, a simulator with the effect explains most of what a log of other code says."""
    twin = Twin()
    KNOWN[effect].apply(twin, np.random.default_rng(5), values)
    trace = Runner(twin).run(0.2, np.random.default_rng(1), duration=0.3)
    bare, knowing = (
        np.abs(sim.residuals(trace, {"vd": 0.2})["foot_place"]).mean()
        for sim in (SimBackend(), SimBackend().with_effects({effect: values}))
    )
    assert bare > 0.002
    assert knowing < known * bare


@pytest.mark.parametrize("delay", [0.0, 0.003, 0.0047])
def test_drives_do_nothing_before_their_first_command_arrives(delay):
    twin = Twin()
    plant = Plant(twin.build, twin.world)
    plant.stand()
    law = np.zeros((5, 12))
    law[4] = 3.0
    made = []
    for _ in range(5):
        plant.send(law, delay)
        plant.run(-1.0)
        made.append(plant.state["current"][0, 0])
    # The last of eight steps of a tick of 2 ms begins at 1.75 ms.
    assert (np.array(made) > 1.0).tolist() == [0.002 * tick + 0.00175 >= delay for tick in range(5)]
    assert made[0] == 0.0 or delay < 0.00175


def test_a_rollout_is_a_function_of_its_random_numbers(runner):
    other = runner.run(0.3, np.random.default_rng(2), duration=0.1)
    first, again = (runner.run(0.3, np.random.default_rng(1), duration=0.1) for _ in range(2))
    for name in first.channels:
        np.testing.assert_array_equal(again[name], first[name])
    assert not np.array_equal(other["q"], first["q"])


def test_every_effect_of_the_catalogue_is_there_with_its_parameters_in_range():
    assert KNOWN.keys() == CATALOGUE.keys()
    assert not UNKNOWN.keys() & CATALOGUE.keys()
    assert {kind.relative_of for kind in UNKNOWN.values()} <= {None, *CATALOGUE}
    for name, kind in KNOWN.items():
        ranges = {parameter.name: parameter for parameter in CATALOGUE[name].parameters}
        for size in (kind.low, kind.high):
            for draw in range(20):
                for key, value in kind.values(np.random.default_rng(draw), size).items():
                    assert ranges[key].low <= value <= ranges[key].high, (name, key)


@pytest.mark.parametrize("name", sorted(KNOWN | UNKNOWN))
def test_every_effect_changes_the_robot(name):
    kind = (KNOWN | UNKNOWN)[name]
    changed, _ = cases.twin_of([kind], {name: kind.high}, seed=3, background=0.0)
    nominal = Twin()
    assert changed.world != nominal.world or (changed.build, changed.sensing, changed.timing) != (
        nominal.build,
        nominal.sensing,
        nominal.timing,
    )


def test_commands_cover_the_test_space_and_a_third_of_them_is_repeated():
    drawn = cases.tests(np.random.default_rng(0), 30)
    values, counts = np.unique(drawn, return_counts=True)
    assert (len(drawn), len(values), list(counts).count(3)) == (30, 18, 6)
    assert values.min() < -0.17
    assert values.max() > 0.27
    assert all(low <= vd <= high for vd in values for low, high in [cases.RANGE])


def test_the_mix_of_kinds():
    kinds = plan(200, np.random.default_rng(0))
    assert {kind: kinds.count(kind) for kind in cases.KINDS} == {
        "single": 100,
        "pair": 40,
        "triple": 10,
        "unknown": 30,
        "null": 20,
    }


def test_a_case_on_disk_can_be_read_and_says_nothing_of_its_label(short_warm_up, tmp_path, monkeypatch):
    monkeypatch.setattr(cases, "_PROBES", 2)
    case = cases.make_case(np.random.default_rng(5), "single", budget=2, held_out=1)
    (effect,) = case.label["effects"]
    assert effect in CATALOGUE
    assert case.label["moved"] > 0.0
    write_case(tmp_path, "0123", case)
    folder = tmp_path / "public" / "0123"
    recordings = LogBackend(str(folder)).recorded()
    assert [params for params, _ in recordings] == [params for params, _ in case.rollouts]
    np.testing.assert_allclose(recordings[0][1]["q"], case.rollouts[0][1]["q"], atol=1e-6)
    np.testing.assert_array_equal(recordings[0][1].times, case.rollouts[0][1].times)
    assert load_spec(folder / "spec.stl").robustness(*reversed(recordings[0]))
    assert json.loads((tmp_path / "sealed" / "0123.json").read_text())["effects"] == case.label["effects"]
    assert {key for _, trace in recordings for key in trace.meta} <= {"source", "failure"}
    assert sorted(path.name for path in folder.iterdir()) == [
        "rollouts.csv",
        "run-00.npz",
        "run-01.npz",
        "spec.stl",
    ]


def test_the_command_refuses_a_folder_that_is_not_empty(tmp_path):
    (tmp_path / "old").write_text("x")
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.blind.a1.generate", "--cases", "1", "--seed", "1", "--out", str(tmp_path)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "empty" in done.stderr
