"""The catalogue as lines, and where a line is looked at."""

import numpy as np
import pytest

from s2r_spec.backend import Effect, EffectParameter
from s2r_spec.diagnose.axes import lines
from s2r_spec.diagnose.models import LEAST, seen_from
from s2r_spec.diagnose.signatures import _relative

PLACE = EffectParameter("place", "m", -0.2, 0.2, 0.0, "normal, 0.05 m")
MASS = EffectParameter("mass", "kg", 0.0, 3.0, 0.0, "half-normal, 0.7 kg")


@pytest.mark.parametrize("parameters", [(PLACE, MASS), (MASS, PLACE)])
def test_what_only_says_how_an_effect_acts_comes_after_what_acts(parameters):
    mass, place = lines([Effect("load", "inertia", "", parameters)], {"load": frozenset({"mass"})})
    assert (mass.name, mass.base) == ("load.mass", {})
    assert (place.name, place.base) == ("load.place", {"mass": mass.at_typical()})


@pytest.mark.parametrize(
    ("high", "last"), [(0.2, [0.2]), (0.26, [0.2, 0.26]), (0.5, [0.2, 0.5]), (2.0, [0.2, 0.4, 2.0])]
)
def test_the_range_bounds_the_search_however_far_beyond_its_prior(high, last):
    rate = EffectParameter("rate", "", 0.0, high, 0.0, "half-normal, 0.1")
    (found,) = lines([Effect("sag", "actuation", "", (rate,))])
    assert found.values[-len(last) :] == pytest.approx(last)
    assert found.value(1e3) == high


@pytest.mark.parametrize(("low", "high", "held"), [(0.0, 3.0, 1.0), (-3.0, 0.0, -1.0)])
def test_what_only_says_how_an_effect_acts_is_per_unit_of_the_effect(low, high, held):
    amount = EffectParameter("mass", "kg", low, high, 0.0, "half-normal, 0.7 kg")
    found = lines([Effect("load", "inertia", "", (amount, PLACE))], {"load": frozenset({"mass"})})
    mass, place = found
    assert mass.coordinate(mass.at_typical()) == pytest.approx(held)
    itself, turn = np.array([1.0, -2.0]), np.array([0.5, 3.0])
    changes = [
        np.array([mass.coordinate(v) * itself for v in mass.values]),
        np.array([held * (itself + place.coordinate(v) * turn) for v in place.values]),
    ]
    _, relative = _relative(found, changes)
    for value, change in zip(place.values, relative, strict=True):
        assert change == pytest.approx(place.coordinate(value) * turn)


def test_an_effect_that_never_acts_has_no_lines():
    assert lines([Effect("load", "inertia", "", (PLACE, MASS))], {"load": frozenset()}) == ()


@pytest.mark.parametrize(
    ("coordinate", "low", "high", "there"),
    [
        (0.6, -2.0, 2.0, 0.6),
        (0.04, -2.0, 2.0, LEAST),
        (-0.04, -2.0, 2.0, -LEAST),
        (0.0, -2.0, 0.0, -LEAST),
        (0.04, -2.0, 0.05, 0.05),  # a range may end before
        (3.0, 0.0, 2.0, 2.0),
    ],
)
def test_a_line_is_looked_at_where_its_effect_can_be_seen(coordinate, low, high, there):
    assert seen_from(coordinate, low, high) == pytest.approx(there)
