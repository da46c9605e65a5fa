from decimal import Decimal

import numpy as np
import pytest

from s2r_spec.certify.bound.rounding import at_least, at_most, down, interval_text, up, width_text


def test_a_bound_is_never_printed_tighter_than_it_is():
    rng = np.random.default_rng(0)
    values = rng.normal(size=3000) * 10.0 ** rng.integers(-9, 9, 3000)
    for value in values.tolist():
        exact = Decimal(repr(value))
        assert (
            exact - Decimal("1e-4")
            < Decimal(down(value))
            <= exact
            <= Decimal(up(value))
            < exact + Decimal("1e-4")
        )
        assert Decimal(at_least(value)) <= exact <= Decimal(at_most(value))


@pytest.mark.parametrize(
    ("value", "below", "above"),
    [
        (0.004068, "+0.0040", "+0.0041"),
        (-0.004068, "-0.0041", "-0.0040"),
        (0.1, "+0.1000", "+0.1000"),
        (0.0, "+0.0000", "+0.0000"),
        (1e-9, "+0.0000", "+0.0001"),
        (-1e-9, "-0.0001", "-0.0000"),
        (1e300, f"+{10**300}.0000", f"+{10**300}.0000"),
        (np.float64(-2.5), "-2.5000", "-2.5000"),
    ],
)
def test_the_texts(value, below, above):
    assert (down(value), up(value)) == (below, above)
    assert interval_text(value, value) == f"[{below}, {above}]"


def test_widths_and_significant_digits():
    assert width_text(0.01932) == "0.0194"
    assert (at_least(0.028649), at_most(0.028649)) == ("0.0286", "0.0287")
    assert (at_least(1234.5), at_most(1234.5)) == ("1.23e+03", "1.24e+03")
    assert at_most(0.0) == at_least(0.0) == "0"
    assert at_most(0.02) == "0.02"
