"""Whether a machine is one of the catalogue: machines drawn from the model are, and a cause outside it is not."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_spec.diagnose.inference.gauss_newton import fit
from s2r_spec.diagnose.inference.goodness_of_fit import goodness_of_fit
from s2r_spec.diagnose.inference.hierarchical import DEGREES, LAW_ERROR
from s2r_spec.diagnose.inference.observation import Observation, Problem
from s2r_spec.diagnose.inference.prior import SizePrior
from s2r_spec.diagnose.simulator.curve import ResponseCurve
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.observables import Observables, ObservedQuantity
from s2r_spec.diagnose.simulator.response import Dependence, Practice, Response

EFFECTS, SCATTER, DURATION = 3, 0.05, 5.0
QUANTITIES = ("torque", 2), ("speed", 1)
TESTS = [Experiment("chirp"), Experiment("steps")]
DEPENDENCE = Dependence(np.full(EFFECTS, -1), np.ones(EFFECTS))
PRIOR = SizePrior.of([f"effect {k}" for k in range(EFFECTS)], np.full(EFFECTS, -2.0), np.full(EFFECTS, 2.0))


def observables(quantities=QUANTITIES):
    return Observables(
        DURATION, tuple(ObservedQuantity(name, name, "", np.ones(width)) for name, width in quantities), ()
    )


def responses(experiment):
    """Return (K, m) of smooth responses to every effect."""
    rng = np.random.default_rng(TESTS.index(experiment))
    rows = np.zeros((EFFECTS, observables().groups[-1].stop))
    for group in observables().groups:
        size = group.stop - group.start
        phase = np.linspace(0.0, 2 * np.pi, size) * rng.uniform(1, 3, (EFFECTS, 1)) + rng.uniform(
            0, 6, (EFFECTS, 1)
        )
        rows[:, group.start : group.stop] = np.sin(phase)
    return rows


def response(experiment):
    rows, points = responses(experiment), np.array([-2.0, 0.0, 2.0])
    rng = np.random.default_rng(9)
    theta, size = 0.5 * rng.normal(size=(24, EFFECTS)), rows.shape[1]
    practice = theta @ rows + SCATTER * rng.normal(size=(24, size))
    zeros = np.zeros(size)
    return Response(
        experiment,
        observables(),
        zeros,
        np.full(size, SCATTER),
        zeros,
        tuple(ResponseCurve(points, points[:, None] * row) for row in rows),
        np.zeros((EFFECTS, size)),
        np.zeros((0, size)),
        Practice(theta, np.zeros((24, 0)), practice),
    )


@pytest.fixture(scope="module")
def known():
    return {experiment: response(experiment) for experiment in TESTS}


def machine(rng, theta):
    """Return two runs of each experiment, of other laws: all groups see sizes that are off by a tenth.

    Beside it every group has a law error and a scatter of its own, with variances from their priors.
    """
    runs = {}
    theta = theta * (1.0 + 0.1 * rng.normal(size=EFFECTS))
    for experiment in TESTS:
        mean, scatter = np.zeros(observables().groups[-1].stop), np.zeros(observables().groups[-1].stop)
        for group in observables().groups:
            places = slice(group.start, group.stop)
            law, noise = np.sqrt(DEGREES / rng.chisquare(DEGREES, 2))
            seen = theta + LAW_ERROR * law * rng.normal(size=EFFECTS)
            mean[places] = seen @ responses(experiment)[:, places]
            scatter[places] = SCATTER * noise
        runs[experiment] = [mean + scatter * rng.normal(size=mean.size) for _ in range(2)]
    return runs


def goodness(known, runs, looks=1, columns=None):
    observations = tuple(Observation.of(known[e], each, DEPENDENCE) for e, each in runs.items())
    problem = Problem(observations, PRIOR)
    return goodness_of_fit(problem, fit(problem), looks, columns)


def test_machines_of_other_laws_alarm_at_the_level(known):
    rng = np.random.default_rng(3)
    sizes = np.zeros(EFFECTS), np.array([0.0, -1.2, 0.0]), np.array([0.8, 0.0, 0.6])
    alarms = [goodness(known, machine(rng, theta)).alarm for _ in range(10) for theta in sizes]
    assert sum(alarms) <= 4  # of 30 at a level of 5 %, in 19 of 20 cases


def pushed(seed=4):
    """Return a machine that a push moves in the fourth fifth of the steps, in the second torque."""
    runs = machine(np.random.default_rng(seed), np.array([0.0, 0.7, 0.0]))
    for run in runs[TESTS[1]]:
        bins = run[:100].reshape(50, 2)  # a view of the means of the torque
        bins[31:39, 1] += 3.0
    return runs


def test_a_push_outside_the_catalogue_alarms_and_is_found(known):
    found = goodness(known, pushed(), columns={"torque": ("left", "right")})
    assert found.alarm
    assert found.p <= 0.01
    worst = found.worst
    assert (worst.experiment, worst.quantity, worst.statistic, worst.part) == (
        TESTS[1],
        "torque",
        "bin",
        "right",
    )
    assert (worst.begin, worst.end) == pytest.approx((3.0, 4.0))
    assert "2" in goodness(known, pushed()).worst.part


def test_the_order_of_experiments_and_effects_changes_nothing(known):
    runs, turn = pushed(), [2, 0, 1]
    first = goodness(known, runs)
    turned = {
        experiment: replace(
            one,
            curves=tuple(one.curves[k] for k in turn),
            spread=one.spread[turn],
            practice=replace(one.practice, theta=one.practice.theta[:, turn]),
        )
        for experiment, one in reversed(known.items())
    }
    again = goodness(turned, dict(reversed(runs.items())))
    assert again.p == pytest.approx(first.p, abs=0.005)
    assert again.worst == first.worst


def test_a_campaign_with_more_looks_has_a_lower_level_at_each(known):
    runs = machine(np.random.default_rng(5), np.zeros(EFFECTS))
    one, many = goodness(known, runs), goodness(known, runs, looks=10)
    assert many.p == one.p
    assert many.level == pytest.approx(one.level / 10)
    assert goodness(known, pushed()).p <= 0.05 / 10


def test_a_run_that_ended_early_is_tested_as_far_as_it_goes(known):
    runs = machine(np.random.default_rng(6), np.zeros(EFFECTS))
    for each in runs.values():
        for run in each:
            run[60:100] = np.nan
    found = goodness(known, runs)
    assert not found.alarm
    assert 0.0 <= found.worst.begin < found.worst.end <= DURATION
