"""The joint estimate: a search over the points of the library, then Gauss–Newton."""

import numpy as np
import pytest

from s2r_spec.diagnose.inference.gauss_newton import Errors, fit
from s2r_spec.diagnose.inference.hierarchical import LAW_SHARE
from s2r_spec.diagnose.inference.observation import Observation, Problem
from s2r_spec.diagnose.inference.prior import SizePrior
from s2r_spec.diagnose.inference.search import search
from s2r_spec.diagnose.simulator.curve import ResponseCurve, Turn
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.observables import Observables, ObservedQuantity
from s2r_spec.diagnose.simulator.response import Dependence, Practice, Response

POSITION = np.linspace(0.0, 6.0 * np.pi, 50)
SCATTER = 0.05
PRIOR = SizePrior.of(
    ["ripple", "ripple", "offset"],
    np.array([0.0, -np.inf, -2.0]),
    np.array([2.0, np.inf, 2.0]),
    np.array([False, True, False]),
)
DEPENDENCE = Dependence(np.array([-1, 0, -1]), np.ones(3))


def force(amplitude, phase, offset):
    """Force along a track; a phase of 1 is half a turn."""
    return amplitude * np.sin(POSITION + np.pi * phase) + offset


def curve(points, of, kind=ResponseCurve):
    return kind(np.array(points), np.array([of(x) for x in points]))


def problem(amplitude, phase, offset):
    """A machine with a ripple, and the library of a simulator."""
    rng = np.random.default_rng(1)
    observables = Observables(5.0, (ObservedQuantity("force", "force", "", np.ones(1)),), ())
    size = observables.groups[-1].stop
    places = slice(observables.groups[0].start, observables.groups[0].stop)

    def whole(values):
        row = np.zeros(size)
        row[places] = values
        return row

    theta = np.clip(0.5 * rng.normal(size=(24, 3)), PRIOR.low, PRIOR.high)
    curves = (
        curve([0.0, 0.3, 1.0, 2.0], lambda a: whole(force(a, 0.0, 0.0))),
        curve([-1.0, -0.5, 0.0, 0.5], lambda p: whole(force(1.0, p, 0.0) - force(1.0, 0.0, 0.0)), Turn),
        curve([-2.0, 0.0, 2.0], lambda x: whole(force(0.0, 0.0, x))),
    )
    practice = np.array([whole(force(*each)) for each in theta]) + SCATTER * rng.normal(size=(24, size))
    zeros = np.zeros(size)
    response = Response(
        Experiment("track"),
        observables,
        zeros,
        np.full(size, SCATTER),
        zeros,
        curves,
        np.zeros((3, size)),
        (),
        Practice(theta, np.zeros((24, 0)), practice),
    )
    runs = [whole(force(amplitude, phase, offset)) + SCATTER * rng.normal(size=size) for _ in range(2)]
    return Problem((Observation.of(response, runs, DEPENDENCE),), PRIOR)


@pytest.mark.parametrize("phase", [-0.95, -0.4, 0.0, 0.25, 0.7])
def test_a_ripple_is_found_at_any_phase(phase):
    """At a quarter of a turn the ripple has no response along that of phase 0, and beyond the opposite one."""
    of = problem(0.9, phase, 0.4)
    assert search(of)[0] > 0.25
    amplitude, angle, offset = fit(of).theta
    assert (amplitude, offset) == pytest.approx((0.9, 0.4), abs=0.05)
    assert (angle - phase + 1.0) % 2.0 - 1.0 == pytest.approx(0.0, abs=0.02)


def test_a_machine_without_a_ripple_gets_none():
    assert abs(fit(problem(0.0, 0.0, 0.4)).theta[0]) < 0.05


def test_an_error_of_size_leaves_no_residual_and_stays():
    of = problem(1.0, 0.25, 0.4)
    theta = fit(of).theta
    shared = fit(of, theta, errors=Errors.at(of, theta)).shared
    assert (shared >= (LAW_SHARE * theta) ** 2).all()


def test_a_run_at_the_estimate_is_exact_only_as_far_as_it_reaches():
    given = problem(0.8, 0.5, 0.0)
    (one,) = given.observations
    theta = np.array([0.8, 0.5, 0.0])
    whole = np.zeros(one.response.nominal.size)
    cut = np.where(np.arange(whole.size) < one.kept[len(one.kept) // 2], whole, np.nan)
    bare, full, part = (
        each.errors(theta) for each in (one, one.corrected(whole, theta), one.corrected(cut, theta))
    )
    half = len(one.kept) // 2
    assert (full < bare).all()
    assert part[:half] == pytest.approx(full[:half])
    assert part[half:] == pytest.approx(bare[half:])
    assert np.isfinite(one.corrected(cut, theta).residual(theta)).all()
