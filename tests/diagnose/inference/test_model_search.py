"""Sets of effects and sizes from a Gaussian likelihood."""

import numpy as np
import pytest
from scipy.stats import norm

from s2r_spec.diagnose.inference.hierarchical import Likelihood
from s2r_spec.diagnose.inference.model_search import combine, posterior
from s2r_spec.diagnose.inference.prior import BACKGROUND, NAMED, SLAB, SizePrior

PARAMETERS = 8


def prior(low=-3.0, names=None):
    names = names or [f"effect {k}" for k in range(PARAMETERS)]
    return SizePrior.of(names, np.full(len(names), low), np.full(len(names), 3.0))


def likelihood(estimate, information):
    """Return the likelihood around 0 of an estimate with this information."""
    return Likelihood(information, information @ estimate)


def measured(rng, truth, deviation=0.03):
    mixing = np.eye(PARAMETERS) + 0.3 * rng.normal(size=(PARAMETERS, PARAMETERS))
    information = mixing @ mixing.T / deviation**2
    return truth + np.linalg.cholesky(np.linalg.inv(information)) @ rng.normal(size=PARAMETERS), information


def test_evidence_is_that_of_the_direct_formula():
    rng = np.random.default_rng(1)
    truth = np.zeros(PARAMETERS)
    truth[2] = 0.2
    estimate, information = measured(rng, truth, 0.1)
    given = prior()
    found = posterior(likelihood(estimate, information), np.zeros(PARAMETERS), given)

    def log_evidence(members):
        deviation = np.where(np.isin(np.arange(PARAMETERS), members), SLAB, BACKGROUND)
        covariance = np.linalg.inv(information) + np.diag(deviation**2)
        odds = np.log(given.probability[list(members)] / (1 - given.probability[list(members)])).sum()
        return odds - 0.5 * (
            estimate @ np.linalg.solve(covariance, estimate) + np.linalg.slogdet(covariance)[1]
        )

    expected = np.array([log_evidence(members) for members in found.sets])
    expected = np.exp(expected - expected.max())
    assert found.probability == pytest.approx(expected / expected.sum(), abs=1e-9)


def test_two_causes_are_named_and_nothing_else():
    rng = np.random.default_rng(2)
    truth = 0.03 * rng.normal(size=PARAMETERS)
    truth[[1, 5]] = 0.6, -0.5
    estimate, information = measured(rng, truth)
    found = posterior(likelihood(estimate, information), np.zeros(PARAMETERS), prior())
    assert found.sets[0] == (1, 5)
    assert set(np.flatnonzero(found.beyond() >= 0.95)) == {1, 5}
    assert (found.quantile(0.05) < truth)[[1, 5]].all()
    assert (truth < found.quantile(0.95))[[1, 5]].all()


def test_four_causes_are_found_though_only_sets_of_three_are_all_scored():
    rng = np.random.default_rng(3)
    truth = np.zeros(PARAMETERS)
    truth[[0, 2, 4, 6]] = 0.8
    estimate, information = measured(rng, truth)
    assert posterior(likelihood(estimate, information), np.zeros(PARAMETERS), prior()).sets[0] == (0, 2, 4, 6)


def test_probabilities_come_true():
    """2,400 sizes drawn from the prior: of those named with p, a share p is beyond; 90 % intervals hold 90 %."""
    rng, p, beyond, inside = np.random.default_rng(4), [], [], []
    given = prior(names=[f"effect {k}" for k in range(PARAMETERS)])
    for _ in range(300):
        active = rng.uniform(size=PARAMETERS) < given.probability
        truth = rng.normal(size=PARAMETERS) * np.where(active, SLAB, BACKGROUND)
        estimate, information = measured(rng, truth, 0.08)
        found = posterior(likelihood(estimate, information), np.zeros(PARAMETERS), given)
        p.append(found.beyond(NAMED))
        beyond.append(np.abs(truth) >= NAMED)
        inside.append((found.quantile(0.05) <= truth) & (truth <= found.quantile(0.95)))
    p, beyond = np.ravel(p), np.ravel(beyond)
    assert np.mean(inside) == pytest.approx(0.9, abs=0.025)
    assert beyond.mean() == pytest.approx(p.mean(), abs=0.01)
    middle = (p > 0.2) & (p < 0.8)
    assert beyond[middle].mean() == pytest.approx(p[middle].mean(), abs=0.2)


def test_a_parameter_of_one_sign_has_no_size_below_nominal():
    estimate, information = np.zeros(PARAMETERS), np.eye(PARAMETERS) / 0.1**2
    found = posterior(likelihood(estimate, information), np.zeros(PARAMETERS), prior(low=0.0))
    assert (found.quantile(0.05) >= 0.0).all()
    one = 1.0 / np.sqrt(1.0 / 0.1**2 + 1.0 / BACKGROUND**2)
    assert found.quantile(0.5)[0] == pytest.approx(one * norm.ppf(0.75), rel=0.05)


def test_an_unseen_parameter_is_neither_named_nor_ruled_out():
    information = np.eye(PARAMETERS) / 0.03**2
    information[3] = information[:, 3] = 0.0
    found = posterior(likelihood(np.zeros(PARAMETERS), information), np.zeros(PARAMETERS), prior())
    assert 0.01 < found.beyond()[3] < 0.1
    assert found.beyond()[[0, 1, 2]].max() < 1e-3


def test_order_of_parameters_and_the_point_of_the_likelihood_change_nothing():
    rng = np.random.default_rng(5)
    truth = np.zeros(PARAMETERS)
    truth[[1, 5]] = 0.3, -0.4
    estimate, information = measured(rng, truth, 0.1)
    first = posterior(likelihood(estimate, information), np.zeros(PARAMETERS), prior())
    order = rng.permutation(PARAMETERS)
    turned = posterior(
        likelihood(estimate[order], information[np.ix_(order, order)]), np.zeros(PARAMETERS), prior()
    )
    assert turned.beyond() == pytest.approx(first.beyond()[order], abs=1e-9)
    point = 0.2 * rng.normal(size=PARAMETERS)
    elsewhere = Likelihood(information, information @ (estimate - point))
    assert posterior(elsewhere, point, prior()).beyond() == pytest.approx(first.beyond(), abs=1e-9)


def test_an_effect_of_several_parameters_is_named_by_any_of_them():
    names = ["encoder", "encoder", "encoder", "friction"]
    information = np.eye(4) / 0.03**2
    found = posterior(
        likelihood(np.array([0.0, 0.5, 0.0, 0.0]), information), np.zeros(4), prior(names=names)
    )
    assert found.beyond() == pytest.approx([1.0, 0.0], abs=1e-3)


def test_two_modes_that_the_data_do_not_separate_share_the_probability():
    """In the mode of one effect the law error of this effect is large, so that its mode alone would prefer it."""
    estimate = np.zeros(PARAMETERS)
    modes = {}
    for active, other in ((0, 1), (1, 0)):
        information = np.zeros((PARAMETERS, PARAMETERS))
        information[np.ix_([active, other], [active, other])] = [[60.0, 45.0], [45.0, 65.0]]
        theta = np.where(np.arange(PARAMETERS) == active, 1.0, estimate)
        modes[active,] = posterior(Likelihood(information, np.zeros(PARAMETERS)), theta, prior())
    alone, both = modes[0,].beyond(), combine(modes).beyond()
    assert alone[0] > 0.8 > 0.2 > alone[1]
    assert both[:2] == pytest.approx([0.5, 0.5], abs=0.1)


def test_a_set_counts_in_the_mode_whose_causes_are_most_like_its_own():
    """Far from its own causes a likelihood does not hold, however large it says that the evidence of a set is."""

    def mode(second, value):
        theta, information = np.zeros(PARAMETERS), np.eye(PARAMETERS) / 0.05**2
        theta[:2] = 0.6, second
        return posterior(Likelihood(information, np.zeros(PARAMETERS), value), theta, prior())

    without, beside = mode(0.34, 0.0), mode(0.34, -12.0)
    assert without.sets[:2] == ((0, 1), (0,))
    found = combine({(0,): without, (0, 1): beside})
    assert found.sets[0] == (0,)
    assert found.log_evidence == pytest.approx(
        without.log_evidence + np.log(without.probability[1] / without.probability[0])
    )
    assert combine({(0,): without, (0, 1): mode(0.34, 0.0)}).sets[0] == (0, 1)


def test_a_set_that_its_own_mode_finds_improbable_counts_nowhere():
    information, alone, both = np.eye(PARAMETERS) / 0.05**2, np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    alone[0], both[:2] = 0.6, (0.6, 0.6)
    modes = {
        (0,): posterior(Likelihood(information, np.zeros(PARAMETERS)), both, prior()),
        (0, 1): posterior(Likelihood(information, np.zeros(PARAMETERS)), alone, prior()),
    }
    assert (0,) not in modes[0,].sets
    found = combine(modes)
    assert found.probability.sum() == pytest.approx(1.0)
    assert (0,) not in found.sets
