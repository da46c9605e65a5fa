"""The hierarchical likelihood: groups of observables, each with a law error of its own."""

import numpy as np
import pytest

from s2r_spec.diagnose.inference.hierarchical import (
    LAW_SHARE,
    Groups,
    Likelihood,
    Variances,
    form_error,
    form_ratio,
    score_left,
)

EFFECTS, OBSERVABLES = 4, 40
NONE = np.zeros(EFFECTS)


def columns(rng, groups):
    return rng.normal(size=(EFFECTS, groups * OBSERVABLES))


def parts(groups):
    return [np.arange(g * OBSERVABLES, (g + 1) * OBSERVABLES) for g in range(groups)]


def grouped(residual, design, where):
    """Return the groups, with errors of unit size."""
    shares, numbers = np.full(len(where), LAW_SHARE), np.array([float(part.size) for part in where])
    return Groups.of(residual, design, np.ones(residual.size), where, shares, numbers)


def estimated(residual, design, where, rounds=12):
    """Return estimate and deviation of θ, whose prior is so wide that it does not count."""
    groups = grouped(residual, design, where)
    found = groups.variances(NONE, Variances.prior(len(where)), rounds)
    total = groups.likelihood(NONE, found)
    covariance = np.linalg.inv(total.information)
    return covariance @ total.score, np.sqrt(np.diag(covariance))


def test_a_machine_of_the_same_laws_is_estimated_to_the_noise():
    rng = np.random.default_rng(1)
    design, truth = columns(rng, 12), np.array([0.5, -0.3, 0.0, 1.0])
    residual = truth @ design + 0.1 * rng.normal(size=design.shape[1])
    estimate, _ = estimated(residual, design, parts(12))
    assert estimate == pytest.approx(truth, abs=0.02)


def test_intervals_cover_sizes_that_every_group_sees_with_its_own_law_error():
    """900 sizes at law errors of 0.1 typical and 12 groups; the prior's scale of that error is 0.02."""
    rng, inside = np.random.default_rng(2), []
    for _ in range(225):
        design, truth = columns(rng, 12), 0.4 * rng.normal(size=EFFECTS)
        residual = np.concatenate(
            [(truth + 0.1 * rng.normal(size=EFFECTS)) @ design[:, part] for part in parts(12)]
        )
        residual += 0.3 * rng.normal(size=residual.size)
        estimate, deviation = estimated(residual, design, parts(12))
        inside.append(np.abs(estimate - truth) < 1.645 * deviation)
    assert 0.8 <= np.mean(inside) <= 0.97


def test_a_group_that_follows_another_law_counts_little():
    rng = np.random.default_rng(3)
    design, truth = columns(rng, 12), np.array([0.5, -0.3, 0.0, 1.0])
    residual = truth @ design + 0.1 * rng.normal(size=design.shape[1])
    residual[parts(12)[4]] += 3.0 * design[0, parts(12)[4]]
    estimate, _ = estimated(residual, design, parts(12))
    assert estimate == pytest.approx(truth, abs=0.06)
    plain = np.linalg.lstsq(design.T, residual, rcond=None)[0]
    assert abs(plain[0] - truth[0]) > 0.15


def test_the_order_of_groups_and_of_effects_changes_nothing():
    rng = np.random.default_rng(4)
    design, where = columns(rng, 6), parts(6)
    residual = np.array([0.5, -0.3, 0.0, 1.0]) @ design + rng.normal(size=design.shape[1])
    estimate, deviation = estimated(residual, design, where)
    again, _ = estimated(residual, design, [where[g] for g in (3, 1, 5, 0, 2, 4)])
    assert again == pytest.approx(estimate, abs=1e-9)
    order = [2, 0, 3, 1]
    turned, turned_deviation = estimated(residual, design[order], where)
    assert turned == pytest.approx(estimate[order], abs=1e-9)
    assert turned_deviation == pytest.approx(deviation[order], abs=1e-9)


def test_an_effect_without_a_response_keeps_its_prior():
    rng = np.random.default_rng(5)
    design = columns(rng, 6)
    design[2] = 0.0
    groups = grouped(rng.normal(size=design.shape[1]), design, parts(6))
    found = groups.likelihood(NONE, groups.variances(NONE, Variances.prior(6)))
    assert found.information[2] == pytest.approx(np.zeros(EFFECTS))
    assert found.score[2] == 0.0


def test_the_shared_error_is_added_to_the_covariance():
    information = np.diag([400.0, 100.0])
    found = Likelihood(information, np.array([1.0, 2.0])).with_shared_error(np.full(2, 0.01))
    assert np.diag(np.linalg.inv(found.information)) == pytest.approx([0.0025 + 0.01, 0.01 + 0.01])
    mean = np.linalg.solve(found.information, found.score)
    assert mean == pytest.approx([1.0 / 400.0, 2.0 / 100.0])


def test_a_variant_takes_the_part_of_the_residual_that_it_explains():
    """A difference that another contact model makes is not the size of an effect."""
    rng = np.random.default_rng(6)
    design = columns(rng, 8)
    variant = design[0] + 0.3 * rng.normal(size=design.shape[1])
    residual = 1.0 * variant
    groups = grouped(residual, np.vstack([design, variant]), parts(8))
    found = groups.variances(NONE, Variances.prior(8), 12)
    found = groups.likelihood(NONE, found).without_variants(EFFECTS)
    found = found.with_shared_error(np.full(EFFECTS, 9e-4))
    estimate = np.linalg.solve(found.information + np.eye(EFFECTS) / 0.36, found.score)
    assert abs(estimate[0]) < 0.3


def test_disagreement_is_counted_for_the_parameter_about_which_groups_disagree():
    rng = np.random.default_rng(7)
    design, where = columns(rng, 40), parts(40)
    off = np.concatenate(
        [[0.0, 0.15, 0.0, 0.0] * rng.normal(size=EFFECTS) @ design[:, part] for part in where]
    )
    groups = grouped(off + 0.3 * rng.normal(size=off.size), design, where)
    found = groups.disagreement(NONE, groups.variances(NONE, Variances.prior(40), 12))
    # 0.15 typical is 7.5 of the usual 0.02.
    assert 20.0 < found[1] < 80.0
    assert (found[[0, 2, 3]] < 3.0).all()


def formed(rng, truth, others):
    """Return errors of θ and their deviations, with and without errors of form.

    The first two effects are similar. The law of the first differs by 10 % in a shape that all groups share. ``others``
    says whether the third acts in groups of its own.
    """
    where, design, residual = parts(60), [], []
    shapes = 10.0 * rng.normal(size=(EFFECTS, OBSERVABLES))
    shapes[1] = shapes[0] + 2.0 * rng.normal(size=OBSERVABLES)
    form = rng.normal(size=OBSERVABLES)
    for number in range(60):
        apart = others and number >= 30
        own = (
            shapes * (np.arange(EFFECTS) == 2)[:, None]
            if apart
            else shapes * [[1.0], [1.0], [not others], [1.0]]
        )
        design.append(own)
        residual.append(truth @ own + (0.0 if apart else form) + rng.normal(size=OBSERVABLES))
    groups = grouped(np.concatenate(residual), np.hstack(design), where)
    spread = groups.variances(truth, Variances.prior(60), 6)
    found = groups.likelihood(truth, spread)
    wide = found.with_form_error(
        form_error(truth, groups.information(truth, spread), 60 * [""], found.information)
    )
    error = np.linalg.solve(found.information, found.score)  # the fit is around the truth
    return error, *(np.sqrt(np.diag(np.linalg.inv(one.information))) for one in (wide, found))


def test_an_error_of_form_that_all_groups_share_is_covered():
    """It looks like a little of a similar effect, in every group."""
    rng, inside, narrow = np.random.default_rng(8), [], []
    for _ in range(40):
        error, wide, without = formed(rng, np.array([1.0, 0.0, 0.0, 0.0]), others=False)
        inside.append(np.abs(error) < 1.645 * wide)
        narrow.append(np.abs(error) < 1.645 * without)
    assert np.mean(inside, axis=0)[1] > 0.85
    assert np.mean(narrow, axis=0)[1] < 0.6


def test_an_error_of_form_leaves_alone_what_the_effect_does_not_touch():
    _, wide, without = formed(np.random.default_rng(9), np.array([1.0, 0.0, 0.0, 0.0]), others=True)
    assert wide[2] == pytest.approx(without[2], rel=0.01)
    assert wide[1] > 1.5 * without[1]


def test_two_predictions_are_told_apart_by_no_more_than_errors_of_form_leave():
    """An error of form along the difference of both, the same in every group, looks like the wrong one."""
    rng, repeats, wrong = np.random.default_rng(11), 60, []
    for _ in range(300):
        effect = rng.normal(size=OBSERVABLES)
        apart = rng.normal(size=OBSERVABLES)
        apart *= 0.15 * np.linalg.norm(effect) / np.linalg.norm(apart)
        form = 0.1 * np.linalg.norm(effect) * rng.normal() * apart / np.linalg.norm(apart)
        left = (form + rng.normal(size=(repeats, OBSERVABLES))).sum(axis=0)
        favour = max(float(left @ apart - 0.5 * repeats * apart @ apart), 0.0)  # of the wrong one
        by_group = np.full((repeats, 1, 1), effect @ effect)
        ratio = form_ratio(np.full(repeats, apart @ apart), np.ones(1), by_group, repeats * ["air_sine"])
        wrong.append([favour > np.log(20.0), score_left(favour, ratio) > np.log(20.0)])
    plain, left = np.mean(wrong, axis=0)
    assert plain > 0.15
    assert left < 0.05


def test_predictions_that_differ_where_no_effect_acts_are_told_apart_as_before():
    by_group = np.array([[[0.0]], [[50.0]]])
    assert form_ratio(np.array([9.0, 0.0]), np.ones(1), by_group, ["", ""]) == 0.0
    assert form_ratio(np.zeros(2), np.ones(1), by_group, ["", ""]) == 0.0
    assert score_left(7.0, 0.0) == pytest.approx(7.0)
    one_kind = form_ratio(np.full(2, 9.0), np.full(1, 0.1), by_group, ["", ""])
    assert one_kind == pytest.approx(0.01 * 9.0 * 50.0 / 18.0)


def test_errors_of_form_do_not_choose_between_effects_of_the_same_response():
    information = np.array([[400.0, 400.0, 50.0], [400.0, 400.0, 50.0], [50.0, 50.0, 90.0]])
    found = Likelihood(information, information @ [0.01, 0.0, 0.02], -3.0)
    wide = [
        found.with_form_error(form_error(np.array(theta), information[None], [""], information))
        for theta in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    ]
    assert wide[0].value == pytest.approx(wide[1].value, abs=1e-9)
    for one in wide:
        assert one.information[0] == pytest.approx(one.information[1])
        assert one.score[0] == pytest.approx(one.score[1])
