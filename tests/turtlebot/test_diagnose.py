"""A diagnosis knows nothing of any robot: on the turtlebot it names what was added, with its value."""

from pathlib import Path

import jsonschema
import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.diagnose.diagnosis import Verdict
from s2r_spec.report.records.schema import schema
from s2r_turtlebot.effects import CATALOGUE, TurtlebotWithEffects

SPEC = (Path(__file__).parents[2] / "specs" / "turtlebot.stl").read_text()
LINE = SPEC.replace("param  ox {m} in [-0.3, 0.3]", "param  ox {m} = 0.1")
"""One parameter: half as many tests at which effects are simulated."""


class Few(TurtlebotWithEffects):
    """A turtlebot whose catalogue has three effects, which are simulated in a third of the time."""

    def effects(self):
        return tuple(e for e in CATALOGUE if e.name in ("motor_lag", "position_bias", "wheel_radius"))


@pytest.fixture(scope="module")
def find(cache):
    def diagnosed(values, seed, text=SPEC, kind=TurtlebotWithEffects):
        spec, nominal = s2r.parse_spec(text), kind()
        machine, rng = nominal.with_effects(values), np.random.default_rng(seed)
        drawn = spec.space.lower + rng.uniform(size=(24, spec.space.dim)) * (
            spec.space.upper - spec.space.lower
        )
        tests = [dict(zip(spec.space.names, point.tolist(), strict=True)) for point in drawn]
        fixed = {"ox": 0.1} if text == LINE else {}
        rollouts = [(test, machine.rollout(fixed | test, 700 + i)) for i, test in enumerate(tests)]
        return s2r.diagnose(spec, nominal, rollouts, cache=cache, where=False)

    return diagnosed


@pytest.fixture(scope="module")
def lagging(find):
    """The answer to a robot with a lag of 0.3 s, from a catalogue of three."""
    return find({"motor_lag": {"time": 0.3}}, 3, LINE, Few)


def test_what_was_added_is_named_among_three(lagging):
    assert lagging.which.answer == ("motor_lag",), lagging.reason
    jsonschema.validate(lagging.to_json(), schema("s2r/diagnosis/2"))
    assert "motor_lag" in lagging._repr_html_()
    assert repr(lagging).startswith("Diagnosis(")


def test_what_was_added_has_its_size(lagging):
    assert lagging.patch["motor_lag"]["time"] == pytest.approx(0.3, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "parameter", "value"),
    [
        ("heading_bias", "angle", 0.3),  # moves ρ far
        ("motor_lag", "time", 0.3),  # hardly does: the traces alone say so
        ("latency", "delay", 0.18),  # makes the loop unsteady: no patch closes what single rollouts show
    ],
)
def test_what_was_added_is_named(find, effect, parameter, value):
    found = find({effect: {parameter: value}}, 3)
    assert found.which.answer == (effect,), found.reason
    assert found.patch[effect][parameter] == pytest.approx(value, rel=0.15)


@pytest.mark.slow
def test_nothing_added_is_no_material_gap(find):
    assert find({}, 4).verdict is Verdict.NONE
