"""The user's own controllers and terms: what they leave behind, and how they fail."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from s2r_spec.errors import BackendError
from tests.mujoco.make_policies import linear
from tests.mujoco.robots import opened, save, weights

CART = (Path(__file__).parent / "cart.xml").read_text()


def controlled(folder: Path, code: str) -> Any:
    """Return the cart with a controller of this code."""
    (folder / "cart.xml").write_text(CART)
    (folder / "c.py").write_text(code)
    return opened(folder, 'model = "cart.xml"\npolicy = "c.py:act"\ndecimation = 2\nduration = 0.4\n')


def test_a_controller_that_changes_the_model_changes_no_later_rollout(tmp_path, nothing_loaded):
    code = "def act(model, data, command):\n    if data.time > 0.1:\n        model.body_mass[1] = 5\n    return [3.0]\n"
    backend = controlled(tmp_path, code)
    first, second = backend.rollout({}, 0), backend.rollout({}, 0)
    assert np.array_equal(first["q_slide"], second["q_slide"])


def test_a_controller_that_ends_the_program_ends_only_its_rollout(tmp_path, nothing_loaded):
    backend = controlled(tmp_path, "import sys\ndef act(model, data, command):\n    sys.exit(0)\n")
    with pytest.raises(BackendError, match=r"c\.py, line 3"):
        backend.rollout({}, 0)


def test_a_check_fails_where_code_ends_the_program(s2r, tmp_path):
    controlled(tmp_path, "import sys\ndef act(model, data, command):\n    sys.exit(0)\n")
    assert s2r("backends", "robot.toml", "--check").returncode == 1


@pytest.mark.parametrize("value", ["'a'", "None", "[1.0] * (1 if data.time == 0 else 2)"])
def test_a_term_that_returns_no_numbers_is_named(tmp_path, nothing_loaded, value):
    (tmp_path / "cart.xml").write_text(CART)
    (tmp_path / "t.py").write_text(f"def term(model, data, command):\n    return {value}\n")
    save(tmp_path, "policy.onnx", linear(weights(1, 2)))
    text = 'model = "cart.xml"\npolicy = "policy.onnx"\ndecimation = 2\nobservation = ["joint_pos", "t.py:term"]\n'
    with pytest.raises(BackendError, match=r"t\.py:term"):
        opened(tmp_path, text).rollout({}, 0)


def test_the_pre_flight_names_every_python_file_that_runs(tmp_path, nothing_loaded):
    (tmp_path / "gain_of_mine.py").write_text("GAIN = 1.0\n")
    code = "from gain_of_mine import GAIN\ndef act(model, data, command):\n    return [GAIN]\n"
    files = next(one for one in controlled(tmp_path, code).preflight(run=False) if one.topic == "files")
    assert "c.py, gain_of_mine.py" in files.words
