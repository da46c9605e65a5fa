"""The user's own catalogue: other ranges and kinds, effects by fields and by ``mujoco.sysid``, and its mistakes."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_spec.backend import load_backend
from s2r_spec.effects import catalogue_of, prior_scale
from s2r_spec.errors import UsageError
from tests.errors import naming
from tests.mujoco.robots import robot, same
from tests.mujoco.test_effects import TOML, WIDTH

LEGS = 'kinds.front = ["f."]\n'
MASS = 'field = "geom/trunk/mass", how = "add", range = [0, 2]'


def with_file(folder, text, extra=""):
    (folder / "effects.toml").write_text(text)
    return robot(folder, TOML + f'catalogue = "effects.toml"\n{extra}', WIDTH)


def parameters(backend):
    return {f"{e.name}.{p.name}": p for e in catalogue_of(backend) for p in e.parameters}


@pytest.mark.parametrize("text", ["dry_friction.joint = { range = [0, 2], prior = 0.4 }", ""])
def test_a_file_changes_range_and_prior(tmp_path, text):
    before, after = parameters(robot(tmp_path, TOML, WIDTH)), parameters(with_file(tmp_path, text))
    assert [*after] == [*before]
    changed = {name for name in after if after[name] != before[name]}
    assert changed == ({"dry_friction.joint"} if text else set())
    if text:
        one = after["dry_friction.joint"]
        assert (one.low, one.high, prior_scale(one)) == (0.0, 2.0, 0.4)


def test_a_file_leaves_out_an_effect_or_a_parameter(tmp_path):
    names = parameters(with_file(tmp_path, "imu_tilt = false\ngyro_bias.x = false\n"))
    assert not any(name.startswith("imu_tilt") or name == "gyro_bias.x" for name in names)
    assert "gyro_bias.y" in names


def test_a_file_splits_kinds(tmp_path):
    backend = with_file(tmp_path, LEGS + "dry_friction.joint = false\n")
    names = parameters(backend)
    assert {"dry_friction.front", "motor_strength.front", "motor_strength.joint"} <= {*names}
    assert "dry_friction.joint" not in names
    trace = backend.with_effects({"motor_strength": {"front": 0.5}}).rollout({}, 1)
    stated = 3.0 * (trace["target"] - trace["q"]) - 0.08 * trace["dq"]
    assert np.allclose(trace["tau"], stated * [0.5, 0.5, 1.0, 1.0])


def test_a_field_of_the_model_is_an_effect(tmp_path):
    backend = with_file(tmp_path, f"battery.mass = {{ {MASS}, prior = 0.3 }}\n")
    one = parameters(backend)["battery.mass"]
    assert (one.unit, one.low, one.high, one.nominal, prior_scale(one)) == ("kg", 0.0, 2.0, 0.0, 0.3)
    assert same(backend.with_effects({"battery": {"mass": 0.0}}).rollout({}, 1), backend.rollout({}, 1))
    heavy = backend.with_effects({"battery": {"mass": 1.0}}).rollout({}, 1)
    plain = robot(tmp_path, TOML + f"parameters.more = {{ {MASS} }}\n", WIDTH)
    assert np.allclose(heavy["q"], plain.rollout({"more": 1.0}, 1)["q"], atol=1e-9)


def test_a_test_of_the_same_field_adds_to_the_effect(tmp_path):
    backend = with_file(tmp_path, f"battery.mass = {{ {MASS} }}\n", f"parameters.more = {{ {MASS} }}\n")
    both = backend.with_effects({"battery": {"mass": 0.5}}).rollout({"more": 0.7}, 1)
    assert np.allclose(both["q"], backend.rollout({"more": 1.2}, 1)["q"], atol=1e-9)


def test_the_found_files_keep_the_catalogue(tmp_path):
    pytest.importorskip("tomlkit")
    backend = with_file(tmp_path, LEGS + f"supply_sag = true\nbattery.mass = {{ {MASS} }}\n")
    values = {
        "battery": {"mass": 1.0}, "dry_friction": {"front": 0.2}, "motor_strength": {"joint": 0.8},
        "supply_sag": {"per_watt": 0.01},
    }  # fmt: skip
    backend.write_found(values, tmp_path / "found")
    other = load_backend(str(tmp_path / "found" / "as_found.toml"))
    assert {"battery", "dry_friction"} & {*other.chosen()} == set()  # they are in the model
    assert other.chosen()["supply_sag"] == {"per_watt": 0.01}
    assert np.allclose(other.rollout({}, 1)["q"], backend.with_effects(values).rollout({}, 1)["q"], atol=1e-9)


def test_the_supply_sags_with_the_power_of_all_motors_where_the_file_says_so(tmp_path):
    assert "supply_sag.per_watt" not in parameters(robot(tmp_path, TOML, WIDTH))
    backend = with_file(tmp_path, "supply_sag.per_watt = { range = [0, 1] }\n")
    none, per_watt = backend.with_effects({"supply_sag": {"per_watt": 0.0}}), 0.1
    assert same(none.rollout({}, 1), backend.rollout({}, 1))
    weak = replace(backend, loop_keys="decimation = 1").with_effects({"supply_sag": {"per_watt": per_watt}})
    trace = weak.rollout({}, 1)
    assert same(trace, weak.rollout({}, 1))  # a rollout leaves nothing behind
    power = np.maximum(trace["tau"] * trace["dq"], 0.0).sum(axis=1)  # of each physics step
    left = trace["tau"] / (3.0 * (trace["target"] - trace["q"]) - 0.08 * trace["dq"])
    assert np.allclose(left[1:], 1.0 - per_watt * power[:-1, None])
    assert left.min() < 0.9


SYSID = """\
import numpy as np


class Parameter:  # as mujoco.sysid has it
    def __init__(self, name, nominal, low, high, frozen=False, modifier=None):
        self.nominal, self.min_value, self.max_value = (np.atleast_1d(one) for one in (nominal, low, high))
        self.name, self.value, self.frozen, self.modifier = name, self.nominal.copy(), frozen, modifier


def armature(spec, parameter):
    for joint, value in zip(("fl", "fr"), parameter.value):
        spec.joint(joint).armature = value


def parameters():
    every = [
        Parameter("front rotors", [0.01, 0.01], [0.0, 0.0], [0.1, 0.1], modifier=armature),
        Parameter("kept", 1.0, 0.0, 2.0, frozen=True),
    ]
    return {one.name: one for one in every}
"""


def test_a_parameter_dict_of_mujoco_sysid_is_a_catalogue(tmp_path):
    (tmp_path / "fit.py").write_text(SYSID)
    backend = with_file(tmp_path, 'parameters = "fit.py:parameters"\n')
    names = parameters(backend)
    assert {name for name in names if name.startswith(("front", "kept"))} == {
        "front_rotors.value_0", "front_rotors.value_1",
    }  # fmt: skip
    assert (names["front_rotors.value_0"].high, names["front_rotors.value_0"].nominal) == (0.1, 0.01)
    changed, before = (
        backend.with_effects({"front_rotors": {"value_1": 0.06}}).rollout({}, 1),
        backend.rollout({}, 1),
    )
    other = robot(
        tmp_path, TOML + 'parameters.more = { field = "joint/fr/armature", range = [0, 1] }\n', WIDTH
    )
    assert np.allclose(changed["q"], other.rollout({"more": 0.06}, 1)["q"], atol=1e-9)
    assert np.abs(changed["q"] - before["q"]).max() > 1e-3


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (SYSID.replace("[0.01, 0.01]", "[0.02, 0.01]"), ("fit.py", "front rotors", "0.02", "nominal")),
        (SYSID.replace(", modifier=armature", ""), ("front rotors", "modifier")),
        ("parameters = 3\n", ("fit.py:parameters", "ParameterDict")),
        ("parameters = {'payload': 3}\n", ("payload", "catalogue")),
        ("parameters = {'one': 3}\n", ("one", "Parameter")),
    ],
)
def test_a_wrong_parameter_dict_is_a_clear_error(tmp_path, code, words):
    (tmp_path / "fit.py").write_text(code)
    backend = with_file(tmp_path, 'parameters = "fit.py:parameters"\n')
    with pytest.raises(UsageError, match=naming("effects.toml", *(w for w in words if w != "fit.py"))):
        backend.effects()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("imu_tit = false", ("imu_tit", "imu_tilt")),
        ("imu_tilt.rol = { range = [0, 1] }", ("imu_tilt.rol", "roll")),
        ("imu_tilt.roll = { rnge = [0, 1] }", ("imu_tilt.roll.rnge", "range")),
        ("imu_tilt.roll = { range = [1, 2] }", ("imu_tilt.roll", "[1.0, 2.0]")),
        ("imu_tilt.roll = { range = [0, 0] }", ("imu_tilt.roll", "[0.0, 0.0]")),
        ("imu_tilt.roll = { prior = 0 }", ("imu_tilt.roll.prior", "0")),
        ("imu_tilt = 3", ("imu_tilt", "3")),
        ("imu_tilt.roll = true", ("imu_tilt.roll", "True")),
        (f"imu_tilt.roll = {{ {MASS} }}", ("imu_tilt.roll", "name")),
        ('battery.mass = { field = "geom/trunk/mass" }', ("battery.mass", "range")),
        ('battery.mass = { field = "geom/trunkk/mass", range = [0, 9] }', ("trunkk", "trunk")),
        ('battery.mass = { field = "geom/trunk/mass", range = [0, 1] }', ("battery.mass", "3")),
        ("battery.mass = { range = [0, 1] }", ("battery", "field")),
        ('kinds.front = ["x."]', ("kinds.front", "x.")),
        ('kinds.front = ["f."]\nkinds.left = [".l"]', ("kinds.left", "fl", "kinds.front")),
        ('kinds.joint = ["f."]', ("kinds.joint", "rl")),
        ('kinds."my legs" = ["f."]', ("kinds.my legs",)),
        ("kinds.front = 3", ("kinds.front", "3")),
        ("kinds", ("TOML",)),
    ],
)
def test_a_mistake_is_one_sentence_with_file_and_key(tmp_path, text, words):
    with pytest.raises(UsageError, match=naming("effects.toml", *words)) as error:
        catalogue_of(with_file(tmp_path, text))
    assert "\n" not in str(error.value)


def test_the_robot_in_the_air_ignores_what_only_a_standing_one_has(tmp_path):
    backend = with_file(
        tmp_path, "payload = false\nimu_tilt.roll = { range = [-9, 9] }\ndry_friction.joint.prior = 1\n"
    )
    assert backend.protocols()
    assert prior_scale(parameters(backend)["dry_friction.joint"]) == 1.0


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UsageError, match=naming("other.toml")):
        robot(tmp_path, TOML + 'catalogue = "other.toml"\n', WIDTH)
