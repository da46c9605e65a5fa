"""A parameter may be given with a unit: as a text, or as a Quantity of pint."""

import numpy as np
import pint
import pytest

import s2r_spec as s2r
from s2r_spec.errors import UsageError
from tests.errors import naming

UNITS = pint.UnitRegistry()
SPEC = s2r.parse_spec(
    "signal v {m/s}\nparam vd {m/s} in [0, 1]\nparam warm {degC} = 20 {degC}\nparam share = 1\n"
    "require near: always (v - vd <= 0 {m/s})",
    "spec.stl",
)
TRACE = s2r.Trace([0, 1], {"v": [0.5, 0.5]}, {"v": "m/s"})


@pytest.mark.parametrize(
    "value",
    [0.25, np.float32(0.25), "0.25", "25 cm/s", "0.25 m/s", "0.9 km/h", "25{cm/s}", UNITS.Quantity(25, "cm/s"),
     UNITS.Quantity(0.9, "km/hour")],
)  # fmt: skip
def test_every_form_gives_the_same_robustness(value):
    assert SPEC.robustness(TRACE, {"vd": value})["near"] == pytest.approx(-0.25)
    assert SPEC.explain(TRACE, "near", {"vd": value}).rho == pytest.approx(-0.25)
    assert SPEC.monitor({"vd": value}) is not None


@pytest.mark.parametrize(
    "value",
    ["25 cm", "fast", "3 wobbles", "nan", [1], None, UNITS.Quantity(3, "m"), UNITS.Quantity(3, ""),
     UNITS.Quantity([1, 2], "m/s")],
)  # fmt: skip
def test_what_has_another_dimension_or_is_no_number_gets_one_sentence(value):
    with pytest.raises(UsageError, match=naming("vd")) as caught:
        SPEC.robustness(TRACE, {"vd": value})
    assert "\n" not in str(caught.value)


def test_a_backend_takes_the_same_forms():
    robot = s2r.load_backend("turtlebot")
    expected = robot.rollout({"ox": 0.1}, 0)["x"]
    for value in ("10 cm", "0.1", UNITS.Quantity(100, "mm"), np.float64(0.1)):
        assert np.array_equal(robot.rollout({"ox": value}, 0)["x"], expected)
    for wrong in ("10 s", "far", "10 m", UNITS.Quantity(1, "s"), None):
        with pytest.raises(UsageError, match=naming("ox")):
            robot.rollout({"ox": wrong}, 0)


def test_a_backend_in_a_unit_that_is_none_takes_numbers_only():
    odd = s2r.Parameter("x", "wobbles", 0, 1, 0, "a length")
    assert odd.check(0.5) == 0.5
    with pytest.raises(UsageError, match=naming("wobbles")):
        odd.check("0.5 m")
