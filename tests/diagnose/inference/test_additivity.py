"""Relative errors of sums of responses, from machines whose sizes are known."""

import numpy as np
import pytest

from s2r_spec.diagnose.inference.additivity import effective_number, relative_errors

MACHINES, OBSERVABLES = 200, 40
PARTS = [np.arange(OBSERVABLES)]


def machines(coherent, other, scatter=0.1, seed=0):
    """Return sums, rest and scatter of machines with these relative errors."""
    rng = np.random.default_rng(seed)
    sums = rng.normal(size=(MACHINES, OBSERVABLES))
    rest = coherent * rng.normal(size=(MACHINES, 1)) * sums + other * rng.normal(size=sums.shape)
    return sums, rest + scatter * rng.normal(size=sums.shape), np.full(sums.shape, scatter)


@pytest.mark.parametrize(("coherent", "other"), [(0.05, 0.0), (0.4, 0.2), (0.0, 0.8)])
def test_the_errors_of_machines_are_found(coherent, other):
    (rho,), (kappa,), _ = relative_errors(*machines(coherent, other), PARTS)
    # Without any error of its own direction, other errors project onto it: κ/√n.
    assert rho == pytest.approx(np.hypot(coherent, other / np.sqrt(OBSERVABLES)), rel=0.25, abs=0.03)
    assert kappa == pytest.approx(other, rel=0.15, abs=0.05)


def test_a_few_machines_that_slide_change_little():
    sums, rest, scatter = machines(0.1, 0.1)
    rest[:20] *= 100.0
    (rho,), (kappa,), _ = relative_errors(sums, rest, scatter, PARTS)
    assert rho < 0.15
    assert kappa < 0.15


def test_a_group_that_no_machine_moves_keeps_the_prior():
    sums, rest, scatter = machines(0.0, 0.0)
    (rho,), (kappa,), _ = relative_errors(0.0 * sums, rest, scatter, PARTS)
    assert rho == kappa == pytest.approx(0.1)


def test_a_machine_that_fell_does_not_count():
    sums, rest, scatter = machines(0.3, 0.0)
    rest[:5, 3] = np.nan
    (rho,), _, _ = relative_errors(sums, rest, scatter, PARTS)
    assert rho == pytest.approx(0.3, rel=0.25)


@pytest.mark.parametrize("alike", [1, 4, 20])
def test_errors_that_are_alike_count_once(alike):
    """Every error is repeated so many times along the trace."""
    rng = np.random.default_rng(2)
    errors = np.repeat(rng.normal(size=(24, OBSERVABLES // alike)), alike, axis=1)
    assert effective_number(errors) == pytest.approx(OBSERVABLES / alike, rel=0.2)


def test_errors_of_any_size_say_the_same_about_their_number():
    rng = np.random.default_rng(3)
    errors = rng.normal(size=(24, OBSERVABLES))
    sizes = rng.uniform(0.01, 100.0, size=(24, 1))
    assert effective_number(sizes * errors) == pytest.approx(effective_number(errors))


def test_the_number_is_one_for_a_single_shape_and_all_without_machines():
    assert effective_number(np.outer(np.arange(1.0, 9.0), np.arange(OBSERVABLES))) == pytest.approx(1.0)
    assert effective_number(np.zeros((5, OBSERVABLES))) == OBSERVABLES
