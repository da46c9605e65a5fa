"""Texts without measure: a mistake with a place, or an answer, and never the interpreter's own error."""

import pytest

from s2r_spec.lang import lexing
from s2r_spec.lang.diagnostics import SpecError
from s2r_spec.lang.printing import format_text
from s2r_spec.spec import parse_spec
from tests.errors import states

HEAD = "signal x {m}\nparam p in [-1, 1]\n"
MANY = 2000


def mistakes(text):
    with pytest.raises(SpecError) as caught:
        parse_spec(text, "a.stl")
    return caught.value


@pytest.mark.parametrize(
    "formula",
    [
        "(" * MANY + "x <= 1" + ")" * MANY,
        "not " * MANY + "x <= 1",
        "-" * MANY + "x <= 1",
        "always[0, 1] " * MANY + "x <= 1",
        "abs(" * MANY + "x" + ")" * MANY + " <= 1",
        " -> ".join(["x <= 1"] * MANY),
        "+".join(["x"] * MANY) + " <= 1",
    ],
    ids=lambda text: text[:8],
)
def test_what_is_nested_thousands_of_levels_deep(formula):
    (mistake,) = mistakes(f"{HEAD}require a: {formula}").diagnostics
    assert (mistake.code, mistake.span.line) == ("E19", 3)


@pytest.mark.parametrize("sign", ["é", "x "], ids=repr)
def test_a_text_that_is_too_long_is_not_read_to_its_end(sign, monkeypatch):
    monkeypatch.setattr(lexing, "MOST_TOKENS", 5000)
    text = f"{HEAD}require a: {sign * 5010}"
    (mistake,) = mistakes(text).diagnostics
    assert mistake.code == "E22"
    with pytest.raises(SpecError):
        format_text(text)


def test_a_message_shows_some_of_many_mistakes_and_says_how_many_there_are():
    error = mistakes(HEAD + "require a: x <= 1\n" + "§ " * 3000)
    assert len(error.diagnostics) == 3000
    assert states(str(error), "3000", "2980")
    assert len(str(error)) < 10_000


@pytest.mark.parametrize(
    "text",
    [
        f"require a: {'x' * 10**6} <= 1",
        f"require a: p <= {'9' * 10**6}",
        f'import "{"a" * 10**6}"\nrequire a: x <= 1',
    ],
    ids=["name", "number", "file"],
)
def test_a_word_of_a_million_letters_is_not_repeated(text):
    assert len(str(mistakes(HEAD + text))) < 3000


@pytest.mark.parametrize(
    "unit",
    [
        "m^1e9",
        "m**9999999",
        "1e999 m",
        "Ym^99",
        "ym^-99",
        "km^99*km^99*km^99",
        "mm^99*mm^99*mm^99",
        "%" * 80,
        "m^0.5",
    ],
)
def test_a_unit_that_is_none_or_beyond_numbers(unit):
    (mistake, *_) = mistakes(f"signal x {{{unit}}}\nrequire a: x <= 1").diagnostics
    assert (mistake.code, mistake.span.line, mistake.span.text) == ("E04", 1, f"{{{unit}}}")


@pytest.mark.parametrize("unit", ["km^20", "deg^40", "ns^10"])
@pytest.mark.parametrize("formula", ["x^9 <= x", "1 / x^9 <= 1", "x^9 * x^9 <= 1"])
def test_a_computed_unit_beyond_numbers(unit, formula):
    error = mistakes(f"signal x {{{unit}}}\nrequire a: {formula}")
    assert {mistake.code for mistake in error.diagnostics} == {"E03"}


@pytest.mark.parametrize("end", ["\r\n", "\r", "\n"])
def test_line_ends_and_a_mark_of_byte_order(end, tmp_path):
    text = f"{HEAD}require a: x <= 1\n".replace("\n", end)
    assert parse_spec(text).requirements == ("a",)
    (mistake,) = mistakes(f"signal x{end}{end}require a: x <= y{end}").diagnostics
    assert (mistake.span.line, mistake.span.column) == (3, 17)


@pytest.mark.parametrize("sign", ["\0", "\ufeff", "\u202e", "\ud800", "\x1b"], ids=ascii)
def test_a_sign_that_is_no_text(sign):
    assert mistakes(f"{HEAD}require a: x <= 1 {sign}").diagnostics[0].span.line == 3
