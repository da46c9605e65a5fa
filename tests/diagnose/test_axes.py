"""The catalogue as lines, and where a line is looked at."""

import pytest

from s2r_spec.backend import Effect, EffectParameter
from s2r_spec.diagnose.simulator.axes import effect_axes

PLACE = EffectParameter("place", "m", -0.2, 0.2, 0.0, "normal, 0.05 m")
MASS = EffectParameter("mass", "kg", 0.0, 3.0, 0.0, "half-normal, 0.7 kg")


@pytest.mark.parametrize("parameters", [(PLACE, MASS), (MASS, PLACE)])
def test_what_only_says_how_an_effect_acts_comes_after_what_acts(parameters):
    mass, place = effect_axes([Effect("load", "inertia", "", parameters)], {"load": frozenset({"mass"})})
    assert (mass.name, mass.base) == ("load.mass", {})
    assert (place.name, place.base) == ("load.place", {"mass": mass.at_typical()})


@pytest.mark.parametrize(
    ("high", "last"), [(0.2, [0.2]), (0.26, [0.2, 0.26]), (0.5, [0.2, 0.4, 0.5]), (2.0, [0.2, 0.4, 2.0])]
)
def test_the_range_bounds_the_search_however_far_beyond_its_prior(high, last):
    rate = EffectParameter("rate", "", 0.0, high, 0.0, "half-normal, 0.1")
    (found,) = effect_axes([Effect("sag", "actuation", "", (rate,))])
    values = [found.value(x) for x in found.coordinates((1.0, 2.0))]
    assert values == pytest.approx(last)
    assert found.value(1e3) == high


@pytest.mark.parametrize(("low", "high", "held"), [(0.0, 3.0, 1.0), (-3.0, 0.0, -1.0)])
def test_what_only_says_how_an_effect_acts_is_tried_beside_a_typical_effect(low, high, held):
    amount = EffectParameter("mass", "kg", low, high, 0.0, "half-normal, 0.7 kg")
    mass, place = effect_axes([Effect("load", "inertia", "", (amount, PLACE))], {"load": frozenset({"mass"})})
    assert mass.coordinate(mass.at_typical()) == pytest.approx(held)
    assert place.base == {"mass": pytest.approx(mass.at_typical())}


def test_an_effect_that_never_acts_has_no_lines():
    assert effect_axes([Effect("load", "inertia", "", (PLACE, MASS))], {"load": frozenset()}) == ()


@pytest.mark.parametrize(("unit", "turn"), [("rad", 6.2832), ("deg", 360.0)])
def test_an_angle_of_any_value_has_no_ends(unit, turn):
    phase = EffectParameter("phase", unit, -turn / 2, turn / 2, 0.0, "uniform")
    (found,) = effect_axes([Effect("ripple", "actuation", "", (phase,))])
    assert found.is_turn
    assert found.value(1.1) == pytest.approx(-0.45 * turn)
    assert found.value(-3.2) == pytest.approx(0.4 * turn)
    value, low, high = found.interval(1.1, 0.9, 1.3)
    assert (low, high) == pytest.approx((value - 0.1 * turn, value + 0.1 * turn))


def test_an_angle_that_is_less_than_a_turn_has_ends():
    tilt = EffectParameter("tilt", "rad", -0.5, 0.5, 0.0, "uniform")
    (found,) = effect_axes([Effect("mount", "sensing", "", (tilt,))])
    assert not found.is_turn
    assert found.value(9.0) == 0.5
