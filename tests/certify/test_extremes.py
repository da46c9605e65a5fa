"""Settings that double precision, or anybody, cannot work with: one sentence that names the setting."""

import math

import numpy as np
import pytest

from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.search.plan_request import plan
from s2r_spec.certify.search.search import Search
from s2r_spec.errors import UsageError
from s2r_spec.space import Space
from s2r_spec.spec import parse_spec

USUAL = {"B": 1.5, "R": 0.02, "delta": 1e-3, "epsilon": 0.1, "budget": 40}
KERNEL = Kernel("matern52", 0.2)
ODD = (None, "0.1", b"1", True, [1, 2], {}, complex(1, 1), math.nan, math.inf, -math.inf, 10**400, -1)


@pytest.mark.parametrize("name", ["B", "R", "epsilon", "batch", "delta"])
@pytest.mark.parametrize("value", [*ODD, 0, 1e308, 1e-300, 5e-324], ids=repr)
def test_a_number_that_is_none_names_its_setting(name, value):
    with pytest.raises(UsageError, match=rf"{name} = "):
        Search({"x": (0, 1)}, kernel=KERNEL, **(USUAL | {name: value}))


@pytest.mark.parametrize("name", ["seed", "spread", "budget"])
@pytest.mark.parametrize("value", [*ODD[1:], 2.5], ids=repr)
def test_a_count_that_is_none_names_its_setting(name, value):
    with pytest.raises(UsageError, match=rf"{name} = "):
        Search({"x": (0, 1)}, kernel=KERNEL, **(USUAL | {name: value}))


def test_a_large_seed_is_a_seed():
    assert Search({"x": (0, 1)}, kernel=KERNEL, seed=10**30, **USUAL).ask()


@pytest.mark.parametrize(
    "value", [*ODD[:9], 10**400, 0, 1e300, 1e-300, (0.1, None), (0.1, 1e-200), ()], ids=repr
)
def test_a_lengthscale_that_is_none_names_its_kernel(value):
    if isinstance(value, list):
        value = [*value, None]
    with pytest.raises(UsageError, match="the lengthscale of rbf"):
        Kernel("rbf", value)


@pytest.mark.parametrize(
    "ends",
    [
        None, 3, "ab", (0,), (0, 1, 2), ("a", "b"), (None, 1), (1, 0), (0, math.inf), (math.nan, 1),
        (-1e308, 1e308), (0, 1e308), (0, 5e-324), (1, 1 + 4e-16), (1e9, 1e9 + 1e-3), (0, 10**400),
    ],
    ids=repr,
)  # fmt: skip
def test_a_range_that_cannot_be_divided_names_its_parameter(ends):
    with pytest.raises(UsageError, match="the range of 'load'"):
        Search({"load": ends}, kernel=KERNEL, **USUAL)


@pytest.mark.parametrize("space", [None, 3, "x", [("x", 0, 1)]], ids=repr)
def test_a_space_that_is_none(space):
    with pytest.raises(UsageError, match="a test space is a mapping"):
        Search(space, kernel=KERNEL, **USUAL)


def test_a_test_point_that_is_no_number():
    space = Space.of({"x": (0, 1)})
    for value in (None, "0.5", math.nan, 10**400):
        with pytest.raises(UsageError, match="x = "):
            space.vector({"x": value})


@pytest.mark.parametrize("value", [1e308, -1e200])
def test_an_outcome_that_cannot_be_squared(value):
    search = Search({"x": (0, 1)}, kernel=KERNEL, **USUAL)
    query = search.ask()[0]
    with pytest.raises(UsageError, match=r"query 0 at .* is beyond 1e\+100"):
        search.tell(query, np.full(query.replicates, value))


def test_a_plan_simulates_no_budget_that_it_cannot_hold():
    settings = {name: USUAL[name] for name in ("B", "R", "delta", "epsilon")}
    with pytest.raises(UsageError, match=r"budget = 1e\+12"):
        plan(Space.of({"x": (0, 1)}), kernel=KERNEL, **settings, budgets=(10**12,))


def test_a_plan_of_an_epsilon_out_of_reach_is_an_answer_at_once():
    settings = {name: USUAL[name] for name in ("B", "R", "delta")}
    found = plan(Space.of({"x": (0, 1)}), kernel=KERNEL, **settings, epsilon=1e-30)
    assert found.floor > 1e50
    assert (found.peaked, found.flat) == (None, None)


@pytest.mark.parametrize(
    ("line", "place"),
    [
        ("R = 1e308", (4, 16)),
        ("B = 1e-300", (4, 16)),
        ("epsilon = 1e-300", (4, 22)),
        ("delta = 1e-320", (4, 20)),
        ("delta = 1 - 1e-17", (4, 20)),
        ("fall = -1e308", (4, 19)),
        ("kernel = rbf(1e-300)", (4, 25)),
        ("kernel = rbf(1e300)", (4, 25)),
    ],
)
def test_a_setting_of_a_specification_has_a_place(line, place):
    with pytest.raises(UsageError) as caught:
        parse_spec(f"signal x\nparam q in [0, 1]\nrequire a: x <= q\ncertify a: {line}\n", "a.stl")
    (mistake,) = caught.value.diagnostics
    assert (mistake.span.line, mistake.span.column) == place
    assert line.split()[0] in mistake.message or "lengthscale of `q`" in mistake.message


def test_a_range_wider_than_the_largest_number_has_a_place():
    with pytest.raises(UsageError) as caught:
        parse_spec("signal x\nparam q in [-1e308, 1e308]\nrequire a: x <= 1\n", "a.stl")
    (mistake,) = caught.value.diagnostics
    assert (mistake.code, mistake.span.line, mistake.span.text) == ("E09", 2, "in [-1e308, 1e308]")
