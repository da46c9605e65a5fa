"""Choosing by certified worst cases: what may be said, and of whom nothing may."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.choose import choose
from s2r_spec.errors import UsageError
from tests.errors import naming


def checked(backend, lower, upper, label=Label.CERTIFIED, spec="s", requirement="walking", delta=0.01):
    return SimpleNamespace(
        requirement=requirement,
        lower=lower,
        upper=upper,
        certificate=SimpleNamespace(label=label, delta=delta),
        provenance={"backend": backend, "spec_hash": spec},
        folder=Path(backend),
    )


def test_the_largest_lower_bound_is_taken_and_the_rest_bounds_what_was_missed():
    found = choose([checked("a", 0.1, 0.2), checked("b", 0.15, 0.16), checked("c", -1.0, 0.3)])
    assert (found.best, found.lower) == (1, 0.15)
    assert found.regret == pytest.approx(0.15)  # c may be as good as 0.3
    assert found.delta == pytest.approx(0.03)


@pytest.mark.parametrize("label", [Label.REFUSED, Label.MODEL_BASED])
def test_an_interval_that_is_no_promise_is_never_chosen(label):
    found = choose([checked("a", 0.9, 0.95, label), checked("b", 0.1, 0.2)])
    assert (found.best, found.refused, found.regret) == (1, (0,), 0.0)
    assert choose([checked("a", 0.9, 1.0, label), checked("b", 0.9, 1.0, label)]).best is None


@pytest.mark.parametrize("other", [{"spec": "t"}, {"requirement": "standing"}])
def test_worst_cases_of_different_requirements_are_not_compared(other):
    with pytest.raises(UsageError, match=naming("a", "b")):
        choose([checked("a", 0.1, 0.2), checked("b", 0.1, 0.2, **other)])


def test_a_choice_needs_two_candidates_of_different_names():
    with pytest.raises(UsageError):
        choose([checked("a", 0.1, 0.2)])
    with pytest.raises(UsageError, match="'b'"):
        choose([checked("a", 0.1, 0.2), checked("b", 0.1, 0.2), checked("b", 0.3, 0.4)])


def test_whoever_is_better_than_all_others_can_be_is_chosen_without_regret():
    found = choose([checked("a", 0.1, 0.2, delta=0.7), checked("b", 0.3, 0.4, delta=0.6)])
    assert (found.best, found.regret, found.delta) == (1, 0.0, 1.0)


def test_nothing_is_said_where_every_certificate_was_refused():
    found = choose([checked("a", 0.9, 1.0, Label.REFUSED), checked("b", 0.9, 1.0, Label.REFUSED)])
    assert (found.lower, found.regret, found.refused) == (float("-inf"), float("inf"), (0, 1))
