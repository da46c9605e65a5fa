"""The evidence is that of the Gaussian model which the documentation states, and the joint fit finds what is there."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.evidence import ALLOWED, LARGE, MORE, Linear, evidence, ground, posterior, solved
from s2r_spec.diagnose.joint import Joint, joint_fit, polished, reach, rephased
from s2r_spec.diagnose.judge import strangeness

EFFECTS, SIZE = 4, 30


def drawn(seed, amounts, side=0):
    rng = np.random.default_rng(seed)
    j = rng.normal(size=(EFFECTS, SIZE))
    y = np.array(amounts) @ j + rng.normal(size=SIZE)
    names = tuple("abcd")
    none = np.zeros(EFFECTS)
    data = Linear(
        Catalogue(
            (),
            names,
            np.arange(EFFECTS),
            np.arange(EFFECTS),
            none.astype(bool),
            none - 1,
            none + 1,
            np.full(EFFECTS, side),
        ),
        j @ j.T,
        j @ y,
        float(y @ y),
        float(y @ y) / SIZE,
        none,
        SIZE,
        1.0,
    )
    return data, j, y


def density(j, y, chosen):
    spread = np.where(np.isin(np.arange(EFFECTS), chosen), LARGE, ALLOWED)
    return multivariate_normal(cov=np.eye(SIZE) + (j.T * spread**2) @ j).logpdf(y)


def test_log_evidence_is_that_of_the_stated_model():
    data, j, y = drawn(0, [0.8, 0.0, -0.5, 0.02])
    found = evidence(data)
    exact = np.array([density(j, y, s) for s in found.members])
    np.testing.assert_allclose(found.logs - found.logs[0], exact - exact[0], atol=1e-9)
    assert {len(s) for s in found.members} == {0, 1, 2, 3}


def test_the_posterior_is_that_of_the_stated_model():
    data, j, y = drawn(1, [0.8, 0.0, 0.0, 0.0])
    spread = np.array([LARGE, ALLOWED, ALLOWED, ALLOWED])
    prior = np.diag(spread**2)
    gain = prior @ j @ np.linalg.inv(np.eye(SIZE) + j.T @ prior @ j)
    mean, covariance = posterior(data, (0,))
    np.testing.assert_allclose(mean, gain @ y, atol=1e-9)
    np.testing.assert_allclose(covariance, prior - gain @ j.T @ prior, atol=1e-9)


def test_data_that_are_believed_less_have_so_many_times_the_variance():
    data, j, y = drawn(1, [0.8, 0.0, 0.0, 0.0])
    prior = np.diag(np.array([LARGE, ALLOWED, ALLOWED, ALLOWED]) ** 2)
    gain = prior @ j @ np.linalg.inv(9.0 * np.eye(SIZE) + j.T @ prior @ j)
    mean, covariance = posterior(data.believed_less(9.0), (0,))
    np.testing.assert_allclose(mean, gain @ y, atol=1e-9)
    np.testing.assert_allclose(covariance, prior - gain @ j.T @ prior, atol=1e-9)


def test_an_effect_of_one_sign_gains_on_its_side_and_loses_on_the_other():
    free, *_ = drawn(2, [0.7, 0.0, 0.0, 0.0])
    right, *_ = drawn(2, [0.7, 0.0, 0.0, 0.0], side=1)
    wrong, *_ = drawn(2, [0.7, 0.0, 0.0, 0.0], side=-1)
    place = evidence(free).members.index((0,))
    gains = [evidence(data).logs[place] - evidence(free).logs[place] for data in (right, wrong)]
    assert gains[0] == pytest.approx(np.log(2.0), abs=0.05)
    assert gains[1] < -3.0


class Bent:
    """Two effects that bend and interact; its derivatives are right, the first ones that it is given are not."""

    lower, upper, based = np.zeros(2), np.full(2, 2.0), np.zeros(2, dtype=bool)

    def __init__(self):
        self.j = np.random.default_rng(3).normal(size=(2, 1, 40))

    def change(self, at):
        bent = at + 0.3 * at**2
        return np.tensordot(bent, self.j, 1) + 0.4 * at[0] * at[1] * self.j[::-1][0]

    def jacobian(self, at):
        step = 1e-6 * np.eye(2)
        return np.array([(self.change(at + s) - self.change(at)) / 1e-6 for s in step])


def test_the_joint_fit_ends_where_the_model_is_and_not_where_the_first_derivatives_point():
    model, true = Bent(), np.array([1.2, 0.4])
    data = model.change(true)
    rough = model.j * np.array([0.4, 2.0])[:, None, None]
    found = joint_fit(
        model, data, np.full(data.shape, 1e-4), np.zeros((0, *data.shape)), np.zeros(2), rough, 3.0
    )
    np.testing.assert_allclose(found.at, true, atol=0.02)


def test_a_fit_that_has_arrived_asks_for_no_more_rollouts():
    class Counted(Bent):
        looks = 0

        def change(self, at):
            self.looks += 1
            return super().change(at)

    data = Bent().change(np.array([1.2, 0.4])) + 0.01 * np.random.default_rng(5).normal(size=(1, 40))
    known = np.full(data.shape, 1e-4), np.zeros((0, *data.shape))
    first = joint_fit(Bent(), data, *known, np.zeros(2), Bent().j, 3.0)
    slopes = Bent().jacobian(first.at)
    model = Counted()
    again = joint_fit(model, data, *known, first.at, slopes, 3.0, exact=True)
    assert model.looks == 1
    np.testing.assert_array_equal(again.at, first.at)


def test_what_nuisances_explain_is_no_lines_doing():
    model = Bent()
    nuisance = np.random.default_rng(4).normal(size=(1, 1, 40))
    data = model.change(np.array([0.5, 0.0])) + 0.8 * nuisance[0]
    variance = np.full(data.shape, 1e-2)
    with_it = joint_fit(model, data, variance, nuisance, np.zeros(2), model.j, 3.0)
    without = joint_fit(model, data, variance, nuisance[:0], np.zeros(2), model.j, 3.0)
    assert with_it.misfit < 0.05 < without.misfit


class Steps(Bent):
    """A delay in whole samples of a tenth."""

    def change(self, at):
        return np.round(at[:1] / 0.1)[:, None] * 0.1 * self.j[0]


def test_what_whole_samples_leave_open_is_centred():
    model = Steps()
    data = model.change(np.array([0.7, 0.0]))
    at = polished(
        model, data, np.full(data.shape, 1e-4), np.zeros((0, *data.shape)), np.array([0.52, 0.0]), 3.0
    )
    assert at[0] == pytest.approx(0.7, abs=0.03)


class Wave:
    """A ripple: how high, and where on the circle, from -1 to 1."""

    lower, upper, based = np.array([0.0, -1.0]), np.array([2.0, 1.0]), np.array([False, True])

    def change(self, at):
        return at[0] * np.sin(np.linspace(0, 9, 40) + np.pi * at[1])[None]

    def jacobian(self, at):
        step = 1e-6 * np.eye(2)
        return np.array([(self.change(at + s) - self.change(at)) / 1e-6 for s in step])


def test_a_phase_is_found_although_derivatives_lead_to_the_end_of_its_range():
    model, true = Wave(), np.array([1.2, 0.8])
    data = model.change(true)
    known = (data, np.full(data.shape, 1e-3), np.zeros((0, *data.shape)))
    begin = np.array([1.0, -0.7])
    astray = joint_fit(model, *known, begin, model.jacobian(begin), 3.0)
    assert astray.at[1] < 0
    np.testing.assert_allclose(rephased(model, *known, astray.at, 3.0), true, atol=0.02)
    np.testing.assert_array_equal(rephased(model, *known, true, 3.0), true)


def test_a_phase_may_be_anywhere_that_the_data_leave_open():
    model, true = Wave(), np.array([1.2, 0.3])
    data = model.change(true)
    for variance, open_ in ((1e-3, 0.15), (1e3, 2.0)):
        known = (data, np.full(data.shape, variance), np.zeros((0, *data.shape)))
        low, high = reach(model, *known, true, 1, 2.7)
        assert low <= 0.3 <= high
        assert high - low <= open_
    assert (low, high) == (-1.0, 1.0)


class Straight:
    """Four effects that add up."""

    lower, upper, based = -2 * np.ones(EFFECTS), 2 * np.ones(EFFECTS), np.zeros(EFFECTS, dtype=bool)

    def __init__(self):
        self.j = np.random.default_rng(5).normal(size=(EFFECTS, 2, 60)) * 3.0

    def change(self, at):
        return np.tensordot(at, self.j, 1)

    def jacobian(self, at):
        return self.j


@pytest.mark.parametrize("off", [0.0, 1.0, 2.8])
def test_a_simulator_of_which_every_number_is_off_is_believed_so_much_less(off):
    model, rng = Straight(), np.random.default_rng(6)
    lines = drawn(0, np.zeros(EFFECTS))[0].lines
    variance = np.full((2, 60), 0.1)
    data = (
        model.change(np.array([0.0, 0.7, 0.0, 0.0]))
        + rng.normal(size=(2, 60)) * np.sqrt(variance)
        + off * rng.normal(size=(2, 60))
    )
    fitted, plain, wider = solved(
        model, lines, data, variance, np.zeros((0, 2, 60)), np.zeros(EFFECTS), model.j
    )
    more = np.sqrt(wider - variance)[0, 0]
    near = [
        MORE[i] for i, m in enumerate(MORE) if min(abs(np.array(MORE[max(i - 1, 0) : i + 2]) - off)) < 1e-9
    ]
    assert any(more == pytest.approx(m, abs=1e-6) for m in near)
    assert fitted.misfit < 1.6
    found = evidence(plain)
    assert found.members[int(np.argmax(found.logs))] == (1,)


def test_the_error_of_everything_has_the_largest_evidence_of_the_stated_model():
    rng = np.random.default_rng(7)
    lines = drawn(0, np.zeros(EFFECTS))[0].lines
    nuisances = 3.0 * rng.normal(size=(4, 1, 20))
    for _ in range(20):
        j = rng.normal(size=(EFFECTS, 1, 20))
        data = (
            np.tensordot(rng.normal(size=EFFECTS) * 0.05, j, 1)
            + np.tensordot(rng.normal(size=4), nuisances, 1)
            + rng.choice([0.3, 1.5, 3.0]) * rng.normal(size=(1, 20))
        )
        variance = np.full((1, 20), 0.1)
        fitted = Joint(np.zeros(EFFECTS), data, j, 1.0, 0.0)
        n, flat = nuisances.reshape(4, 20), j.reshape(EFFECTS, 20)

        def speaks(more, n=n, flat=flat, data=data):
            base = np.eye(20) * (0.1 + more**2) + n.T @ n
            sets = [(), *((k,) for k in range(EFFECTS))]
            spreads = [np.where(np.isin(np.arange(EFFECTS), s), LARGE, ALLOWED) for s in sets]
            return max(
                multivariate_normal(cov=base + (flat.T * spread**2) @ flat).logpdf(data.ravel())
                for spread in spreads
            )

        assert ground(lines, fitted, data, variance, nuisances) == max(MORE, key=speaks)


def test_data_that_are_nothing_at_all_are_not_strange():
    data, *_ = drawn(0, np.zeros(EFFECTS))
    nothing = replace(data, toward=np.zeros(EFFECTS), energy=0.0, seen=0.0)
    assert np.isfinite(strangeness(evidence(nothing), np.full(EFFECTS, 0.1))).all()
