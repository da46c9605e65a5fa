"""Relative errors of sums of responses, from machines whose sizes are known."""

import numpy as np
import pytest

from s2r_spec.diagnose.inference.additivity import relative_errors

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
    (rho,), (kappa,) = relative_errors(*machines(coherent, other), PARTS)
    # Without any error of its own direction, other errors project onto it: κ/√n.
    assert rho == pytest.approx(np.hypot(coherent, other / np.sqrt(OBSERVABLES)), rel=0.25, abs=0.03)
    assert kappa == pytest.approx(other, rel=0.15, abs=0.05)


def test_a_few_machines_that_slide_change_little():
    sums, rest, scatter = machines(0.1, 0.1)
    rest[:20] *= 100.0
    (rho,), (kappa,) = relative_errors(sums, rest, scatter, PARTS)
    assert rho < 0.15
    assert kappa < 0.15


def test_a_group_that_no_machine_moves_keeps_the_prior():
    sums, rest, scatter = machines(0.0, 0.0)
    (rho,), (kappa,) = relative_errors(0.0 * sums, rest, scatter, PARTS)
    assert rho == kappa == pytest.approx(0.1)


def test_a_machine_that_fell_does_not_count():
    sums, rest, scatter = machines(0.3, 0.0)
    rest[:5, 3] = np.nan
    (rho,), _ = relative_errors(sums, rest, scatter, PARTS)
    assert rho == pytest.approx(0.3, rel=0.25)
