"""The estimate of a cart by another author: sizes of all effects, from traces alone."""

from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor

import numpy as np
import pytest
import s2r_cart
from s2r_cart import EFFECTS, Cart, real

from s2r_spec.diagnose.estimation import estimate, rivals
from s2r_spec.diagnose.inference.hierarchical import Likelihood
from s2r_spec.diagnose.inference.model_search import posterior
from s2r_spec.diagnose.inference.prior import SizePrior
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import library
from s2r_spec.errors import BackendError, UsageError
from s2r_spec.trace import Trace

TESTS = [Experiment.test({"vd": vd, "acc": acc}) for vd, acc in ((0.3, 3.5), (0.9, 1.5), (0.9, 3.5))]


@pytest.fixture(scope="module")
def responses(tmp_path_factory):
    return library(Cart(), TESTS, cache=Cache(tmp_path_factory.mktemp("cache")))


def traces(seed, effects):
    return {test: [real(dict(test.params), seed + k, effects) for k in range(2)] for test in TESTS}


def named(responses, found):
    effects = list(dict.fromkeys(line.effect for line in responses.parameters))
    return {name for name, p in zip(effects, found.posterior.beyond(), strict=True) if p >= 0.95}


@pytest.mark.parametrize(
    "effects",
    [{}, {"coulomb": 1.2}, {"tilt": -1.6}, {"viscous": 1.6}, {"coulomb": 1.0, "speed_scale": 1.15}],
    ids=lambda effects: " and ".join(effects) or "nothing",
)
def test_causes_of_another_author_are_named(responses, effects):
    found = estimate(Cart(), responses, traces(5000, effects))
    assert named(responses, found) == set(effects)
    low, high = found.posterior.quantile(0.05), found.posterior.quantile(0.95)
    for k, line in enumerate(responses.parameters):
        if line.effect in effects:
            assert low[k] - 0.05 <= line.coordinate(effects[line.effect]) <= high[k] + 0.05


def test_the_order_of_channels_and_of_the_catalogue_changes_nothing(responses, monkeypatch, tmp_path):
    data = traces(6000, {"coulomb": 1.2})
    first = estimate(Cart(), responses, data)
    monkeypatch.setattr(s2r_cart, "EFFECTS", tuple(reversed(EFFECTS)))
    turned = library(Cart(), TESTS, cache=Cache(tmp_path))
    reordered = {
        test: [Trace(t.times, dict(reversed(t.channels.items())), t.units, t.meta) for t in runs]
        for test, runs in data.items()
    }
    again = estimate(Cart(), turned, reordered)
    assert [line.name for line in turned.parameters] == [line.name for line in reversed(responses.parameters)]
    assert again.posterior.quantile(0.5)[::-1] == pytest.approx(first.posterior.quantile(0.5), abs=1e-3)
    assert again.posterior.beyond()[::-1] == pytest.approx(first.posterior.beyond(), abs=1e-3)


def test_an_experiment_that_the_library_does_not_have_is_refused(responses):
    data = traces(5000, {})
    for other in (Experiment("chirp"), Experiment.test({"vd": 0.31, "acc": 2.0})):
        with pytest.raises(UsageError, match=f"has no {other}"):
            estimate(Cart(), responses, {other: data[TESTS[0]]})


def test_runs_that_show_nothing_are_refused(responses):
    other = Trace(np.linspace(0.0, 2.0, 201), {"temperature": np.ones(201)}, {"temperature": "K"})
    for data in ({}, {TESTS[0]: [other]}):
        with pytest.raises(UsageError, match="no size can be estimated"):
            estimate(Cart(), responses, data)


def test_a_trace_that_ends_early_is_used_as_far_as_it_goes(responses):
    data = traces(7000, {"coulomb": 1.2})
    test = TESTS[0]
    cut = [Trace(t.times[:80], {n: x[:80] for n, x in t.channels.items()}, t.units) for t in data[test]]
    found = estimate(Cart(), responses, {**data, test: cut})
    assert "coulomb" in named(responses, found)
    assert np.isfinite(found.fit.theta).all()


def test_a_rival_of_a_cause_is_one_that_acts_alone():
    """The place of a payload looks like a tilt, but is no cause without the payload."""
    prior = SizePrior.of(
        ["tilt", "offset", "payload", "payload"],
        np.full(4, -2.0),
        np.full(4, 2.0),
        np.array([False, False, False, True]),
    )
    signatures = np.array([[1.0, 0.3, 0.0], [0.8, 0.9, 0.0], [0.2, 0.0, 1.0], [0.05, 0.015, 0.0]])
    found = Likelihood(4e3 * signatures @ signatures.T, np.zeros(4))
    sets = posterior(found, np.array([0.8, 0.0, 0.0, 0.0]), prior)
    assert sets.sets[0] == (0,)
    others = [members for _, members in rivals(found, sets)]
    assert others == [(1,), (2,)]


class Dying(ThreadPoolExecutor):
    """A pool whose workers die."""

    def submit(self, function, /, *arguments, **named):
        died = Future()
        died.set_exception(BrokenExecutor())
        return died


def test_a_worker_that_dies_at_the_estimate_is_a_sentence(responses):
    with pytest.raises(BackendError, match="--workers 1"):
        estimate(Cart(), responses, traces(5000, {"coulomb": 1.2}), executor=Dying)
