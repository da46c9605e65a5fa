"""Keywords of the Python functions are the fields of the records behind them, in name, type and default."""

from dataclasses import fields
from typing import Required, get_args, get_origin, get_type_hints

import pytest

import s2r_spec as s2r
from s2r_spec.certify.bound.settings import SearchKeywords, SearchSettings
from s2r_spec.certify.options import MeasureKeywords, MeasureOptions, RunKeywords, RunOptions
from s2r_spec.errors import UsageError


def types(keywords):
    """Return keyword → type, and whether it must be given."""
    return {
        name: (get_args(hint)[0], True) if get_origin(hint) is Required else (hint, False)
        for name, hint in get_type_hints(keywords, include_extras=True).items()
    }


@pytest.mark.parametrize(
    ("keywords", "record", "positional"),
    [
        (SearchKeywords, SearchSettings, {"space"}),
        (RunKeywords, RunOptions, set()),
        (MeasureKeywords, MeasureOptions, set()),
    ],
)
def test_keywords_are_the_fields_of_their_record(keywords, record, positional):
    hints = get_type_hints(record)
    missing = object()
    expected = {}
    for field in fields(record):
        if field.init and field.name not in positional:
            required = getattr(record, field.name, missing) is missing
            expected[field.name] = (hints[field.name], required)
    assert types(keywords) == expected


def test_an_unknown_keyword_and_a_missing_one_are_refused(tmp_path):
    with pytest.raises(TypeError, match="bugdet"):
        s2r.Search({"x": (0, 1)}, kernel=s2r.Kernel("rbf", 0.2), B=1, R=1, delta=0.1, epsilon=1, bugdet=8)
    with pytest.raises(TypeError, match="epsilon"):
        s2r.Search({"x": (0, 1)}, kernel=s2r.Kernel("rbf", 0.2), B=1, R=1, delta=0.1)
    with pytest.raises(UsageError, match=r"bugdet.*budget"):
        s2r.check(s2r.parse_spec("signal x\nrequire low: x <= 1"), "toy", tmp_path, bugdet=8)


def test_void_is_one_of_two_words():
    with pytest.raises(UsageError, match="void"):
        RunOptions(void="never")


def test_settings_convert_their_numbers():
    found = SearchSettings(
        space=s2r.Space.of({"x": (0, 1)}),
        kernel=s2r.Kernel("rbf", 0.2),
        B=2,
        R=1,
        delta=0.1,
        epsilon=1,
        spread=3.0,
    )
    assert (found.B, type(found.B), found.spread, type(found.spread)) == (2.0, float, 3, int)
