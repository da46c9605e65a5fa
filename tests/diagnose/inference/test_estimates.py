"""Sizes of all effects with intervals, from a posterior that is made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_spec.backend import Effect, EffectParameter
from s2r_spec.diagnose.inference.estimates import (
    EffectEstimate,
    ParameterEstimate,
    Status,
    by_effects,
    effect_estimates,
    further_causes,
    hidden_names,
    mean_sizes,
    with_status,
)
from s2r_spec.diagnose.inference.hierarchical import Likelihood
from s2r_spec.diagnose.inference.model_search import ModelPosterior
from s2r_spec.diagnose.inference.prior import SizePrior
from s2r_spec.diagnose.simulator.axes import effect_axes

EFFECTS = (
    Effect("friction", "actuation", "", (EffectParameter("force", "N", 0.0, 4.0, 0.0, "half-normal, 1 N"),)),
    Effect(
        "motor",
        "actuation",
        "",
        (EffectParameter("factor", "", 0.5, 1.5, 1.0, "normal around 1, standard deviation 0.1"),),
    ),
    Effect(
        "payload",
        "inertia",
        "",
        (
            EffectParameter("mass", "kg", 0.0, 3.0, 0.0, "half-normal, 1 kg"),
            EffectParameter("x", "m", -0.2, 0.2, 0.0, "normal, 0.05 m"),
        ),
    ),
)
LINES = effect_axes(EFFECTS)
SEEN = Likelihood(1e3 * np.eye(4), np.zeros(4))
FAMILIES = {effect.name: effect.family for effect in EFFECTS}


def posterior(sets, probability, mean, deviation):
    ends = np.sort([[line.coordinate(line.low), line.coordinate(line.high)] for line in LINES])
    prior = SizePrior.of([line.effect for line in LINES], ends[:, 0], ends[:, 1])
    return ModelPosterior(tuple(sets), np.array(probability), np.array(mean), np.array(deviation), prior, 0.0)


def estimated(*arguments):
    return effect_estimates(posterior(*arguments), SEEN, LINES, FAMILIES)


def test_every_effect_has_a_size_in_its_unit_and_a_status():
    found = estimated(
        [(0,), (0, 2)], [0.7, 0.3], [[0.5, 0, 0, 0], [0.5, 0, 0.6, 0]], [[0.05, 0.04, 0.04, 0.04]] * 2
    )
    assert [(one.effect, one.status) for one in found] == [
        ("friction", Status.NAMED),
        ("motor", Status.RULED_OUT),
        ("payload", Status.POSSIBLE),
    ]
    force = found[0].parameters[0]
    # Typical is twice the prior's deviation of 1 N.
    assert (force.value, force.unit) == (pytest.approx(1.0, abs=0.01), "N")
    assert (force.low, force.high) == pytest.approx(
        (1.0 - 2 * 1.645 * 0.05, 1.0 + 2 * 1.645 * 0.05), abs=0.01
    )
    assert force.size == pytest.approx(0.5, abs=0.01)
    assert found[2].probability == pytest.approx(0.3, abs=0.01)
    assert found[2].family == "inertia"
    assert [one.effect for one in with_status(found, Status.POSSIBLE)] == ["payload"]
    # A factor's value is on the other side of 1 where its size is negative.
    (motor,) = estimated([(1,)], [1.0], [[0, -0.5, 0, 0]], [[0.05] * 4])[1].parameters
    assert motor.value == pytest.approx(0.9, abs=0.01)
    assert motor.low < motor.value < motor.high < 1.0


@pytest.mark.parametrize(
    ("probability", "width", "status"),
    [
        (0.95, 0.1, "named"),
        (0.95, 0.9, "named"),
        (0.94, 0.1, "possible"),
        (0.05, 0.9, "possible"),
        (0.04, 0.24, "ruled out"),
        (0.04, 0.26, "hidden"),
    ],
)
def test_the_levels_of_the_status(probability, width, status):
    sizes = [ParameterEstimate(name, "", *6 * [0.0], half) for name, half in (("x", 0.9), ("y", width))]
    assert EffectEstimate("a", "", probability, probability, tuple(sizes)).status.value == status


def test_what_the_data_alone_do_not_measure_is_hidden():
    blind = replace(SEEN, information=np.diag([1e3, 0.0, 1e3, 0.0]))
    found = effect_estimates(posterior([()], [1.0], [[0.0] * 4], [[0.04] * 4]), blind, LINES, FAMILIES)
    # An effect with one parameter that is seen is not hidden.
    assert [one.status.value for one in found] == ["ruled out", "hidden", "ruled out"]
    assert hidden_names(found) == ("motor", "payload.x")


def test_a_parameter_that_says_how_an_effect_acts_does_not_stand_for_it():
    acting = effect_axes(EFFECTS, {"payload": frozenset({"mass"})})
    made = posterior([()], [1.0], [[0.0, 0.0, 0.1, 0.9]], [[0.04, 0.04, 0.04, 0.4]])
    probability = np.where([line.base != {} for line in acting], 0.0, made.prior.probability)
    made = replace(made, prior=replace(made.prior, probability=probability))
    weak = Likelihood(np.diag([1e3, 1e3, 1e3, 1.0]), np.zeros(4))
    payload = effect_estimates(made, weak, acting, FAMILIES)[2]
    assert payload.largest.parameter == "mass"
    assert [one.dependent for one in payload.parameters] == [False, True]
    assert [one.hidden for one in payload.parameters] == [False, True]
    assert payload.status is Status.RULED_OUT
    assert hidden_names([payload]) == ("payload.x",)
    weak = Likelihood(np.diag([1e3, 1e3, 1.0, 1e3]), np.zeros(4))
    payload = effect_estimates(made, weak, acting, FAMILIES)[2]
    assert payload.status is Status.HIDDEN
    assert hidden_names([payload]) == ("payload",)


def test_a_value_is_at_the_end_of_its_range_where_the_data_ask_for_more():
    def at_end(size):
        return estimated([(1,)], [1.0], [[-0.3, size, 0, 0]], [[0.1] * 4])

    assert [one.parameters[0].at_end for one in at_end(2.6)] == [False, True, False]
    assert not at_end(2.4)[1].parameters[0].at_end
    assert at_end(-2.6)[1].parameters[0].at_end
    assert not at_end(2.6)[0].parameters[0].at_end  # nominal is no end
    assert at_end(2.6)[1].parameters[0].value <= 1.5


def test_that_some_effect_is_there_may_be_sure_although_none_is_named():
    either = posterior([(0,), (2,)], [0.5, 0.5], [[0.6, 0, 0, 0], [0, 0, 0.6, 0]], [[0.04] * 4] * 2)
    effects = effect_estimates(either, SEEN, LINES, FAMILIES)
    assert [one.status for one in effects].count(Status.NAMED) == 0
    assert {*further_causes(either, effects)} == {"friction", "payload"}
    assert by_effects(either, LINES) == ((("friction",), 0.5), (("payload",), 0.5))
    nothing = posterior([()], [1.0], [[0.0] * 4], [[0.04] * 4])
    assert further_causes(nothing, effect_estimates(nothing, SEEN, LINES, FAMILIES)) == ()


@pytest.mark.parametrize(("each", "further"), [(0.2, ()), (0.3, ("motor", "payload"))])
def test_a_further_cause_may_be_likely_although_no_single_one_is(each, further):
    """Friction is there in every set; beside it may be the motor or the payload, and never both."""
    sizes = [[0.6, 0, 0, 0], [0.6, 0.6, 0, 0], [0.6, 0, 0.6, 0]]
    found = posterior([(0,), (0, 1), (0, 2)], [1.0 - 2.0 * each, each, each], sizes, [[0.04] * 4] * 3)
    effects = effect_estimates(found, SEEN, LINES, FAMILIES)
    assert [one.effect for one in effects if one.status is Status.NAMED] == ["friction"]
    assert set(further_causes(found, effects)) == set(further)


def test_the_mean_is_over_sets_and_within_the_range():
    found = posterior([(0,), ()], [0.75, 0.25], [[0.8, 0, 0, 0], [0, 0, 0, 0]], [[1e-3] * 4] * 2)
    mean = mean_sizes(found)
    assert mean[0] == pytest.approx(0.6, abs=1e-3)
    one_sided = posterior([()], [1.0], [[0.0, 0.0, -5.0, 9.0]], [[0.1] * 4])
    # Of a half-normal distribution: √(2/π) of its deviation.
    assert mean_sizes(one_sided) == pytest.approx([0.1 * np.sqrt(2 / np.pi), 0.0, 0.0, 2.0], abs=1e-3)


def test_sets_of_parameters_of_one_effect_are_one_set():
    found = posterior([(2,), (2, 3)], [0.6, 0.4], [[0, 0, 1, 0], [0, 0, 1, 1]], [[0.1] * 4] * 2)
    assert by_effects(found, LINES) == ((("payload",), 1.0),)
