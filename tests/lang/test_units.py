"""Units as people write them, exact conversions, and rotations that are no frequencies."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import s2r_spec as s2r
from s2r_spec.errors import TraceError, UsageError
from s2r_spec.lang.conversion import Conversion
from s2r_spec.lang.units import UnknownUnitError, parse_unit, unit_of_pint
from s2r_spec.lang.usual_units import USUAL
from s2r_spec.spec import SpecError
from tests.errors import naming
from tests.examples import examples

SIZES = {
    "mm": Fraction(1, 1000), "cm": Fraction(1, 100), "km": Fraction(1000), "ft": Fraction("0.3048"),
    "inch": Fraction("0.0254"), "mile": Fraction("1609.344"), "m": Fraction(1),
}  # fmt: skip
SPEEDS = {"km/h": Fraction(5, 18), "knot": Fraction(1852, 3600), "m/s": Fraction(1), "cm/s": Fraction(1, 100)}
DECIMALS = st.builds(
    lambda digits, places: float(f"{digits}e-{places}"), st.integers(-999_999, 999_999), st.integers(0, 5)
)


def same(left: str, right: str) -> bool:
    one, other = parse_unit(left), parse_unit(right)
    return one.fits(other) and one.to(other).same


@pytest.mark.parametrize("name", USUAL)
def test_the_usual_units_are_those_of_pint(name):
    assert parse_unit(name) == unit_of_pint(name)


@pytest.mark.parametrize(
    ("written", "meant"),
    [("m/s²", "m/s^2"), ("m/s2", "m/s^2"), ("m s-2", "m/s^2"), ("m·s⁻¹", "m/s"), ("m.s-1", "m/s"), ("m s^{-1}", "m/s"),
     ("m s**-1", "m/s"), ("m s^(-1)", "m/s"), ("rad s^-1", "rad/s"), ("°/s", "deg/s"), ("℃", "degC"), ("°C", "degC"),
     ("kg m² s⁻²", "J"), ("W/m2/K", "W/m^2/K"), ("N-m", "N*m"), ("N⋅m", "N*m"), ("m³/h", "m^3/h"), ("µm", "um"),
     ("μm", "um"), ("RPM", "rpm"), ("rev/min", "rpm"), ("Feet", "ft"), ("cmH2O", "98.0665 Pa"), ("-", ""), ("—", ""),
     ("1", ""), ("%", "percent"), ("1 / s", "1/s"), ("m/s/s", "m/s^2")],
)  # fmt: skip
def test_a_unit_as_people_write_it(written, meant):
    if meant[0:1].isdigit() and not meant.startswith("1"):
        number, name = meant.split()
        assert parse_unit(written).to(parse_unit(name))(1.0) == float(number)
    else:
        assert same(written, meant)


@pytest.mark.parametrize(
    "text",
    ["m1", "1-2", "0=off", "raw", "1e3 m", "m22", "m2kg", "H2O", "m^2 3", "s2^2", "x", "--", "m/", "2"],
)
def test_what_is_no_unit(text):
    with pytest.raises(UnknownUnitError):
        parse_unit(text)


def test_short_names_keep_their_capitals():
    assert not same("Mm", "mm")
    assert not parse_unit("S").fits(parse_unit("s"))


# -- exact conversions ----------------------------------------------------------------------------------------------


@settings(max_examples=examples(1000), deadline=None)
@given(DECIMALS, st.sampled_from([SIZES, SPEEDS]), st.data())
@example(700.0, SIZES, None)
def test_a_conversion_rounds_what_people_write_once(number, units, data):
    pairs = [("mm", "m")] if data is None else [data.draw(st.permutations(list(units)))[:2]]
    for source, target in pairs:
        conversion = parse_unit(source).to(parse_unit(target))
        exact = float(Fraction(repr(number)) * units[source] / units[target])
        assert conversion(number) == exact
        assert conversion.each(np.array([[1.0, number]]))[0, 1] == exact


@settings(max_examples=examples(300), deadline=None)
@given(DECIMALS)
def test_temperatures_are_exact_as_well(number):
    fahrenheit = (Fraction(repr(number)) + Fraction("459.67")) * 5 / 9
    assert parse_unit("degF").to(parse_unit("K"))(number) == float(fahrenheit)
    celsius = Fraction(repr(number)) + Fraction("273.15")
    assert parse_unit("degC").to(parse_unit("K"))(number) == float(celsius)


@settings(max_examples=examples(500), deadline=None)
@given(
    st.lists(st.floats(width=64) | DECIMALS, max_size=20),
    st.sampled_from(
        [("mm", "m"), ("km/h", "m/s"), ("degF", "degC"), ("deg", "rad"), ("m", "mm"), ("psi", "Pa")]
    ),
)
def test_an_array_is_converted_like_its_numbers(numbers, units):
    conversion = Conversion() if units is None else parse_unit(units[0]).to(parse_unit(units[1]))
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(conversion.each(np.array(numbers)), [conversion(x) for x in numbers])


def test_the_same_unit_changes_no_bit():
    values = np.array([0.1 + 0.2, -0.0, 1e300])
    assert parse_unit("m/s²").to(parse_unit("m/s^2")).each(values) is values


def test_every_millimetre_lies_on_its_limit():
    """399 of the first 2999 are off by a bit where a number is multiplied by 0.001."""
    spec = s2r.parse_spec("signal z {m}\nparam c {m} = 1\nrequire r: z == c\nrequire s: z <= c and z >= c")
    for height in range(1, 3000, 7):
        trace = s2r.Trace([0], {"z": [height]}, {"z": "mm"})
        limit = {"c": f"{height / 10!r} cm"}
        assert spec.satisfied(trace, limit)["r"]
        assert spec.satisfied(trace, limit)["s"]


def test_everyone_who_evaluates_rounds_alike():
    text = "signal z {mm}\nsignal w {m}\nlet both := z <= 0.7 {m} and w >= 700 {mm}\nrequire r: always both"
    spec = s2r.parse_spec(text)
    trace = s2r.Trace([0, 0.1], {"z": [700, 700], "w": [0.7, 70]}, {"w": "m"})
    assert spec.satisfied(trace)["r"]
    assert spec.satisfied(trace, interpolation="linear")["r"]
    monitor = spec.monitor(requirement="r", period=0.1)
    for t in (0.0, 0.1):
        monitor.update(t, {"z": 700.0, "w": 0.7})
    assert monitor.finish()["r"].satisfied


def test_tensors_round_whole_numbers_once():
    torch = pytest.importorskip("torch")
    spec = s2r.parse_spec("signal z {mm}\nrequire r: always (0.7 {m} == z)")
    found = spec.robustness_tensor({"z": torch.tensor([700.0, 700.0], dtype=torch.float64)}, "r", period=0.1)
    assert found.max().item() == 0


# -- rotations -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rotation", "frequency"),
    [("rpm", "1/min"), ("rpm", "Hz"), ("rad/s", "Hz"), ("rev/min", "1/s"), ("deg/s", "1/s"), ("rad/s^2", "1/s^2"),
     ("turn/s", "kHz"), ("rpm", "s^-1")],
)  # fmt: skip
def test_a_rotation_is_no_frequency(rotation, frequency):
    for one, other in ((rotation, frequency), (frequency, rotation)):
        for text in (f"n >= 50 {{{other}}}", f"n + 1 {{{other}}} >= 50", f"max(n, 1 {{{other}}}) > 2"):
            with pytest.raises(SpecError, match=naming(rotation, frequency)) as caught:
                s2r.parse_spec(f"signal n {{{one}}}\nrequire r: {text}")
            (mistake,) = caught.value.diagnostics
            assert mistake.code == "E03"
        spec = s2r.parse_spec(f"signal n {{{one}}}\nrequire r: n >= 50")
        with pytest.raises(TraceError, match=naming("'n'", rotation, frequency)):
            spec.robustness(s2r.Trace([0], {"n": [600]}, {"n": other}))
        given = s2r.parse_spec(f"signal n {{{one}}}\nparam p {{{one}}} = 1\nrequire r: n >= p")
        with pytest.raises(UsageError, match=naming("p", rotation, frequency)):
            given.robustness(s2r.Trace([0], {"n": [600]}), {"p": f"5 {other}"})


def test_both_readings_and_what_to_write_are_said():
    with pytest.raises(SpecError, match=naming("6.283", "rev/min", "rad/min")):
        s2r.parse_spec("signal n {rpm}\nrequire r: n >= 3000 {1/min}")
    for unit, rho in (("rev/min", -2400), ("rad/min", 600 * 2 * np.pi - 3000)):
        spec = s2r.parse_spec(f"signal n {{{unit}}}\nrequire r: n >= 3000")
        trace = s2r.Trace([0], {"n": [600]}, {"n": "rpm"})
        assert spec.robustness(trace)["r"] == pytest.approx(rho)


@pytest.mark.parametrize(
    ("signals", "formula"),
    [
        ("w {rad/s}; r {m}; v {m/s}", "w * r <= v"),
        ("w {rad/s}; r {m}; v {m/s}", "w <= v / r"),
        ("w {rad/s}; r {m}; a {m/s^2}", "w^2 * r <= a"),
        ("w {rpm}; v {rad/s}; u {deg/s}", "w <= v + u"),
        ("q {rad}; x", "q <= x and x <= 2 {deg}"),
        ("q {rad}; w {rad/s}", "deriv(q) <= w"),
        ("x; w {rad/s}; f {Hz}", "deriv(x) <= w or deriv(x) <= f"),
        ("k {1/s}; q {rad}; e; w {rad/s}", "k * q <= w and k * e <= w"),
        ("T {s}; w {rad/s}", "6.283 / T <= w"),
        ("T {s}; f {Hz}", "1 / T <= f and 2 * f <= 3 {1/min}"),
        ("k {N/m}; m {kg}; w {rad/s}", "sqrt(k / m) <= w"),
        ("p {W}; t {N*m}; w {rad/s}", "p <= t * w and p / t <= w"),
        ("w {rad/s}; f {Hz}", "w <= 1 and f <= 1"),
    ],
)
def test_an_angle_alone_stays_without_dimension(signals, formula):
    declared = "\n".join(f"signal {one}" for one in signals.split("; "))
    assert s2r.parse_spec(f"{declared}\nrequire holds: {formula}")


def test_margins_of_a_rotation_and_a_frequency_are_mixed():
    spec = s2r.parse_spec("signal w {rpm}\nsignal f {Hz}\nrequire r: w <= 1 and f <= 1")
    assert spec.unit("r") == "mixed"
