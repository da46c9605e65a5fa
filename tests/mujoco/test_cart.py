"""A cart-pole with a policy of our own, through the command line: from its files to a certificate."""

import tomllib

import numpy as np
import pytest

from s2r_spec.backend import load_backend
from s2r_spec.diagnose import diagnose
from s2r_spec.errors import UsageError
from tests.errors import naming, states
from tests.mujoco import make_policies
from tests.mujoco.make_policies import HERE
from tests.mujoco.robots import robot

STATE = 'observation = [{ term = "joint_pos", joints = [".*"] }, { term = "joint_vel", joints = [".*"] }]\n'
COMMON = """\
model = "cart.xml"
decimation = 4
duration = 3
parameters.mass = { field = "geom/cart/mass", unit = "kg" }
parameters.kick = { push = "cart", at = "0.5 s", for = "0.1 s", range = [-20, 20] }
start.noise.joint_pos = 0.01
failure.fell = "abs(q) > 40 {deg}"
"""
TOML = f'policy = "cart.onnx"\n{COMMON}{STATE}'
SPEC = """\
signal q {deg}
param mass {g} in [600, 1400]
param kick {N} in [-10, 10]
require up: always[0 s, 2 s] (abs(q) <= 17 {deg})
certify up: delta = 0.05, epsilon = 9, B = 57, R = 1.2, kernel = rbf(1500 {g}, 40 {N}), fall = -30
"""
CONTROL = """\
import numpy as np

K = np.array([8.29, 62.14, 10.08, 11.25])


def act(model, data, command):
    return K @ np.concatenate([data.qpos, data.qvel])
"""


@pytest.fixture
def cart(s2r):
    """A folder with the cart, its policies, ``cart.toml`` and ``up.stl``."""
    for name in ("cart.xml", "cart.onnx", "cart_mjlab.onnx"):
        (s2r.folder / name).write_bytes((HERE / name).read_bytes())
    (s2r.folder / "cart.toml").write_text(TOML)
    (s2r.folder / "up.stl").write_text(SPEC)
    return s2r


def test_the_committed_policies_are_those_of_the_script():
    import onnx

    for name, made in make_policies.policies().items():
        kept = onnx.load(HERE / name)
        assert (HERE / name).stat().st_size < 1000
        np.testing.assert_allclose(make_policies.weights(kept), make_policies.weights(made), rtol=1e-4)
        assert kept.graph.input == made.graph.input
        assert kept.metadata_props == made.metadata_props


def test_the_pole_stays_up_and_the_cart_returns(cart):
    """From 0.2 rad, with the committed policy and with that of mjlab's metadata."""
    for policy in ("cart.onnx", "cart_mjlab.onnx"):
        text = TOML.replace("cart.onnx", policy).replace("= 3\n", "= 6\n").replace("start.noise", "start")
        (cart.folder / "up.toml").write_text(text.replace("joint_pos = 0.01", "joint_pos = { hinge = 0.2 }"))
        trace = load_backend("up.toml").rollout({}, 0)
        assert trace["q"][0] == pytest.approx(0.2)
        assert np.abs([trace[name][-1] for name in ("q", "dq", "q_slide", "dq_slide")]).max() < 0.05
        assert np.abs(trace["q_slide"]).max() < 1.5


def test_metadata_of_the_onnx_file_gives_gains_order_and_scale(cart):
    """mjlab's gains are those of position actuators; its observation is replaced by the robot file's."""
    (cart.folder / "mjlab.toml").write_text(TOML.replace("cart.onnx", "cart_mjlab.onnx"))
    trace = load_backend("mjlab.toml").rollout({}, 3)
    assert trace["target"] == pytest.approx(make_policies.SCALE * trace["action"])
    force = make_policies.KP * (trace["target"] - trace["q_slide"]) - make_policies.KD * trace["dq_slide"]
    assert trace["tau_slide"] == pytest.approx(np.clip(force, -20, 20), abs=1e-9)
    (cart.folder / "own.toml").write_text(TOML.replace("cart.onnx", "cart_mjlab.onnx").replace(STATE, ""))
    with pytest.raises(UsageError, match=naming("cart_mjlab.onnx", "4", "2", "joint_pos_rel 1")):
        load_backend("own.toml")


def test_a_certificate_in_worker_processes_and_what_follows_from_it(cart):
    """Its rollouts are replayed and resumed; a file that is gone or has changed is named."""
    done = cart("check", "up.stl", "-b", "cart.toml", "--workers", 2, "--run", "night", code=0)
    assert states(done.stdout, "HOLDS", "certified", "deg")
    assert states(done.stderr, "cart.xml", "cart.onnx", "mass", "s2r backends cart.toml --check")
    again = cart.json("replay", "night/up#0.0", code=0)
    assert again["same"] is True
    resumed = cart.json("check", "up.stl", "-b", "cart.toml", "--resume", "night", "-q", code=0)
    bound = resumed["results"][0]["worst_expected_robustness"]
    assert f"{bound['lower']:+.4f}"[:6] in done.stdout
    (cart.folder / "cart.xml").rename(cart.folder / "gone.xml")
    assert states(cart("replay", "night/up#0.0", code=2).stderr, "cart.xml")
    (cart.folder / "gone.xml").rename(cart.folder / "cart.xml")
    text = (cart.folder / "cart.xml").read_text()
    (cart.folder / "cart.xml").write_text(text.replace('damping="0.5"', 'damping="0.6"'))
    assert states(cart("replay", "night/up#0.0").stdout, "the model has changed")


def test_a_controller_of_a_few_lines_in_python_is_certified(cart):
    assert len(CONTROL.splitlines()) <= 8
    (cart.folder / "control.py").write_text(CONTROL)
    (cart.folder / "own.toml").write_text('policy = "control.py:act"\n' + COMMON)
    found = cart.json("check", "up.stl", "-b", "own.toml", "-q", code=0)["results"][0]
    assert found["verdict"] == "holds"
    one, other = (load_backend(name).rollout({"kick": 5.0}, 1) for name in ("own.toml", "cart.toml"))
    np.testing.assert_allclose(one["q"], other["q"], atol=1e-3)


def test_a_gap_to_a_twin_that_an_option_makes(cart):
    """Friction of the slide, which the specification does not sweep; an option that it sweeps has no effect."""
    rub = 'parameters.rub = { field = "joint/slide/frictionloss", range = [0, 5] }\n'
    (cart.folder / "cart.toml").write_text(TOML + rub)
    words = ("gap", "up.stl", "--sim", "cart.toml", "--budget", 16, "-q", "--real")
    assert abs(cart.json(*words, "cart.toml:rub=3", code=3)["worst"]["mean"]) > 0.5
    twin, own = load_backend("cart.toml:rub=3"), load_backend("cart.toml")
    assert twin.model_hash != own.model_hash
    assert not np.array_equal(twin.rollout({}, 3)["q"], own.rollout({}, 3)["q"])
    assert states(cart(*words, "cart.toml:ru=3", code=2).stderr, "'ru'", "did you mean 'rub'")
    assert states(cart(*words, "cart.toml:mass=1.3", code=2).stderr, "cart.toml:mass=1.3", "no effect")


def test_settings_and_effort_for_a_robot_file(cart):
    assert states(
        cart("pilot", "up.stl", "-b", "cart.toml", "--budget", 24, "-q", code=0).stdout, "certify up:"
    )
    planned = cart("plan", "up.stl", "-b", "cart.toml", code=0)
    assert states(planned.stdout, "expected", "rollouts")


def test_backends_describes_and_checks_a_robot_file(cart):
    described = cart.json("backends", "cart.toml", code=0)
    assert [one["name"] for one in described["parameters"]] == ["mass", "kick"]
    assert {"q", "q_slide", "obs", "angle"} <= {one["name"] for one in described["channels"]}
    checked = cart("backends", "cart.toml", "--check", code=0).stdout
    assert "BROKEN" not in checked
    assert "WRONG" not in checked
    assert states(checked, "cart.xml", "cart.onnx", "joint_pos 2, joint_vel 2", "slide")
    flight = cart.json("backends", "cart.toml", "--check", code=0)["preflight"]
    assert {"files", "observation", "joints", "torque", "terms"} <= {one["topic"] for one in flight}


@pytest.mark.parametrize(
    ("code", "facts"),
    [
        ("COUNT = [0]\n\n\ndef act(model, data, command):\n    COUNT[0] += 1\n    return 0.001 * COUNT[0]\n",
         ["bit for bit"]),
        ("def act(model, data, command):\n    return 1 / 0\n", ["control.py", "line 2", "ZeroDivisionError"]),
        ("def act(model, data, command):\n    return [1, 2]\n", ["2 numbers", "1 actuator"]),
        ("def act(model, data, command):\n    raise SystemExit(3)\n", ["control.py", "line 2", "SystemExit"]),
    ],
    ids=["keeps a state", "raises", "another number of controls", "ends the process"],
)  # fmt: skip
def test_the_pre_flight_says_what_is_wrong_with_a_controller(cart, code, facts):
    (cart.folder / "control.py").write_text(code)
    (cart.folder / "own.toml").write_text('policy = "control.py:act"\n' + COMMON)
    done = cart("backends", "own.toml", "--check", code=1)
    wrong = "\n".join(
        line for line in done.stdout.splitlines() if line.startswith(("WRONG", "BROKEN", "   "))
    )
    assert states(wrong, *(fact.removesuffix("actuator").strip() for fact in facts))


def test_a_first_robot_file_from_the_files(cart):
    """What the ONNX file states is not asked for; marks and one missing key remain."""
    made = cart.json("new", "first.toml", "--model", "cart.xml", "--policy", "cart_mjlab.onnx", code=0)
    assert states(made["problem"], "`decimation`")
    text = (cart.folder / "first.toml").read_text()
    assert text == made["text"]
    assert "command." not in text
    (cart.folder / "first.toml").write_text(
        text.replace("# ? decimation", "decimation").replace("    no file", " # ") + STATE
    )
    assert load_backend("first.toml").rollout({}, 0)["q"].shape == (251,)
    assert states(cart("new", "first.toml", "--model", "cart.xml", code=2).stderr, "first.toml", "exists")
    assert states(cart("new", "x.toml", "--model", "gone.xml", code=2).stderr, "gone.xml")
    assert not (cart.folder / "x.toml").exists()


def test_new_and_backends_run_no_code_of_the_user(cart):
    (cart.folder / "control.py").write_text(
        "from pathlib import Path\n\nPath(__file__).with_suffix('.ran').touch()\n\n\n"
        "def act(model, data, command):\n    print(data.time)\n    return 0.0\n"
    )
    cart("new", "own.toml", "--model", "cart.xml", "--policy", "control.py:act", code=0)
    (cart.folder / "own.toml").write_text('policy = "control.py:act"\n' + COMMON)
    assert states(cart("backends", "own.toml", code=0).stdout, "q_slide")
    cart.json("backends", "own.toml", code=0)
    assert not (cart.folder / "control.ran").exists()
    assert cart.json("backends", "own.toml", "--check", code=0)["promises"]  # what it prints is not on stdout
    assert (cart.folder / "control.ran").exists()


def test_names_in_a_strangers_files_write_no_line_of_their_own(cart):
    """A line break in a name of the model, a quote in that of a file."""
    evil = "x&#10;policy = &quot;evil.py:act&quot;&#10;#"
    text = (cart.folder / "cart.xml").read_text()
    text = text.replace('name="angle"', f'name="angle{evil}"').replace(
        "</mujoco>",
        f"""<keyframe>
        <key name="low{evil}" qpos="0 0"/><key name="up{evil}" qpos="0 0"/></keyframe></mujoco>""",
    )
    (cart.folder / 'my "cart".xml').write_text(text)
    made = cart.json("new", "first.toml", "--model", 'my "cart".xml', "--policy", "cart.onnx", code=0)
    table = tomllib.loads(made["text"])
    assert table["model"] == 'my "cart".xml'
    assert table["policy"] == "cart.onnx"
    assert not any(line.startswith('policy = "evil') for line in made["text"].splitlines())


def test_the_command_line_says_in_a_sentence_what_is_wrong(cart):
    for text, facts in (
        (TOML.replace("decimation", "decimaton"), ["cart.toml", "decimaton", "did you mean 'decimation'"]),
        (TOML.replace("abs(q)", "abs(qq)"), ["cart.toml", "failure.fell", "qq"]),
    ):
        (cart.folder / "cart.toml").write_text(text)
        done = cart("check", "up.stl", "-b", "cart.toml", "-q", code=2)
        assert states(done.stderr, *facts)
        assert "Traceback" not in done.stderr + done.stdout
    (cart.folder / "cart.toml").write_text(TOML)
    (cart.folder / "up.stl").write_text(SPEC.replace("mass", "mas"))
    assert states(cart("check", "up.stl", "-b", "cart.toml", "-q", code=2).stderr, "'mas'", "mass")


def test_a_command_of_a_controller_in_python(cart):
    """It gets the three components, and the trace has them."""
    code = "def act(model, data, command):\n    return command.sum()\n"
    (cart.folder / "control.py").write_text(code)
    text = 'policy = "control.py:act"\ncommand = { lin_vel_x = "vd", ang_vel_z = 0.25 }\n' + COMMON
    (cart.folder / "own.toml").write_text(text)
    backend = load_backend("own.toml:vd=0.5")
    trace = backend.rollout({}, 0)
    assert (trace["vx_cmd"][0], trace["vy_cmd"][0], trace["wz_cmd"][0]) == (0.5, 0.0, 0.25)
    assert (trace["ctrl"] == 0.75).all()


def test_a_command_that_the_policy_does_not_read_is_named(tmp_path):
    toml = 'decimation = 4\nobservation = ["joint_pos"]\ncommand.lin_vel_x = "vd"\n'
    wrong = [one for one in robot(tmp_path, toml, 4).preflight(run=False) if one.level == "wrong"]
    assert [one.topic for one in wrong] == ["command"]
    assert states(wrong[0].words, "command.lin_vel_x", "velocity_commands")


def test_a_mistake_with_which_the_simulator_falls_is_named_without_sizes(cart):
    (cart.folder / "up.stl").write_text(
        "signal q {deg}\nparam mass {g} in [600, 1400]\nrequire up: always[0 s, 2 s] (abs(q) <= 17 {deg})\n"
        "certify up: fall = -30\n"
    )
    robot = load_backend("cart.toml")
    (wrong,) = (one for one in robot.mistakes() if one.name == "joint_vel has the wrong sign")
    machine = robot.with_mistakes([wrong])
    keep = ["q", "dq", "q_slide", "dq_slide", "tau_slide", "target"]
    runs = [
        ({"mass": mass}, machine.rollout({"mass": mass / 1e3}, 7)) for mass in 2 * [700.0, 1000.0, 1300.0]
    ]
    assert all(trace.failure == "fell" for _, trace in runs)
    found = diagnose(
        "up.stl", "cart.toml", [(test, trace.only(keep)) for test, trace in runs], cache=cart.folder / "cache"
    )
    assert [one.name for one in found.mistakes] == [wrong.name]
    assert found.exit_code == 3
    assert not found.which.effects
    assert states(found.reason, wrong.name, "mass", "fell", "no effect is estimated")
