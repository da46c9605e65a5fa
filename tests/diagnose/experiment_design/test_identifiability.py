"""What data and further experiments tell apart, and which experiment comes next: of a machine of two shapes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from s2r_spec.base.json_values import to_json
from s2r_spec.diagnose.estimation import estimate
from s2r_spec.diagnose.experiment_design.identifiability import Candidate, InformationForecast, separations
from s2r_spec.diagnose.experiment_design.next_test import next_test
from s2r_spec.diagnose.inference.estimates import Status, effect_estimates, hidden_names
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.library import library
from tests.diagnose.toy import SHOW, SPLIT, TEST, Toy


@pytest.fixture(scope="module")
def responses(tmp_path_factory):
    return library(Toy(), [TEST, SPLIT, SHOW], cache=Cache(tmp_path_factory.mktemp("cache")))


def found(responses, effects, *experiments):
    machine = Toy(tuple(effects.items()))
    return estimate(Toy(), responses, {e: [e.run(machine, 50 + k) for k in range(2)] for e in experiments})


@pytest.fixture(scope="module")
def unclear(responses):
    """Either a or b, by the test alone."""
    return found(responses, {"a": 2.0}, TEST)


CANDIDATES = [Candidate(TEST, 1.0, runs=2), Candidate(SPLIT, 1.0), Candidate(SHOW, 1.0)]


def test_only_the_protocol_with_both_shapes_settles_them(unclear):
    possible = separations(InformationForecast.of(unclear), ["a", "b"], CANDIDATES)
    assert [one.effect for one in possible] == ["a", "b"]
    for one in possible:
        assert one.best(allowed=True).candidate.experiment == SPLIT
        assert {power.candidate.experiment: power.settles for power in one.powers} == {
            TEST: False,
            SPLIT: True,
            SHOW: False,
        }
        assert one.effect in one.included
        assert one.effect not in one.excluded
        assert json.loads(json.dumps(to_json(one))) == to_json(one)


def test_a_protocol_that_is_not_allowed_is_named_as_missing(unclear):
    missing = [CANDIDATES[0], replace(CANDIDATES[1], allowed=False), CANDIDATES[2]]
    for one in separations(InformationForecast.of(unclear), ["a", "b"], missing):
        assert one.best(allowed=True) is None
        assert one.best(allowed=False).candidate.experiment == SPLIT


def test_the_next_experiment_is_the_one_that_separates_and_its_forecast_comes_true(responses, unclear):
    chosen = next_test(InformationForecast.of(unclear), CANDIDATES)
    assert chosen.candidate.experiment == SPLIT
    assert {name for names in chosen.separates for name in names} == {"a", "b"}
    assert chosen.sigma > 3.0
    after = found(responses, {"a": 2.0}, TEST, SPLIT)
    assert after.posterior.beyond()[:2] == pytest.approx([1.0, 0.0], abs=0.05)
    assert json.loads(json.dumps(to_json(chosen)))["protocol"] == "split"


def test_cost_counts_and_what_is_not_allowed_is_not_chosen(unclear):
    assert next_test(InformationForecast.of(unclear), [CANDIDATES[0], CANDIDATES[2]]) is None
    assert (
        next_test(InformationForecast.of(unclear), [replace(one, allowed=False) for one in CANDIDATES])
        is None
    )
    costly = [replace(CANDIDATES[1], cost=9.0)]
    assert next_test(InformationForecast.of(unclear), costly).candidate.experiment == SPLIT


def test_more_runs_of_an_experiment_say_less_than_the_first(unclear):
    forecast = InformationForecast.of(unclear)
    gains = [np.trace(forecast.gained(Candidate(SPLIT, 1.0, runs=n))) for n in (0, 1, 4)]
    assert gains[0] > gains[1] > gains[2] > 0.0


def test_sizes_that_the_data_alone_do_not_show_are_hidden(responses, unclear):
    def estimates(one):
        return effect_estimates(one.posterior, one.fit.likelihood, responses.parameters, {})

    by_name = {one.effect: one for one in estimates(unclear)}
    # The test shows nothing of c and d.
    assert {"c", "d"} <= set(hidden_names(by_name.values()))
    assert {name for name, one in by_name.items() if one.status is Status.HIDDEN} == {"c", "d"}
    shown = estimates(found(responses, {"a": 2.0}, TEST, SPLIT, SHOW))
    assert hidden_names(shown) == ()
    assert [one.status.value for one in shown] == ["named", *3 * ["ruled out"]]
