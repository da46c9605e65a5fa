"""Numbers as people write them."""

import math

import pytest

from s2r_spec.base.printable import spell_unit
from s2r_spec.base.quantity import Scale, format_estimate, interval, quantity


@pytest.mark.parametrize(
    ("value", "low", "high", "unit", "text"),
    [
        (0.6001, 0.5121, 0.6882, "", "0.60 ± 0.09"),
        (0.5168, 0.4133, 0.6204, "N*m", "0.52 ± 0.10 N·m"),
        (0.00461, 0.00362, 0.0056, "s", "4.6 ± 1.0 ms"),
        (1.5, 1.1, 2.2, "N", "1.5 N (1.1 to 2.2 N)"),
        (14.85, 11.41, 18.3, "N*s/m", "14.8 ± 3.4 N·s/m"),
        (0.0, -0.6, 0.6, "deg", "0.0 ± 0.6 deg"),
        (12345.0, 12100.0, 12590.0, "N", "12340 ± 240 N"),
        (2.0, 2.0, 2.0, "kg*m^2", "2 kg·m²"),
    ],
)
def test_an_estimate_has_the_digits_of_its_interval(value, low, high, unit, text):
    assert format_estimate(value, low, high, unit) == text


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1.2e-5, "m", "12 µm"),
        (3.4e-10, "s", "0.34 ns"),
        (0.0044, "m/s", "4.4 mm/s"),
        (0.0044, "rad", "0.0044 rad"),
        (0.0, "m", "0 m"),
        (0.05, "m", "0.05 m"),
        (1.5e-9, "kg", "1.5e-09 kg"),
    ],
)
def test_small_quantities_have_a_prefix_if_their_unit_takes_one(value, unit, text):
    assert quantity(value, unit) == text


def test_all_numbers_of_an_interval_have_one_prefix():
    assert interval(0.0007384, 0.001084, "s") == "0.74 to 1.08 ms"
    scale = Scale.of(3e-5, "m")
    assert (scale.unit, scale.number(1e-6, 5e-7)) == ("µm", "1.0")


def test_numbers_without_a_finite_uncertainty_have_three_digits():
    assert quantity(1.23456, "V", math.inf) == quantity(1.23456, "V", math.nan) == "1.23 V"
    assert quantity(math.inf, "V", 1.0) == "inf V"


def test_units_are_spelled_with_dots_and_raised_powers():
    assert spell_unit("N*m*s/rad") == "N·m·s/rad"
    assert spell_unit("m/s^2") == "m/s²"
    assert spell_unit("s^-1") == "s⁻¹"
    assert spell_unit("") == ""
