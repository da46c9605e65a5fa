"""The loop of a log beside that of the files: each simple mistake is named, and no physics is taken for one."""

import json
from pathlib import Path

import numpy as np
import pytest

from s2r_mujoco.interface.mistakes import judged
from s2r_spec import logs
from s2r_spec.diagnose import diagnose
from s2r_spec.trace import Trace
from tests.mujoco.robots import SPIN, robot

TOML = (
    "decimation = 4\nduration = 1.0\n"
    'observation = ["base_lin_vel", "base_ang_vel", "projected_gravity", "joint_pos_rel", '
    '{ term = "joint_vel", scale = 0.05 }, "last_action", { phase = 1.5, unit = "Hz" }]\n'
    + SPIN
    + "action = { scale = 0.1, stiffness = 3, damping = 0.08 }\ndefault_joint_pos = { '.*' = 0.2 }\n"
)
WIDTH = 23
PLACES = {
    "base_lin_vel": slice(0, 3), "base_ang_vel": slice(3, 6), "projected_gravity": slice(6, 9),
    "joint_pos_rel": slice(9, 13), "joint_vel": slice(13, 17), "last_action": slice(17, 21),
}  # fmt: skip


@pytest.fixture
def box(tmp_path):
    return robot(tmp_path, TOML, WIDTH)


def changed(trace, name, change):
    """Return a log in which a channel, or the place of a term in ``obs``, holds something else."""
    values = np.array(trace["obs"] if name in PLACES else trace[name])
    place = (slice(None), PLACES[name]) if name in PLACES else ...
    values[place] = change(values[place])
    channels = {key: np.asarray(trace[key]) for key in trace.channels}
    return Trace(trace.times, channels | {"obs" if name in PLACES else name: values}, trace.units, trace.meta)


def wrong(backend, trace):
    return [one for one in backend.loop(trace) if one.level == "wrong" and one.topic != "action"]


def test_a_log_of_the_files_own_loop_holds_every_equation(box):
    found = list(box.loop(box.rollout({}, 1)))
    assert [one.topic for one in found if one.level == "ok"] == ["observation", "action", "target", "torque"]
    assert not [one for one in found if one.level != "ok"]


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("base_ang_vel", lambda x: 0.25 * x, "0.25 times"),
        ("base_ang_vel", lambda x: np.degrees(x), "degrees"),
        ("projected_gravity", lambda x: -x, "sign is wrong"),
        ("joint_vel", lambda x: 20.0 * x, "20 times"),
        ("base_lin_vel", lambda x: 0.0 * x, "always zero"),
        ("last_action", lambda x: 0.0 * x, "always zero"),
        ("joint_pos_rel", lambda x: x[:, [1, 0, 3, 2]], "fl holds fr, fr holds fl, rl holds rr, rr holds rl"),
        ("joint_pos_rel", lambda x: x + 0.2, "default pose"),
        ("joint_pos_rel", lambda x: x * [1, -1, 1, -1], "wrong sign in fr, rr"),
        ("joint_vel", lambda x: np.concatenate([x[:2], x[:2], x[2:-2]]), None),
        ("joint_vel", lambda x: np.concatenate([x[:1], x[:1], x[:-2]]), "2 ticks late"),
        ("target", lambda x: 0.2 + 0.5 * (x - 0.2), "0.5 times"),
        ("target", lambda x: x[:, [1, 0, 3, 2]], "fl holds fr"),
    ],
)
def test_a_mistake_is_named_with_its_term(box, name, change, words):
    found = wrong(box, changed(box.rollout({}, 1), name, change))
    first = next(one for one in found if one.words.startswith(name))
    assert words is None or words in first.words
    assert words is None or first.certain == ("late" not in words)


def test_a_vector_in_axes_of_the_world_is_named(box):
    trace = box.rollout({}, 1)
    w, v = trace["quaternion"][:, :1], trace["quaternion"][:, 1:]
    omega = trace["omega"]
    turned = omega + 2.0 * np.cross(v, w * omega + np.cross(v, omega))
    (one,) = wrong(box, changed(trace, "base_ang_vel", lambda x: turned))
    assert "axes of the world" in one.words


def test_a_mistake_that_begins_later_has_its_time(box):
    def late(x):
        x[30:] *= -1.0
        return x

    (one,) = wrong(box, changed(box.rollout({}, 1), "base_ang_vel", late))
    assert "sign is wrong" in one.words
    assert "from t = 0.6 s on" in one.words


def test_other_gains_are_those_of_least_squares(box):
    stiff = [p.name for e in box.effects() if e.name == "kp" for p in e.parameters]
    trace = box.with_effects({"kp": dict.fromkeys(stiff, 1.5)}).rollout({}, 1)
    (one,) = wrong(box, trace)
    assert one.topic == "torque"
    assert all("kp 4.5 for 3, kd 0.08 for 0.08" in row for row in one.table)
    assert not one.certain  # a weak motor looks the same


def test_a_torque_from_before_the_target_of_the_tick_has_its_gains(box):
    trace = box.rollout({}, 1)
    before = np.concatenate([trace["target"][:1], trace["target"][:-1]])
    late = 3.0 * (before - trace["q"]) - 0.08 * trace["dq"]
    (one,) = (one for one in box.loop(changed(trace, "tau", lambda x: late)) if one.topic == "torque")
    assert one.level == "ok"
    assert "tick before" in one.words


def test_a_log_of_another_rate_is_not_judged(box):
    trace = box.rollout({}, 1)
    channels = {name: np.repeat(np.asarray(trace[name]), 10, axis=0) for name in trace.channels}
    times = np.arange(len(channels["q"])) * 0.002
    (one,) = box.loop(Trace(times, channels, trace.units, trace.meta))
    assert one.level == "note"
    assert "every 2 ms" in one.words
    assert "20 ms" in one.words


def test_gains_that_a_log_does_not_show_are_not_called_right(box):
    trace = changed(box.rollout({}, 1), "tau", lambda x: 0.0 * x)
    assert not [one for one in box.loop(trace) if one.topic == "torque"]


def test_no_physics_is_a_certain_mistake_of_the_loop(box):
    for effect in box.effects():
        for p in effect.parameters:
            for value in {p.low, 0.5 * (p.nominal + p.high)} - {p.nominal}:
                twin = box.with_effects({effect.name: {p.name: value}})
                certain = [one.words for one in box.loop(twin.rollout({}, 2)) if one.certain]
                assert not certain, (effect.name, p.name, value, certain)


def test_a_log_without_a_channel_says_what_it_cannot_check(box):
    trace = box.rollout({}, 1)
    found = list(box.loop(trace.only(["obs", "action"])))
    assert [one.topic for one in found if one.level == "ok"] == ["observation", "action"]
    assert "base_lin_vel" in found[0].words
    assert found[0].level == "note"


def test_rounded_logs_and_short_ones_are_no_mistakes():
    rng = np.random.default_rng(0)
    e = rng.normal(size=(200, 3))
    assert judged("x", e, np.round(e, 3), "abc").holds
    assert judged("x", e, e.astype(np.float32).astype(float), "abc").holds
    assert judged("x", e[:4], -e[:4], "abc").holds  # too few to tell
    assert judged("x", e, 1.005 * e, "abc").mistake is None  # a part in 200 is no mistake of a file
    noisy = judged("x", e, e + 0.1 * rng.normal(size=e.shape), "abc")
    assert not noisy.holds
    assert noisy.mistake is None


def test_a_factor_of_a_constant_is_seen():
    command = np.tile([0.5, 0.0, 0.0], (50, 1))
    found = judged("velocity_commands", command, 2.0 * command, "xyz")
    assert found.mistake is not None
    assert "2 times" in found.mistake.words


def test_the_command_and_a_diagnosis_say_it_before_any_estimate(box, tmp_path, s2r):
    (tmp_path / "calm.stl").write_text("signal roll {rad}\nrequire calm: always[0, 0.5 s] (abs(roll) <= 4)\n")
    (tmp_path / "run").mkdir()
    for k in range(6):
        logs.write(changed(box.rollout({}, k), "joint_vel", lambda x: -x), tmp_path / "run" / f"{k}.npz")
    done = s2r("backends", "robot.toml", "--log", "run", code=1)
    assert "joint_vel is -1 times as large: the sign is wrong" in done.stdout
    found = s2r.json("backends", "robot.toml", "--log", "run", code=1)
    assert found["recordings"] == 6
    assert any(one["certain"] for one in found["loop"])
    assert s2r.json("backends", "robot.toml", "--log", "run/0.npz", code=1)["recordings"] == 1
    (tmp_path / "run" / "rollouts.csv").write_text("id\n" + "".join(f"{k}\n" for k in range(6)))
    answer = diagnose("calm.stl", "robot.toml", "log:run", cache=tmp_path / "cache")
    assert answer.exit_code == 3
    assert not answer.tuned
    assert [one.code for one in answer.evidence.findings] == ["loop"]
    refused = s2r("backends", "turtlebot", "--log", "run", code=2).stderr
    assert "robot files" in refused


def test_the_page_has_the_counts_of_the_benchmark():
    root = Path(__file__).parents[2]
    kept = json.loads((root / "benchmarks" / "results" / "go1_loops.json").read_text())
    page = (root / "docs" / "how-to" / "policies.md").read_text()
    rows = {
        cells[1].strip(): cells[2:4]
        for cells in (line.split("|") for line in page.splitlines())
        if len(cells) == 5
    }
    for key, words in (
        ("check", "everything, by the equations alone"), ("all", "everything"),
        ("target", "the state and the targets"), ("tau", "the state and the torques"),
    ):  # fmt: skip
        assert [cell.strip() for cell in rows[words]] == [*kept[key].values()]
    sixty = json.loads((root / "benchmarks" / "results" / "go1_sixty.json").read_text())
    for kind, words in (
        ("interface", "a mistake alone"), ("physics", "an effect alone"), ("pair", "a mistake and an effect"),
        ("unknown", "a cause outside the catalogue"), ("nothing", "nothing"),
    ):  # fmt: skip
        assert [cell.strip() for cell in rows[words]] == [sixty["right"][kind], sixty["a false name"][kind]]
    named = sixty["true sizes of the named effects in the 90 % interval"]
    assert f"{named} sizes" in page


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('{ term = "joint_vel", scale = 0.05 }', '{ term = "joint_vel", scale = 0.05, order = [1, 0, 3, 2] }'),
        ('"base_ang_vel"', '{ term = "base_ang_vel", late = 2 }'),
        ('"base_lin_vel"', '{ term = "base_lin_vel", frame = "world" }'),
        ("scale = 0.1", "scale = 0.1, order = [3, 2, 1, 0]"),
    ],
)  # fmt: skip
def test_a_file_can_state_the_loop_of_a_machine_with_a_mistake(tmp_path, before, after):
    """The check finds the mistake of such a machine beside the right file, and nothing beside its own."""
    (tmp_path / "right").mkdir()
    (tmp_path / "wrong").mkdir()
    assert before in TOML
    right, other = (
        robot(tmp_path / "right", TOML, WIDTH),
        robot(tmp_path / "wrong", TOML.replace(before, after), WIDTH),
    )
    log = other.rollout({}, 1)
    assert not wrong(other, log)
    assert len(wrong(right, log)) == 1


LACKING = ("obs", "action", "target")


def bare(trace, without=LACKING):
    """Return a log without some channels."""
    channels = {key: np.asarray(trace[key]) for key in trace.channels if key not in without}
    units = {key: unit for key, unit in trace.units.items() if key in channels}
    return Trace(trace.times, channels, units, trace.meta)


@pytest.mark.parametrize(
    ("name", "without"),
    [
        ("joint_pos_rel has the wrong sign", LACKING),
        ("target has 2 times the scale of the action", LACKING),
        ("base_ang_vel is 0.25 times as large", ("obs", "action")),
        ("last_action is 1 tick late", ("obs", "action")),
        ("phase runs 2 times as fast", ("obs", "action")),
        ("projected_gravity is always zero", ("obs",)),
        ("target has 2 times the scale of the action", ("obs",)),
    ],
)
def test_the_policy_on_the_logged_state_says_which_mistake_a_log_has(box, name, without):
    mistakes = {one.name: other for one, other in box.mistakes().items()}
    found = box.replayed([bare(mistakes[name].rollout({}, seed), without) for seed in range(2)])
    assert [one.name for one in found.mistakes] == [name]
    assert found.explained
    assert found.probability > 0.95


def test_two_mistakes_are_found_together(box):
    mistakes = {one.name: one for one in box.mistakes()}
    first = box.with_mistakes([mistakes["joint_vel is 20 times as large"]])
    second = {one.name: one for one in first.mistakes()}["target has 0.5 times the scale of the action"]
    found = box.replayed([bare(first.with_mistakes([second]).rollout({}, seed)) for seed in range(3)])
    names = {one.name for one in found.mistakes}
    assert names == {"joint_vel is 20 times as large", "target has 0.5 times the scale of the action"}


@pytest.mark.parametrize(
    ("effect", "parameter"),
    [
        ("action_delay", "time"), ("observation_delay", "time"), ("actuator_lag", "time"), ("kp", "joint"),
        ("imu_tilt", "pitch"),
    ],
)  # fmt: skip
def test_no_physics_is_a_mistake_of_the_loop_of_a_log_with_torques_alone(box, effect, parameter):
    one = next(p for e in box.effects() if e.name == effect for p in e.parameters if p.name == parameter)
    for value in {one.low, one.high} - {one.nominal}:
        worn = box.with_effects({effect: {parameter: value}})
        found = box.replayed([bare(worn.rollout({}, seed)) for seed in range(2)])
        assert not (found.mistakes and found.explained and found.probability >= 0.95), found


def _later(trace, first):
    """Return a log that begins some ticks after the reset, with the times of the run."""
    channels = {key: np.asarray(trace[key])[first:] for key in trace.channels}
    return Trace(trace.times[first:], channels, trace.units, trace.meta)


def test_logs_with_different_outputs_are_not_mixed(box):
    mixed = [box.rollout({}, 1), bare(box.rollout({}, 2)), bare(box.rollout({}, 3), ("action",))]
    assert box.replayed(mixed).output == "action"
    assert box.replayed(mixed[1:]).output == "tau"


def test_a_velocity_of_motion_capture_stands_for_that_of_the_base(box):
    found = box.replayed(
        [bare(box.rollout({}, seed), (*LACKING, "velocity", "gravity", "omega")) for seed in range(2)]
    )
    assert found is None  # nothing has the angular velocity
    lacks = (*LACKING, "velocity", "gravity")
    assert box.replayed([bare(box.rollout({}, seed), lacks) for seed in range(2)]).files < 1e-6


def test_a_loop_that_a_log_cannot_show_is_not_judged(box):
    trace = box.rollout({}, 1)
    assert box.replayed([_later(trace, 20)]) is None
    assert box.replayed([bare(trace, (*LACKING, "tau"))]) is None
    assert box.replayed([bare(trace, ("q",))]) is None
    assert box.replayed([Trace(trace.times[::2], {"q": trace["q"][::2]}, {"q": "rad"})]) is None


def test_every_mistake_is_stated_by_keys_of_a_robot_file(box):
    """The keys make another loop, so that a file can reproduce the machine."""
    plain = box.rollout({}, 1)
    mistakes = box.mistakes()
    assert len({one.name for one in mistakes}) == len(mistakes) > 50
    same = [
        one.name for one, other in mistakes.items() if np.array_equal(other.rollout({}, 1)["q"], plain["q"])
    ]
    assert not same
