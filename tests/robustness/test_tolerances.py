import math

import numpy as np
import pytest

from s2r_spec.spec import parse_spec
from s2r_spec.trace import Trace

TRACE = Trace(np.arange(151) / 100, {"vx": np.linspace(0.0, 0.3, 151)}, {"vx": "m/s"})
HEAD = "signal vx {m/s}\nparam vd {m/s} in [-0.2, 0.3]\nrequire walking: "


def tubes(text, vd=0.2):
    return parse_spec(HEAD + text).tolerances(TRACE, "walking", {"vd": vd}).tubes


def test_what_must_always_hold_is_a_band_over_its_window():
    (tube,) = tubes("always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.1 {m/s})")
    assert (tube.signal, tube.start, tube.end) == ("vx", 0.5, 1.5)
    assert tube.predicate == "abs(vx - vd) <= 0.1 {m/s}"
    assert tube.bands[0] == pytest.approx((0.1, 0.3), abs=1e-3)


def test_overshoot_is_open_on_the_side_from_which_the_command_is_reached():
    (tube,) = tubes("always[0 s, 0.5 s] (overshoot(vx, vd) <= 0.03 {m/s})")
    assert tube.bands == ((-math.inf, pytest.approx(0.23, abs=1e-3)),)


@pytest.mark.parametrize(
    "text",
    [
        "eventually[0 s, 1 s] (vx >= vd)",
        "vx >= 0 {m/s} or vx <= vd",
    ],
)
def test_where_no_single_predicate_must_hold_there_is_no_tube(text):
    assert tubes(text) == ()


def test_signals_come_in_declared_units_with_the_parameters_beside_them():
    found = parse_spec(HEAD + "always (vx <= vd)").tolerances(TRACE, "walking", {"vd": 0.2})
    assert found.units == {"vx": "m/s"}
    assert found.levels == {"vx": {"vd": 0.2}}
