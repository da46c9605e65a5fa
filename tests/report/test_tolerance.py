import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.report.figures.tolerance import Component, held_predicates, margins, reads

HEAD = "signal x {m}\nsignal u[2]\nparam p {m} in [0, 1]\n"


def formula(text):
    spec = s2r.parse_spec(HEAD + f"require r: {text}")
    return spec, spec.formulas["r"]


@pytest.mark.parametrize(
    ("text", "windows"),
    [
        ("always[0, 1 s] (x <= p)", [(0, 1)]),
        ("always[1 s, 2 s] always[0, 3 s] (x <= p and u[0] >= 0)", [(1, 5), (1, 5)]),
        ("x <= p", [(0, 0)]),
        ("always[0, 1 s] (x <= p) and eventually[0, 1 s] (x >= 0 {m})", [(0, 1)]),
        ("always[0, 1 s] (x <= p or u[0] >= 0)", []),
        ("not (always[0, 1 s] (x <= p))", []),
    ],
)
def test_what_must_hold_throughout(text, windows):
    assert [(must.start, must.end) for must in held_predicates(formula(text)[1])] == windows


def test_what_a_predicate_reads():
    (must,) = held_predicates(formula("always[0, 1 s] (u[1] >= 0)")[1])
    assert [reads(must.predicate, Component.of_label(label)) for label in ("u[0]", "u[1]", "x")] == [
        False,
        True,
        False,
    ]


def test_the_margin_is_that_of_the_value_and_not_of_the_trace():
    spec, node = formula("always[0.5 s, 1 s] (abs(x - p) <= 0.25 {m})")
    times = np.linspace(0, 2, 21)
    trace = s2r.Trace(times, {"x": np.sin(times)}, {"x": "m"})
    (must,) = held_predicates(node)
    values = np.array([-1.0, 0.5, 0.6, 0.75, 2.0])
    found = margins(spec, trace, {"p": 0.5}, must, Component("x"), values)
    np.testing.assert_allclose(found.times, times[5:11])
    np.testing.assert_allclose(found.margins, np.repeat(0.25 - abs(values - 0.5), 6).reshape(5, 6))


def test_a_trace_that_ends_before_it_matters_has_no_margins():
    spec, node = formula("always[0.5 s, 1 s] (x <= p)")
    trace = s2r.Trace(np.linspace(0, 0.4, 5), {"x": np.zeros(5)})
    assert margins(spec, trace, {"p": 0.5}, *held_predicates(node), Component("x"), np.zeros(3)) is None
