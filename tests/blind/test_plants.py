"""Two A1s by other authors stand, walk, and have the effects that they say."""

import ast
from pathlib import Path

import numpy as np
import pytest

from benchmarks.plants import PLANTS, Plant
from benchmarks.plants.backend import PlantBackend
from benchmarks.plants.cases import LARGEST, SMALLEST, axis, cases, commands, plant
from benchmarks.plants.machine import EFFECTS, Machine, bodies, healthy
from benchmarks.plants.robot import CHANNELS, Inertia, reference
from s2r_spec.backend import Backend
from s2r_spec.protocols import HasProtocols

ROOT = Path(__file__).parents[2]
NAMES = sorted(PLANTS)


def rng(seed=0):
    return np.random.default_rng(seed)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module", params=NAMES)
def author(request):
    return PLANTS[request.param]


def standing(author, **effects):
    """Return rms torque [N m], height [m] and load [N] after 0.3 s on stiff legs."""
    made = reference("squat")
    body = author.body(
        Machine({name.replace("__", "."): value for name, value in effects.items()}), False, rng()
    )
    body.place(made.height, made.q[0])
    motors = np.array([made.q[0], np.zeros(12), np.full(12, 120.0), np.full(12, 3.0), np.zeros(12)])
    for _ in range(150):
        body.step(motors)
    return rms(body.reported()), body.truth()[2], body.foot_force()[2::3].sum()


def test_only_the_door_takes_anything_of_the_simulator():
    for path in sorted((ROOT / "benchmarks" / "plants").rglob("*.py")):
        if path.name in ("robot.py", "compare.py"):
            continue
        names = [
            node.module for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)
        ]
        assert not [name for name in names if name and name.startswith(("s2r_sim", "benchmarks.blind"))], path


def test_it_trots_at_the_commanded_velocity(author):
    trace = Plant(author, Machine()).trot(0.2, rng(), duration=0.8)
    assert trace.failure is None
    assert np.mean(trace["vx"][200:]) == pytest.approx(0.2, abs=0.03)
    assert np.mean(trace["height"]) == pytest.approx(0.28, abs=0.01)
    assert [(name, trace[name][0].size) for name in trace.channels] == [
        (one.name, one.width) for one in CHANNELS
    ]


def test_it_stands_and_carries_its_weight(author):
    trunk, legs = bodies(Machine(), Inertia(0.0, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0))
    weight = 9.81 * (trunk.mass + sum(inertia.mass for leg in legs for _, inertia, _ in leg))
    _, height, load = standing(author)
    assert load == pytest.approx(weight, rel=0.03)
    assert height == pytest.approx(0.27, abs=0.01)


def test_in_the_air_joints_follow_their_references_and_the_base_stays(author):
    trace = Plant(author, Machine()).run("air_sine", rng())
    assert trace.meta["protocol"] == "air_sine"
    assert rms(trace["q"] - reference("air_sine").q) < 0.12
    assert np.ptp(trace["x"]) < 0.002
    assert not trace["contact"].any()


def test_energy_does_not_grow_in_the_air_with_the_motors_off(author):
    body = author.body(Machine(), True, rng())
    body.place(0.6, reference("air_coast").q[250])
    energy = []
    for _ in range(200):
        body.step(np.zeros((5, 12)))
        energy.append(body.energy())
    assert np.diff(energy).max() < 1e-3 * np.ptp(energy)
    assert np.ptp(energy) > 0.1


def test_the_same_random_numbers_give_the_same_trace(author):
    one, again, other = (Plant(author, Machine()).run("air_coast", rng(seed)) for seed in (0, 0, 1))
    assert all((again[name] == one[name]).all() for name in one.channels)
    assert not (other["q"] == one["q"]).all()


def test_effects_on_the_ground_do_what_they_say(author):
    torque, height, load = standing(author)
    loaded = standing(author, payload__mass=3.0)
    assert loaded[2] - load == pytest.approx(3.0 * 9.81, rel=0.1)
    assert loaded[0] > 1.1 * torque
    assert standing(author, torque_constant__factor=0.8)[0] > 1.15 * torque
    assert standing(author, soft_ground__sink=0.02)[1] < height - 0.004
    assert standing(author, motor_strength__factor=0.7)[1] < height - 0.003


def test_effects_in_the_air_do_what_they_say(author):
    healthy, rubs, turned = (
        Plant(author, Machine(effects)).run("air_coast", rng())
        for effects in ({}, {"viscous_friction.coefficient": 0.8}, {"encoder_offset.calf": 0.04})
    )
    falling = slice(340, None)
    assert rms(rubs["dq"][falling]) < 0.7 * rms(healthy["dq"][falling])
    lower = healthy["foot_position"][:50, 2::3] - turned["foot_position"][:50, 2::3]
    assert abs(lower).mean() > 0.003  # the drives put the wrong angle where the right one should be


def test_a_healthy_machine_is_near_the_data_sheet():
    machine = healthy(rng(3))
    assert not machine.effects
    assert np.ptp(machine.masses) < 0.03
    assert machine.masses != healthy(rng(4)).masses
    with pytest.raises(ValueError, match="backlash"):
        Machine({"backlash.half_gap": 0.01})


@pytest.mark.parametrize("name", NAMES)
def test_labels_are_large_and_within_their_ranges(name):
    drawn = set()
    for seed in range(60):
        made, label = plant(name, "single", seed)
        one = axis(label.effect, label.parameter)
        assert SMALLEST <= abs(label.size) <= LARGEST
        assert one.low <= label.value <= one.high
        assert one.coordinate(label.value) == pytest.approx(label.size)
        assert made.machine[f"{label.effect}.{label.parameter}"] == label.value
        drawn.add(label.effect)
    assert len(drawn) > 0.8 * len(EFFECTS)
    assert plant(name, "null", 0)[1].effect is None


def test_commands_are_spread_over_the_test_space():
    drawn = commands("smooth", "null", 1)
    assert drawn == sorted(drawn)
    assert -0.2 <= drawn[0] < -0.1 < 0.2 < drawn[-1] <= 0.3
    assert drawn != commands("smooth", "null", 2)


def test_a_case_has_each_protocol_twice_with_other_noise():
    case = cases("stiff", "null", 1, protocols=("air_coast",), trots=0)
    assert [name for name, _ in case.protocols] == ["air_coast"] * 2
    (_, one), (_, other) = case.protocols
    assert not (one["q"] == other["q"]).all()


def test_a_plant_is_a_backend_with_protocols(author):
    backend = PlantBackend(Plant(author, Machine()))
    assert isinstance(backend, Backend)
    assert isinstance(backend, HasProtocols)
    far, near = (backend.run("air_coast", {"amplitude": amplitude}, 1)["q"] for amplitude in (1.0, 0.5))
    assert near[:300, 1].max() < far[:300, 1].max() - 0.2
    assert len({backend.model_hash, PlantBackend(Plant(author, healthy(rng()))).model_hash}) == 2
