"""Prior of sets: an effect is as probable with three parameters as with one."""

from itertools import combinations

import numpy as np
import pytest

from s2r_spec.diagnose.inference.prior import ACTIVE, SizePrior

PRIOR = SizePrior.of(
    ["rub", "rub", "rub", "delay", "delay"], np.full(5, -2.0), np.full(5, 2.0), np.arange(5) == 4
)


def odds(members):
    return np.exp(PRIOR.log_odds(members))


def test_all_choices_of_an_effects_parameters_together_have_its_probability():
    every = [odds(own) for n in (1, 2, 3) for own in combinations((0, 1, 2), n)]
    assert len({round(one, 12) for one in every}) == 1
    assert sum(every) == pytest.approx(ACTIVE / (1.0 - ACTIVE))


def test_effects_are_independent_and_a_dependent_parameter_is_no_cause():
    assert odds((3,)) == pytest.approx(ACTIVE / (1.0 - ACTIVE))
    assert odds((0, 2, 3)) == pytest.approx(odds((0, 2)) * odds((3,)))
    assert odds(()) == 1.0


def test_a_set_has_effects_with_their_parameters():
    assert PRIOR.effects((0, 2, 3)) == {0: (0, 2), 1: (3,)}
