"""Sets of effects by predictions of tests that they were not fitted to, on machines that are linear."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import lsq_linear
from scipy.stats import invgamma, multivariate_t

from s2r_spec.diagnose.inference import prediction
from s2r_spec.diagnose.inference.hierarchical import DEGREES, LAW_SHARE
from s2r_spec.diagnose.inference.observation import Observation
from s2r_spec.diagnose.inference.prediction import SetPrior, bounded, fitted, weighted
from s2r_spec.diagnose.inference.prior import BACKGROUND, UNNAMED, SizePrior
from s2r_spec.diagnose.simulator.curve import Curves, ResponseCurve
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.observables import Observables, ObservedQuantity
from s2r_spec.diagnose.simulator.response import Dependence, Practice, Response

EFFECTS, QUANTITIES, BINS = 4, 3, 50
SCATTER = 0.2
SETS = [(), (0,), (1,), (2,), (3,), (0, 1), (0, 2), (0, 3), (1, 2)]
PRIOR = SizePrior.of(list("abcd"), np.full(EFFECTS, -2.0), np.full(EFFECTS, 2.0))
POSITION = np.linspace(0.0, 1.0, BINS)


@cache
def signatures(tests, alike=None):
    """Return (tests, K, n) responses to a size of 1, smooth in time; that of the second may be nearly the first's."""
    rng = np.random.default_rng(100)
    waves = np.array([np.sin(np.pi * n * POSITION) for n in range(1, 9)])
    found = rng.normal(size=(tests, EFFECTS, QUANTITIES, 8)) @ waves
    if alike is not None:
        found[:, 1] = found[:, 0] + alike * found[:, 1]
    return found.reshape(tests, EFFECTS, -1)


@cache
def nominal(tests, alike=None):
    """Return the observation of a nominal machine in every test."""
    return [observation(own, np.zeros((1, QUANTITIES * BINS))) for own in signatures(tests, alike)]


def observation(design, runs):
    """Return the observation of a test, from (K, n) responses and (runs, n) what the machine does beyond nominal."""
    names = [f"q{n}" for n in range(QUANTITIES)]
    quantities = tuple(ObservedQuantity(name, name, "", np.ones(1)) for name in names)
    observables = Observables(5.0, quantities, ())
    bins = [place for g in observables.groups if g.statistic == "bin" for place in range(g.start, g.stop)]

    def whole(rows):
        full = np.zeros((*np.shape(rows)[:-1], observables.size))
        full[..., bins] = rows
        return full

    theta = 0.5 * np.random.default_rng(101).normal(size=(24, EFFECTS))
    ends = np.array([-2.0, 0.0, 2.0])
    zeros = np.zeros(observables.size)
    response = Response(
        Experiment("track"),
        observables,
        zeros,
        whole(np.full(len(bins), SCATTER)),
        zeros,
        tuple(ResponseCurve(ends, whole(ends[:, None] * own)) for own in design),
        np.zeros((EFFECTS, observables.size)),
        (),
        Practice(theta, np.zeros((24, 0)), whole(theta @ design)),
    )
    made = Observation.of(response, list(whole(runs)), Dependence(np.full(EFFECTS, -1), np.ones(EFFECTS)))
    number = np.array([float(places.size) for _, places in made.parts])
    return replace(made, law=0.0, form=np.zeros_like(made.form), effective=number)


def machine(truth, seed=0, tests=8, alike=None, other=None, scatter=SCATTER):
    """Return the observations of a machine of these sizes; ``other`` (tests, n) is what its laws do beside them."""
    rng = np.random.default_rng(seed)
    moved = truth @ signatures(tests, alike) + (0.0 if other is None else other)
    moved = moved + scatter * rng.normal(size=moved.shape)
    return [replace(one, observed=row) for one, row in zip(nominal(tests, alike), moved, strict=True)]


def candidates(data, prior=PRIOR, sets=SETS):
    background = [sum(BACKGROUND**2 * c.slope(0.0) ** 2 for c in one.curves) for one in data]
    return {members: fitted(data, background, np.zeros(prior.low.size), prior, members) for members in sets}


def posterior(data, prior=PRIOR, sets=SETS):
    return weighted(candidates(data, prior, sets), prior)


def chance(found, members):
    return dict(zip(found.sets, found.probability.tolist(), strict=True)).get(members, 0.0)


def small(seed):
    """Return sizes of effects that nobody added."""
    return np.clip(0.05 * np.random.default_rng(200 + seed).normal(size=EFFECTS), -0.1, 0.1)


@pytest.mark.parametrize("alike", [0.0, 1.0, 20.0])
def test_a_bounded_minimum_is_that_of_bounded_least_squares(alike):
    rng = np.random.default_rng(1)
    for size in (1, 3, 8, 20):
        for _ in range(8):
            mixing = rng.normal(size=(size, 2 * size)) + alike * np.outer(
                rng.normal(size=size), np.ones(2 * size)
            )
            precision = mixing @ mixing.T + np.eye(size)
            moment = precision @ (0.4 * rng.normal(size=size))
            high = np.where(rng.random(size) < 0.6, 0.125, 2.0)
            low = np.where(rng.random(size) < 0.3, 0.0, -high)
            low[0], high[0] = -np.inf, np.inf
            root = np.linalg.cholesky(precision)
            best = lsq_linear(root.T, np.linalg.solve(root, moment), (low, high), "bvls", tol=1e-12)
            assert bounded(precision, moment, low, high) == pytest.approx(best.x, abs=1e-6)


def test_a_minimum_within_the_bounds_is_that_without_them():
    precision, moment = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([0.3, -0.2])
    found = bounded(precision, moment, np.full(2, -5.0), np.full(2, 5.0))
    assert found == pytest.approx(np.linalg.solve(precision, moment))


def by_hand(data, deviation, t):
    """Return the log density of a test, from sizes and scales of the others at their fixed point."""
    others = [one for n, one in enumerate(data) if n != t]
    scales = np.ones(QUANTITIES)
    for _ in range(20):
        precision, moment = np.diag(deviation**-2.0), np.zeros(EFFECTS)
        for one in others:
            for s, (_, places) in zip(scales, one.parts, strict=True):
                f = np.array([curve.slope(0.0)[places] for curve in one.curves]) / np.sqrt(
                    s * one.noise[places]
                )
                precision += f @ f.T
                moment += f @ (one.observed[places] / np.sqrt(s * one.noise[places]))
        theta = np.linalg.solve(precision, moment)
        squares = [[(one.residual(theta) ** 2 / one.noise)[p].sum() for _, p in one.parts] for one in others]
        free = DEGREES + BINS * len(others)
        scales = (DEGREES + np.sum(squares, axis=0)) / free
    one = data[t]
    return sum(
        multivariate_t.logpdf(one.residual(theta)[p], shape=np.diag(s * one.noise[p]), df=free)
        for s, (_, p) in zip(scales, one.parts, strict=True)
    )


def left_out(data, own):
    """Return (T,) the log density of each test, given the others."""
    tests = prediction.Tests.of(data, np.zeros(EFFECTS))
    _, scales, _ = tests.fitted(np.ones(tests.test.size, dtype=bool), own)
    return tests.left_out(own, scales)


def test_the_density_of_a_left_out_test_is_that_computed_by_hand():
    data = machine(np.array([0.6, 0.0, 0.0, -0.4]), tests=5)
    own = SetPrior(PRIOR.deviation((0, 3)) ** -2.0, PRIOR.low, PRIOR.high)
    found = left_out(data, own)
    for t in range(len(data)):
        expected = by_hand(data, PRIOR.deviation((0, 3)), t)
        assert found[t] == pytest.approx(expected, abs=0.02)


def test_the_scale_of_a_quantity_that_only_the_left_out_test_has_is_that_of_the_prior():
    data = machine(np.zeros(EFFECTS), tests=4)
    first = data[0]
    alone = replace(first, parts=tuple(((f"own {name}", kind), p) for (name, kind), p in first.parts))
    found = left_out([alone, *data[1:]], SetPrior.of(PRIOR, ()))
    theta, *_ = prediction.Tests.of(data[1:], np.zeros(EFFECTS)).fitted(
        np.ones(9, dtype=bool), SetPrior.of(PRIOR, ())
    )
    expected = sum(
        multivariate_t.logpdf(first.residual(theta)[p], shape=np.diag(first.noise[p]), df=DEGREES)
        for _, p in first.parts
    )
    assert found[0] == pytest.approx(expected, abs=0.02)


def test_effects_that_nobody_added_are_in_no_probable_set():
    for seed in range(4):
        found = posterior(machine(small(seed), seed))
        assert found.sets[0] == ()
        assert found.probability[0] > 0.5
        assert (found.beyond() < 0.05).all()


def test_the_truth_lies_in_the_interval():
    """Two true sizes in each of 20 machines; and the set of both is the most probable one."""
    inside, sets = [], []
    for seed in range(20):
        truth = small(seed)
        truth[[0, 3]] = np.random.default_rng(300 + seed).uniform(0.3, 1.0, size=2) * [1.0, -1.0]
        found = posterior(machine(truth, seed), sets=[(), (0,), (0, 3), (0, 1, 3)])
        low, high = found.quantile(0.05), found.quantile(0.95)
        inside.append((low <= truth) & (truth <= high))
        sets.append(found.sets[0] == (0, 3))
    assert np.mean(inside, axis=0)[[0, 3]].min() >= 0.8
    assert np.mean(sets) >= 0.9


def test_two_effects_of_nearly_the_same_signature_share_the_probability():
    shared = [
        posterior(machine(np.array([0.7, 0.0, 0.0, 0.0]), seed, alike=0.01), sets=SETS[:6])
        for seed in range(4)
    ]
    for found in shared:
        assert 0.05 < chance(found, (0,)) < 0.95
        assert chance(found, (0,)) + chance(found, (1,)) > 0.6
        assert chance(found, ()) < 1e-3
    apart = posterior(machine(np.array([0.7, 0.0, 0.0, 0.0]), alike=0.5))
    assert chance(apart, (0,)) > 0.8


@pytest.mark.parametrize("size", [1.0, 5.0])
def test_one_test_that_differs_does_not_decide(size):
    """In one of eight tests the machine does what an effect does that is nowhere else."""
    other = np.zeros((8, QUANTITIES * BINS))
    other[4] = size * signatures(8)[4, 2]
    found = posterior(machine(np.zeros(EFFECTS), other=other))
    assert found.sets[0] == ()
    assert found.beyond()[2] < 0.05


def test_what_is_no_cause_lies_below_an_eighth():
    data = machine(np.array([0.7, 0.4, 0.0, 0.0]))
    for members, one in candidates(data).items():
        others = np.delete(np.abs(one.theta), list(members))
        assert (others <= UNNAMED + 1e-9).all()


def test_a_quantity_of_other_laws_does_not_decide_a_size():
    """The last of three quantities shows a size of 0.7 as 1.4, with a shape of its own besides."""
    other = np.zeros((8, QUANTITIES, BINS))
    other[:, 2] = 0.7 * signatures(8)[:, 0].reshape(8, QUANTITIES, BINS)[:, 2]
    other[:, 2] += 2.0 * np.sin(11.0 * np.pi * POSITION)
    truth = np.array([0.7, 0.0, 0.0, 0.0])
    found, plain = (
        candidates(machine(truth, other=o), sets=[(0,)])[0,] for o in (other.reshape(8, -1), None)
    )
    assert found.theta[0] == pytest.approx(0.7, abs=0.1)
    assert found.deviation[0] > plain.deviation[0]


def test_more_tests_do_not_make_a_size_exact():
    truth = np.array([0.8, 0.0, 0.0, 0.0])
    few, many = (candidates(machine(truth, tests=n, scatter=0.02), sets=[(0,)])[0,] for n in (5, 25))
    assert many.deviation[0] == pytest.approx(few.deviation[0], rel=0.05)
    assert many.deviation[0] >= np.hypot(0.03, 0.1 * many.theta[0])


def test_the_order_of_tests_of_groups_and_of_parameters_changes_nothing():
    data = machine(np.array([0.5, 0.0, -0.3, 0.0]), tests=6)
    sets = [(), (0,), (2,), (0, 2)]
    first = candidates(data, sets=sets)
    order = [3, 1, 5, 0, 2, 4]
    again = candidates([data[t] for t in order], sets=sets)
    turned = [replace(one, parts=tuple(reversed(one.parts)), effective=one.effective[::-1]) for one in data]
    swapped = candidates(turned, sets=sets)
    for members in sets:
        assert again[members].theta == pytest.approx(first[members].theta, abs=1e-9)
        assert again[members].deviation == pytest.approx(first[members].deviation, abs=1e-9)
        assert again[members].score == pytest.approx(first[members].score[order], abs=1e-6)
        assert swapped[members].theta == pytest.approx(first[members].theta, abs=1e-9)
        assert swapped[members].score == pytest.approx(first[members].score, abs=1e-6)
    reverse = [replace(one, curves=Curves(one.curves[::-1])) for one in data]
    other = candidates(reverse, sets=[tuple(3 - k for k in members[::-1]) for members in sets])
    for members in sets:
        one = other[tuple(3 - k for k in members[::-1])]
        assert one.theta[::-1] == pytest.approx(first[members].theta, abs=1e-9)
        assert one.score == pytest.approx(first[members].score, abs=1e-6)
    posteriors = [weighted(each, PRIOR) for each in (first, again)]
    for members in sets:
        assert chance(posteriors[1], members) == pytest.approx(chance(posteriors[0], members), abs=1e-6)


def test_the_same_data_give_the_same_bits():
    one, other = (posterior(machine(np.array([0.3, 0.0, 0.0, 0.0]))) for _ in range(2))
    assert one.sets == other.sets
    assert (one.probability == other.probability).all()
    assert (one.mean == other.mean).all()
    assert (one.deviation == other.deviation).all()


def test_a_test_of_lost_observables_counts_as_far_as_it_goes():
    """Of two tests the second half is missing: that run ended early."""
    truth = np.array([0.7, 0.0, 0.0, 0.0])
    data = machine(truth)
    cut = []
    for one in data[:2]:
        rows = one.observed.reshape(QUANTITIES, BINS).copy()
        rows[:, BINS // 2 :] = np.nan
        design = np.array([c.slope(0.0) for c in one.curves])
        cut.append(observation(design, rows.reshape(1, -1)))
    assert all(one.kept.size == QUANTITIES * BINS // 2 for one in cut)
    found = posterior([*cut, *data[2:]])
    assert found.sets[0] == (0,)
    assert found.mean[0][0] == pytest.approx(0.7, abs=0.05)


def candidate(theta, score, information):
    theta, blank = np.array(theta), np.zeros(0)
    members = tuple(np.flatnonzero(theta).tolist())
    return prediction.Candidate(members, theta, np.ones(theta.size), np.array([score]), blank, information)


def informed(*each):
    """Return the information of groups of two kinds, one test each, about two effects."""
    return prediction.Information(np.array([np.diag(one) for one in each]), np.arange(2))


TOGETHER = informed([400.0, 100.0], [400.0, 100.0])
APART = informed([800.0, 0.0], [0.0, 200.0])


def left_of(score, information=TOGETHER):
    """Return what is left of a difference of scores, by which a second effect beside one of 1 predicts better."""
    better, worse = candidate([1.0, 0.2], 0.0, information), candidate([1.0, 0.0], -score, information)
    return score * prediction.part_left(better, worse)


@pytest.mark.parametrize("score", [1.0, 10.0, 100.0])
def test_a_second_effect_counts_as_far_as_the_law_of_the_first_is_known(score):
    """Along the second the score has a variance of 8, and 1,600 ρ² more where the law of the first is off by ρ."""

    def density(log):
        square = np.exp(log)
        ratio = 1.0 + 200.0 * square
        prior = invgamma.pdf(square, DEGREES / 2.0, scale=DEGREES * LAW_SHARE**2 / 2.0) * square
        return prior * np.exp(-score / ratio) / np.sqrt(ratio)

    assert left_of(score) == pytest.approx(-np.log(quad(density, -9.0, 14.0, limit=200)[0]), abs=1e-3)
    assert left_of(score, APART) == score
    alone = candidate([1.0, 0.0], 0.0, TOGETHER)
    assert prediction.part_left(alone, alone) == 1.0


def test_no_error_of_a_law_makes_an_effect_of_none():
    both, nothing = candidate([1.0, 0.2], 0.0, TOGETHER), candidate([0.0, 0.0], -400.0, TOGETHER)
    assert prediction.part_left(both, nothing) == 1.0


def test_tests_of_one_kind_share_the_error_of_a_law():
    """Twice the tests say twice as much, and an error of the law does not average out."""
    twice = prediction.Information(np.tile(TOGETHER.each, (2, 1, 1)), np.tile(TOGETHER.kind, 2))
    assert left_of(100.0, twice) < 0.9 * left_of(100.0)


def test_no_score_proves_more_than_that_the_law_of_no_effect_is_far_off():
    left = [left_of(score) for score in (1.0, 10.0, 100.0, 1e4)]
    assert left == sorted(left)
    assert left[0] > 0.7
    assert left[-1] - left[-2] < 2.5 * np.log(100.0)


def test_directions_in_which_effects_move_a_kind_are_counted_once():
    alike = prediction.Information(np.full((1, 3, 3), 5.0), np.zeros(1, dtype=int))
    apart = prediction.Information(np.eye(3)[None], np.zeros(1, dtype=int))
    unseen = prediction.Information(np.diag([4.0, 4.0, 0.0])[None], np.zeros(1, dtype=int))
    assert [float(one.ranks[0]) for one in (alike, apart, unseen)] == pytest.approx([1.0, 3.0, 2.0])


def test_a_size_is_known_to_a_tenth_of_the_effects_in_its_groups():
    alone = TOGETHER.law_variances(np.array([0.5, 0.0]))
    assert alone[0] == pytest.approx(0.05**2)
    assert alone[1] == pytest.approx(0.05**2 * 2.0 * 400.0 * 100.0 / 2.0 / 200.0**2)
    assert APART.law_variances(np.array([0.5, 0.0]))[1] == pytest.approx(0.0)
