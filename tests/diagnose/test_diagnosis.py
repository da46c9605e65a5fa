"""The whole answer of a cart by another author: from its traces to verdict, patch and text."""

from dataclasses import replace

import pytest
from s2r_cart import NAMES, SPEC, Cart, real

from s2r_spec import parse_spec
from s2r_spec.diagnose.cache import Cache
from s2r_spec.diagnose.decision import Evidence, Rule
from s2r_spec.diagnose.diagnosis import Diagnosis, Which
from s2r_spec.diagnose.estimation import estimate
from s2r_spec.diagnose.experiment_design.identifiability import Candidate, separations
from s2r_spec.diagnose.experiment_design.next_test import next_test
from s2r_spec.diagnose.gap.by_test import compared_at_all_tests
from s2r_spec.diagnose.gap.held_out import held_out_gap
from s2r_spec.diagnose.inference.estimates import (
    Status,
    any_cause,
    by_effects,
    effect_estimates,
    mean_sizes,
    with_status,
)
from s2r_spec.diagnose.inference.goodness_of_fit import goodness_of_fit
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import library
from s2r_spec.report import diagnosed as report
from s2r_spec.rollouts.compatibility import check_compatibility

TESTS = [{"vd": vd, "acc": acc} for vd, acc in ((0.3, 3.5), (0.9, 1.5), (0.9, 3.5))]
HELD = [{"vd": vd, "acc": acc} for vd in (0.4, 0.6, 0.8) for acc in (1.5, 3.0)]
FAMILIES = {name: row[0] for name, row in NAMES.items()}


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    cart, spec = Cart(), parse_spec(SPEC)
    bench = Bench(cart, spec, "tracking", check_compatibility(spec, "tracking", cart))
    experiments = [Experiment.test(test) for test in TESTS]
    responses = library(cart, experiments, cache=Cache(tmp_path_factory.mktemp("cache")))
    candidates = [Candidate(one, cart.duration, runs=2) for one in experiments]

    def run(effects, extra=None, seed=5):
        first = 1000 * seed
        held = [(test, real(test, first + k, effects, extra=extra)) for k, test in enumerate(HELD)]
        seen = [(test, real(test, first + 50 + k, effects, extra=extra)) for k, test in enumerate(2 * TESTS)]
        traces = {one: [trace for test, trace in seen if Experiment.test(test) == one] for one in experiments}
        found = estimate(cart, responses, traces)
        sizes = effect_estimates(found.posterior, found.fit.likelihood, responses.parameters, FAMILIES)
        tuned = responses.values(mean_sizes(found.posterior))
        patch = {one.effect: one.values for one in with_status(sizes, Status.NAMED)}
        possible = [one.effect for one in with_status(sizes, Status.POSSIBLE)]
        evidence = Evidence(
            sizes,
            any_cause(found.posterior),
            separations(found, possible, candidates),
            held_out_gap(bench, held, seen, patch, tuned, seed),
            compared_at_all_tests(bench, [*held, *seen], seed),
            goodness_of_fit(found.problem, found.fit),
        )
        return Diagnosis(
            Which(evidence, by_effects(found.posterior, responses.parameters), next_test(found, candidates)),
            None,
            tuned,
            {
                "rollouts": 12,
                "held_out": 6,
                "seed": seed,
                "backend": cart.name,
                "model_hash": cart.model_hash,
            },
            ("the rollouts were run as their tests say",),
            passive=True,
            spec=spec,
        )

    return run


@pytest.mark.parametrize("effects", [{"coulomb": 1.2}, {"tilt": -1.6}, {"coulomb": 1.0, "speed_scale": 1.15}])
def test_a_cart_with_causes_gets_their_names_sizes_and_a_patch_that_closes_its_gap(diagnosed, effects):
    found = diagnosed(effects)
    assert found.rule is Rule.EFFECT
    assert not found.evidence.goodness.alarm
    assert set(found.which.answer) == set(effects) == set(found.patch)
    for one in found.evidence.effects:
        if one.effect in effects:
            (size,) = one.parameters
            assert size.low <= effects[one.effect] <= size.high
    assert found.how_far.share[0] > 0.8
    assert "next" not in replace(found, spec=None).to_json()
    said = report.text(found, found.spec)
    assert all(
        f"{one.effect}.{one.largest.parameter}" in said
        for one in found.evidence.effects
        if one.effect in effects
    )


def test_a_cause_outside_the_catalogue_is_none_of_these(diagnosed):
    found = diagnosed({}, extra="gust")
    assert found.rule is Rule.MISFIT
    goodness = found.evidence.goodness
    assert goodness.alarm
    assert f"p = {goodness.p:.2g}" in report.text(found, found.spec)
    assert found.patch == found.improved(tuned=True) == {}


def test_healthy_carts_of_another_author_are_no_misfit(diagnosed):
    """Of 40 carts none alarms; the level allows 5 %."""
    assert sum(diagnosed({}, seed=seed).evidence.goodness.alarm for seed in range(20, 25)) <= 1
