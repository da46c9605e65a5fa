"""A diagnosis knows nothing of any robot: on the turtlebot it names what was added, with its value."""

from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.diagnose.diagnosis import Verdict

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")


@pytest.fixture
def find(quick):
    spec = s2r.load_spec(ROOT / "specs" / "turtlebot.stl")
    nominal = s2r.load_backend("turtlebot")

    def diagnosed(values, seed):
        machine, rng = nominal.with_effects(values), np.random.default_rng(seed)
        drawn = spec.space.lower + rng.uniform(size=(24, spec.space.dim)) * (
            spec.space.upper - spec.space.lower
        )
        tests = [dict(zip(spec.space.names, point.tolist(), strict=True)) for point in drawn]
        rollouts = [(test, machine.rollout(test, 700 + i)) for i, test in enumerate(tests)]
        return s2r.diagnose(spec, nominal, rollouts, cache=quick, where=False)

    return diagnosed


@pytest.mark.parametrize(
    ("effect", "parameter", "value"),
    [
        pytest.param("heading_bias", "angle", 0.3, marks=pytest.mark.slow),  # moves ρ far
        ("motor_lag", "time", 0.3),  # hardly does: the traces alone say so
        # makes the loop unsteady: no patch closes what single rollouts show
        pytest.param("latency", "delay", 0.18, marks=pytest.mark.slow),
    ],
)
def test_what_was_added_is_named(find, effect, parameter, value):
    found = find({effect: {parameter: value}}, 3)
    assert found.which.answer == (effect,), found.reason
    assert found.patch[effect][parameter] == pytest.approx(value, rel=0.15)


def test_nothing_added_is_no_material_gap(find):
    assert find({}, 4).verdict is Verdict.NONE
