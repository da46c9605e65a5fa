"""Residuals: next to nothing in the nominal simulator, and every family of effects where it acts."""

import ast
import time
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.ndimage import convolve1d

import s2r_sim
from s2r_sim import SimBackend
from s2r_sim.backend import _ONLOOKERS
from s2r_sim.effects import with_effects
from s2r_sim.parameters import read_test
from s2r_sim.plant import mujoco_model
from s2r_sim.plant.physics import Physics
from s2r_sim.residuals import RESIDUALS, WINDOW, residuals
from s2r_sim.residuals.ground import footing, ground_compliance
from s2r_sim.residuals.motion import hann, recorded_motion
from s2r_sim.residuals.world import ModelledMotion
from s2r_sim.robot.constants import LEGS
from s2r_sim.settings import Settings
from s2r_spec.backend import HasResiduals
from s2r_spec.errors import TraceError
from s2r_spec.trace import Trace
from tests.errors import naming

SIM = SimBackend(duration=0.8, settings=Settings(warm_up=0.5))
# Two to five times what a nominal rollout shows at vd = 0.3 m/s, mean absolute value over time and columns, in the
# channels' units.
NOMINAL = {
    "joint_torque": 0.09, "base_force": 0.3, "base_torque": 0.1, "motor": 0.003, "acceleration": 0.3,
    "velocity_estimate": 0.004, "slip": 0.005, "grip": 0.15, "sinking": 0.0006, "contact_timing": 0.1,
    "unevenness": 5e-5,
    "joint_speed": 0.06, "foot_place": 1e-6,
}  # fmt: skip


def size(values):
    """Not the mean square: an impact in the middle of a tick leaves a spike."""
    return float(np.mean(np.abs(values)))


@cache
def plain(vd=0.3, seed=1):
    """Return a walk of the nominal machine."""
    return SIM.rollout({"vd": vd}, seed)


@pytest.fixture(scope="module")
def nominal():
    return SIM.residuals(plain(), {"vd": 0.3})


@cache
def walked(effect, values):
    """Return a machine with one effect, of (name, value), and its walk: several tests look at the same one."""
    machine = SIM.with_effects({effect: dict(values)})
    return machine, machine.rollout({"vd": 0.3}, seed=1)


@cache
def residuals_of(effect, values, known=False):
    """Return what is left of such a walk, in a simulator that knows the effect or does not."""
    machine, trace = walked(effect, values)
    return (machine if known else SIM).residuals(trace, {"vd": 0.3})


def of(effects, params=None, known=None):
    params = {"vd": 0.3} | (params or {})
    return SIM.residuals(SIM.with_effects(effects).rollout(params, seed=1), known or {"vd": 0.3})


@pytest.mark.parametrize(("vd", "seed"), [(0.3, 0), (-0.2, 5), (0.0, 9)])
def test_the_nominal_simulator_leaves_next_to_nothing(vd, seed):
    assert isinstance(SIM, HasResiduals)
    found = SIM.residuals(SIM.rollout({"vd": vd}, seed), {"vd": vd})
    assert {
        name: size(values) for name, values in found.channels.items() if size(values) > NOMINAL[name]
    } == {}
    assert found.channels.keys() == NOMINAL.keys() == found.units.keys()
    for name, parts in found.meta["parts"].items():
        assert len(parts) == found[name].shape[1]


@pytest.mark.parametrize(
    ("effect", "values", "shows", "quiet"),
    [
        ("motor_strength", {"factor": 0.85}, ("motor", "acceleration"), ("joint_torque", "base_force")),
        ("latency", {"delay": 0.004}, ("motor",), ("joint_torque", "base_force", "velocity_estimate")),
        ("torque_constant", {"factor": 0.85}, ("joint_torque",), ("motor", "base_force")),
        ("dry_friction", {"torque": 0.5}, ("joint_torque",), ("motor", "base_force")),
        ("armature", {"inertia": 0.01}, ("joint_torque",), ("motor", "base_force", "slip")),
        ("payload", {"mass": 2.0, "x": 0.05}, ("base_force",), ("motor", "joint_torque", "velocity_estimate")),
        ("com_offset", {"x": 0.03, "y": 0.02}, ("base_torque",), ("motor", "joint_torque")),
        ("foot_drag", {"coefficient": 10.0}, ("base_force", "joint_torque"), ("motor",)),
        ("soft_ground", {"sink": 0.01}, ("sinking",), ("motor", "base_force", "joint_torque")),
        ("roughness", {"height": 0.004}, ("unevenness",), ("motor",)),
        ("slope", {"angle": 4.0}, ("sinking",), ("motor",)),
        ("shear_creep", {"stiffness": 0.01}, ("slip",), ("motor", "base_force", "joint_torque")),
        ("ground_friction", {"factor": 0.2}, ("grip", "slip"), ("motor", "joint_torque")),
        ("backlash", {"half_gap": 0.02}, ("joint_torque", "foot_place", "slip"), ("sinking",)),
        ("velocity_bias", {"forward": 0.05, "left": -0.03}, ("velocity_estimate",),
         ("motor", "joint_torque", "base_force")),
        ("encoder_offset", {"hip": 0.03, "calf": -0.02},
         ("joint_torque", "base_torque", "foot_place"), ("motor", "sinking")),
        ("attitude_bias", {"pitch": 3.0}, ("acceleration", "foot_place"), ("motor", "sinking")),
    ],
)  # fmt: skip
def test_every_effect_shows_where_it_acts_and_not_elsewhere(nominal, effect, values, shows, quiet):
    found = residuals_of(effect, tuple(values.items()))
    for name in shows:
        assert size(found[name]) > 2 * size(nominal[name]), name
    for name in quiet:
        assert size(found[name]) < 1.5 * size(nominal[name]), name


KNOWN = [
    # effect, values, residual: nominal ones are N times as large as a nominal rollout's, those of the simulator
    # with the effect at most n times
    ("motor_strength", {"factor": 0.85}, "motor", 100, 2),
    ("motor_strength", {"factor": 0.85}, "acceleration", 2, 1.5),
    ("strength_decay", {"rate": 0.1}, "motor", 50, 2),
    ("torque_speed_line", {"voltage": 0.25}, "motor", 50, 3),
    ("latency", {"delay": 0.005}, "motor", 100, 3),
    ("backlash", {"half_gap": 0.02}, "joint_torque", 15, 8),
    ("backlash", {"half_gap": 0.02}, "base_force", 20, 15),
    ("encoder_offset", {"hip": 0.03, "calf": -0.02}, "joint_torque", 4, 2),
    ("encoder_offset", {"hip": 0.03, "calf": -0.02}, "base_torque", 5, 2),
    ("encoder_offset", {"hip": 0.03, "calf": -0.02}, "foot_place", 1000, 2),
    ("torque_constant", {"factor": 0.85}, "joint_torque", 10, 2),
    ("torque_constant", {"factor": 0.85}, "acceleration", 3, 1.5),
    ("dry_friction", {"torque": 0.5}, "joint_torque", 10, 4),
    ("viscous_friction", {"coefficient": 0.5}, "joint_torque", 10, 2),
    ("armature", {"inertia": 0.01}, "joint_torque", 10, 2),
    ("foot_drag", {"coefficient": 10.0}, "base_force", 20, 5),
    ("foot_drag", {"coefficient": 10.0}, "joint_torque", 5, 2),
    ("ground_friction", {"factor": 0.2}, "grip", 300, 5),
    ("shear_creep", {"stiffness": 0.01}, "slip", 5, 3),
    ("soft_ground", {"sink": 0.01}, "sinking", 10, 2),
    ("slope", {"angle": 4.0}, "sinking", 15, 2),
    ("payload", {"mass": 2.0, "x": 0.05}, "base_force", 30, 1.5),
    ("payload", {"mass": 2.0, "x": 0.05}, "base_torque", 5, 2),
    ("payload", {"mass": 2.0, "x": 0.05}, "acceleration", 3, 1.5),
    ("com_offset", {"x": 0.03, "y": 0.02}, "base_torque", 10, 2),
    ("velocity_bias", {"forward": 0.05, "left": -0.03}, "velocity_estimate", 10, 2),
    ("velocity_scale", {"factor": 1.2}, "velocity_estimate", 10, 2),
    ("attitude_bias", {"pitch": 3.0}, "acceleration", 2.5, 2.5),
    ("attitude_bias", {"roll": 2.0, "pitch": 3.0}, "joint_torque", 5, 2),
    ("attitude_bias", {"roll": 2.0, "pitch": 3.0}, "foot_place", 1000, 2),
]


@pytest.mark.parametrize(("effect", "values", "residual", "without", "knowing"), KNOWN)
def test_a_simulator_that_knows_an_effect_leaves_little_of_it(
    nominal, effect, values, residual, without, knowing
):
    # No foot of a nominal rollout slides: its grip is nothing at all.
    usual = size(nominal[residual]) or 0.005
    of_it = effect, tuple(values.items())
    assert size(residuals_of(*of_it)[residual]) > without * usual
    assert size(residuals_of(*of_it, known=True)[residual]) < knowing * usual


@pytest.mark.parametrize(
    "vd", [pytest.param(-0.2, marks=pytest.mark.slow), pytest.param(0.1, marks=pytest.mark.slow), 0.3]
)
def test_the_roughness_that_footholds_ask_for_is_that_of_the_ground(vd):
    machine = SIM.with_effects({"roughness": {"height": 0.003}})
    asked = []
    for seed in range(12):
        trace = machine.rollout({"vd": vd}, seed)
        bare, known = (sim.residuals(trace, {"vd": vd})["unevenness"] for sim in (SIM, machine))
        asked.append(0.003 * bare.mean() / (bare - known).mean())
    # One patch of ground of half a metre says it to a fifth or, where the robot hardly moves, to the half.
    error = np.std(asked) / np.sqrt(len(asked))
    assert abs(np.mean(asked) - 0.003) < 3 * error < 0.003


def test_a_slope_is_no_roughness_and_feet_that_never_stood_say_nothing():
    sloped = residuals_of("slope", (("angle", 4.0),))
    assert np.abs(sloped["unevenness"]).mean() < 1e-4
    for stood in (np.zeros((5, 4)), np.eye(5, 4)):
        found = footing(stood, np.zeros((5, 4)), np.zeros((5, 4)))
        assert found.spread(found.expected).tolist() == np.zeros((5, 4)).tolist()


def test_a_foothold_that_was_not_recorded_takes_no_other_with_it():
    _, trace = walked("roughness", (("height", 0.004),))
    whole = SIM.residuals(trace, {"vd": 0.3})["unevenness"]
    for name in ("foot_position", "foot_force"):
        holed = trace[name].copy()
        holed[100:110] = np.nan
        found = SIM.residuals(
            Trace(trace.times, dict(trace.channels) | {name: holed}, trace.units), {"vd": 0.3}
        )["unevenness"]
        assert np.isfinite(found).all()
        assert found.mean() == pytest.approx(whole.mean(), rel=0.1)


def test_footholds_are_told_foot_by_foot_and_stand_by_stand():
    touches = np.array([[1, 0], [1, 0], [0, 1], [1, 1]])
    x = np.array([[0.0, 9.0], [0.2, 9.0], [9.0, 0.3], [0.4, 0.5]])
    found = footing(touches, x, x)
    assert found.of.tolist() == [[0, -1], [0, -1], [-1, 2], [1, 2]]
    assert found.mean(x) == pytest.approx([0.1, 0.4, 0.4])
    # All on one line: there is no more than a line through them, and nothing is left of a slope.
    assert found.about @ found.mean(x) == pytest.approx(0.0, abs=1e-12)


def test_noise_of_a_velocity_is_no_slide():
    rng = np.random.default_rng(0)

    def lacking(trace, knowing):
        of = {"dq": 0.1, "vx": 0.02, "vy": 0.02, "foot_velocity": 0.02}
        noisy = {
            name: values + of.get(name, 0.0) * rng.normal(size=values.shape)
            for name, values in trace.channels.items()
        }
        return size(
            knowing.residuals(Trace(trace.times, noisy, trace.units, trace.meta), {"vd": 0.3})["grip"]
        )

    slippery, trace = walked("ground_friction", (("factor", 0.2),))
    bare = lacking(trace, SIM)
    assert lacking(plain(), SIM) < 0.05 * bare
    assert lacking(trace, slippery) < 0.05 * bare


def test_a_residual_is_shown_every_field_of_the_world_that_changes_it():
    """What it is not shown it takes for nominal, in silence: so here all fields at once, and one by one."""
    trace = plain()
    log = recorded_motion(trace, SIM.settings.robot)
    test, bare = read_test({"vd": 0.3}), SIM.settings.physics
    ends = [
        {e.name: {p.name: p.low if p.low != p.nominal else p.high for p in e.parameters}}
        for e in SIM.effects()
    ]
    everything = {name: values for one in ends for name, values in one.items()}
    for values in (everything, *ends):
        added = SIM.with_effects(values).added
        here = test.world(with_effects(bare, added))
        asked = residuals(trace, SIM.settings, added, {"vd": 0.3})
        window = hann(trace.times, WINDOW)
        half, n = len(window) // 2, len(trace) - 1
        for one in RESIDUALS:
            whole = one.of(ModelledMotion(log, SIM.settings.gains, test.world(bare), here, test))
            smooth = convolve1d(whole, window, axis=0)[half : n - half]
            np.testing.assert_array_equal(asked[one.name], smooth, err_msg=f"{one.name} {values}")


def test_rotors_in_their_play_are_turned_by_what_the_current_truly_makes(nominal):
    machine = SIM.with_effects({"backlash": {"half_gap": 0.02}, "torque_constant": {"factor": 0.7}})
    trace = machine.rollout({"vd": 0.3}, seed=1)
    for name in ("joint_torque", "base_torque"):
        left = size(machine.residuals(trace, {"vd": 0.3})[name])
        assert left < 10 * size(nominal[name]), name
        assert left < size(SIM.residuals(trace, {"vd": 0.3})[name]) / 2, name


@pytest.mark.parametrize("sink", [0.0, 0.01, 0.03])
def test_a_ball_sinks_as_deep_as_in_the_physics_engine(sink):
    """A robot that stands on stiff joints, long enough for nothing to move."""
    robot = SIM.settings.robot
    model = mujoco_model.build(robot, Physics(sink=sink))
    data = mujoco.MjData(model)
    model.actuator_biasprm[:, 1:3] = (-400.0, -20.0)
    knee = np.arccos((0.28 - robot.foot_radius) / (robot.thigh_length + robot.calf_length))
    data.qpos[:3], data.qpos[3:7] = (0.0, 0.0, 0.28), (1.0, 0.0, 0.0, 0.0)
    data.qpos[7:] = np.tile([0.0, knee, -2.0 * knee], 4)
    data.ctrl[:] = 400.0 * data.qpos[7:]
    mujoco.mj_step(model, data, 3000)
    feet = [model.geom(f"{leg.name}_foot").id for leg in LEGS]
    depth = robot.foot_radius - data.geom_xpos[feet, 2]
    force = np.array(data.sensordata).reshape(4, 3)[:, 2]
    assert np.abs(data.qvel[:3]).max() < 1e-3
    expected = ground_compliance(robot, Physics.impratio, sink).depth_under(force)
    np.testing.assert_allclose(depth, expected, rtol=0.02)


def test_effects_that_are_known_together_leave_little_together(nominal):
    machine = SIM.with_effects(
        {
            "motor_strength": {"factor": 0.9},
            "backlash": {"half_gap": 0.01},
            "latency": {"delay": 0.003},
            "viscous_friction": {"coefficient": 0.3},
            "payload": {"mass": 1.0},
        }
    )
    trace = machine.rollout({"vd": 0.3}, seed=1)
    bare, knowing = SIM.residuals(trace, {"vd": 0.3}), machine.residuals(trace, {"vd": 0.3})
    # The speed of a rotor that hits a flank within a tick is not recorded, and the motor law needs it.
    for name, without, with_them in (("motor", 100, 15), ("joint_torque", 10, 6), ("base_force", 10, 8)):
        assert size(bare[name]) > without * size(nominal[name]), name
        assert size(knowing[name]) < with_them * size(nominal[name]), name


def test_a_residual_does_not_depend_on_what_was_asked_before(nominal):
    machines = [SIM.with_effects({"slope": {"angle": a}, "payload": {"mass": 1.0}}) for a in (-3.0, 0.0, 5.0)]
    trace = plain()
    asked = [machine.residuals(trace, {"vd": 0.3}) for machine in machines]
    copied = Trace(trace.times, trace.channels, trace.units)
    for machine, before in zip(reversed(machines), reversed(asked), strict=True):
        after = machine.residuals(copied, {"vd": 0.3})
        assert all(before[name].tobytes() == after[name].tobytes() for name in before.channels)


def test_a_payload_weighs_what_it_weighs():
    x, y, z = of({"payload": {"mass": 1.0}})["base_force"].mean(axis=0)
    assert z == pytest.approx(-9.81, abs=0.2)
    assert abs(x) < 0.5
    assert abs(y) < 0.5


def test_a_hidden_push_shows_in_its_window_and_a_declared_one_does_not(nominal):
    push = {"push": 3.0, "push_time": 0.4, "push_towards": 0.0}
    found = of({}, push)
    ahead = found["base_force"][:, 0]
    inside = (found.times >= 0.4 - 0.015) & (found.times <= 0.45 + 0.015)
    assert np.sum(ahead[inside]) / 500 == pytest.approx(3.0, rel=0.05)
    assert size(ahead[~inside]) < 2 * size(nominal["base_force"][:, 0])
    known = of({}, push, {"vd": 0.3} | push)["base_force"][:, 0]
    assert size(known) < 2 * size(nominal["base_force"][:, 0])


def test_a_declared_payload_and_slope_leave_little(nominal):
    world = {"vd": 0.3, "payload": 2.0, "slope": 4.0}
    known, hidden = of({}, world, world), of({}, world)
    assert size(known["base_force"]) < size(hidden["base_force"]) / 10
    assert size(known["sinking"]) < 2 * size(nominal["sinking"]) < size(hidden["sinking"]) / 5


def test_what_cannot_be_computed_is_left_out_and_nothing_at_all_is_said():
    trace = plain(0.1, 0)
    assert SIM.residuals(trace.only(["vx", "vy", "vx_est", "vy_est"])).channels.keys() == {
        "velocity_estimate"
    }
    fewest = min(RESIDUALS, key=lambda one: len(one.needs))
    with pytest.raises(TraceError, match=naming("vx", f"'{fewest.name}'", *fewest.needs)):
        SIM.residuals(trace.only(["vx"]))
    short = Trace(trace.times[:5], {name: values[:5] for name, values in trace.channels.items()})
    with pytest.raises(TraceError, match=r"\d+ samples.*\b5\b"):
        SIM.residuals(short)


def test_what_rotors_do_in_their_gears_is_no_slide_of_a_foot_that_is_seen():
    _, trace = walked("backlash", (("half_gap", 0.02),))
    by_joints = trace.only([name for name in trace.channels if name != "foot_velocity"])
    seen, told = (size(SIM.residuals(each, {"vd": 0.3})["grip"]) for each in (trace, by_joints))
    assert seen < 0.05 * told
    # A sample that was not seen is by the joints.
    gone = trace["foot_velocity"].copy()
    gone[100:200] = np.nan
    holed = Trace(trace.times, dict(trace.channels) | {"foot_velocity": gone}, trace.units)
    assert seen < size(SIM.residuals(holed, {"vd": 0.3})["grip"]) < told


@cache
def of_channels(*left_out):
    """Return the residuals of a walk of which some channels were not recorded."""
    trace = plain(0.1, 0)
    return SIM.residuals(trace.only([name for name in trace.channels if name not in left_out]))


@pytest.mark.parametrize("one", RESIDUALS, ids=lambda one: one.name)
def test_a_residual_needs_no_channel_but_those_that_it_lists(one):
    machine = SIM.with_effects(
        {
            effect.name: {p.name: 0.9 * p.nominal + 0.1 * p.high for p in effect.parameters}
            for effect in SIM.effects()
        }
    )
    few = plain(0.1, 0).only(list(one.needs))
    alone = SIM.residuals(few)[one.name]
    np.testing.assert_array_equal(alone, of_channels("foot_velocity")[one.name])
    # Feet that are seen from outside move as the joints have it, if nothing is wrong with the encoders.
    np.testing.assert_allclose(alone, of_channels()[one.name], atol=2e-3)
    assert np.isfinite(machine.residuals(few)[one.name]).all()


def test_it_is_cheap_and_pure():
    trace = plain(0.1, 0)
    first, spent = SIM.residuals(trace), []
    for _ in range(5):
        copied = Trace(trace.times, trace.channels, trace.units)
        begin = time.process_time()
        again = SIM.residuals(copied)
        spent.append(time.process_time() - begin)
        assert all(first[name].tobytes() == again[name].tobytes() for name in first.channels)
    assert min(spent) < 0.5 * SIM.cost


def test_what_looks_on_decides_no_trace():
    package = Path(s2r_sim.__file__).parent
    onlookers = {f"s2r_sim.{name.removesuffix('.py')}" for name in _ONLOOKERS}
    for path in package.rglob("*.py"):
        imported = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                imported |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
            elif isinstance(node, ast.Import):
                imported |= {name.name for name in node.names}
        imported = {".".join(name.split(".")[:2]) for name in imported}
        first = path.relative_to(package).parts[0]
        assert not imported & onlookers or first in {*_ONLOOKERS, "backend.py"}, path


def test_a_protocol_s_trace_has_residuals_with_the_protocol_s_parameters():
    trace = SIM.run("air_coast", {"amplitude": 0.5}, 0)
    found = SIM.residuals(trace, trace.meta["params"])
    assert np.array_equal(found["joint_torque"], SIM.residuals(trace)["joint_torque"])
    assert np.abs(found["joint_torque"]).mean() < 0.2
