"""The first robot file: names of a stranger's model stay what they are."""

import os
import tomllib

import pytest

from s2r_mujoco.deploy import read_deployment
from s2r_mujoco.description import read_description
from s2r_mujoco.new import draft
from s2r_spec.errors import UsageError

XML = """<mujoco><worldbody><geom type="plane" size="0 0 1"/><body><freejoint/><geom size="0.1"/>
<body><joint name="j"/><geom size="0.1"/></body></body></worldbody><actuator><motor name="m" joint="j"/></actuator>
<keyframe><key name="home&quot;&#10;policy = &quot;evil.py:act&quot;" qpos="0 0 0.1 1 0 0 0 0"/>
<key name="b&#10;policy = &quot;evil.py:act&quot;" qpos="0 0 0.1 1 0 0 0 0"/></keyframe></mujoco>"""


def test_a_name_of_the_model_adds_no_line(tmp_path):
    (tmp_path / 'a "b".xml').write_text(XML)
    text, _ = draft(tmp_path / "r.toml", tmp_path / 'a "b".xml', "", None)
    table = tomllib.loads(text)
    assert table["model"] == 'a "b".xml'
    assert table["keyframe"].startswith('home"\npolicy')
    assert "policy" not in table


def test_nested_values_and_pipes_are_refused(tmp_path):
    (tmp_path / "r.toml").write_text(f"a = {'[' * 5000}{']' * 5000}")
    with pytest.raises(UsageError, match="nested"):
        read_description(tmp_path / "r.toml")
    os.mkfifo(tmp_path / "deploy.yaml")
    with pytest.raises(UsageError, match="not a file"):
        read_deployment(tmp_path / "deploy.yaml")
