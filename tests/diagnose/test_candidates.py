"""Causes by predictions of left-out tests, on a rig whose effects interact and whose runs may end early."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from s2r_spec.backend import Channel, Effect, EffectParameter, Parameter
from s2r_spec.diagnose.candidates import predicted
from s2r_spec.diagnose.estimation import estimate, size_prior
from s2r_spec.diagnose.inference.prior import UNNAMED
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import library
from s2r_spec.protocols import PROTOCOL, Protocol
from s2r_spec.trace import Trace

TIMES = 0.01 * np.arange(200)
NOISE = 0.03  # m
TESTS = [Experiment.test({"v": v}) for v in (0.1, 0.3, 0.5, 0.7, 0.95)]
SHAKE = Experiment("shake")


@dataclass(frozen=True)
class Rig:
    """A reading that a, b, c and d change; c acts nearly as a does, and b makes a act more. Far beyond, a run ends."""

    added: tuple[tuple[str, float], ...] = ()
    noise: float = NOISE
    name: str = "rig"
    model_hash: str = "1"
    duration: float = 2.0
    deterministic: bool = True
    cost: float = 1e-3
    channels: tuple[Channel, ...] = (Channel("x", "m", "reading"), Channel("w", "m", "second reading"))
    parameters: tuple[Parameter, ...] = (Parameter("v", "", 0.0, 1.0, 0.5, "speed"),)

    def effects(self):
        size = EffectParameter("size", "N", -4.0, 4.0, 0.0, "normal, 1 N")
        return tuple(Effect(name, "rig", "", (size,)) for name in "abcd")

    def with_effects(self, values):
        return replace(self, added=tuple((name, of["size"]) for name, of in values.items()))

    def protocols(self):
        return (Protocol("shake", "", "space", 1.0, 1.0),)

    def run(self, protocol, params, seed):
        return replace(self.rollout({"v": 0.5}, seed), meta={PROTOCOL: protocol})

    def rollout(self, params, seed):
        a, b, c, d = ({**dict.fromkeys("abcd", 0.0), **dict(self.added)}[name] / 2.0 for name in "abcd")
        v = params["v"]
        wave, ramp, slow = np.sin((2.0 + 3.0 * v) * TIMES), v * TIMES**2 / 4.0, np.cos((1.0 + v) * TIMES)
        a *= 1.0 + 0.8 * b
        moved = np.column_stack([(a + c) * wave + b * ramp, b * slow + d * wave + 0.02 * c * ramp])
        base = np.column_stack([np.sin(3.0 * TIMES), np.cos(2.0 * v * TIMES)])
        noise = self.noise * np.random.default_rng(seed).normal(size=base.shape)
        until = 90 if abs(d) > 1.2 else len(TIMES)
        x = (base + 0.3 * moved + noise)[:until]
        return Trace(TIMES[:until], {"x": x[:, 0], "w": x[:, 1]}, {"x": "m", "w": "m"}, {})


@pytest.fixture(scope="module")
def responses(tmp_path_factory):
    return library(Rig(), TESTS, cache=Cache(tmp_path_factory.mktemp("cache")))


@pytest.fixture(scope="module")
def with_d(responses):
    """The answer about a machine with d at 0.6."""
    return found(responses, runs({"d": 0.6}))


@pytest.fixture(scope="module")
def nothing(responses):
    """The answer about a machine with nothing but a little of every effect."""
    return found(responses, runs({}))


def runs(effects, seed=0, noise=NOISE, tests=TESTS, repeats=2):
    """Return experiment → runs of a machine, whose other effects are a little off. Sizes are in typical sizes."""
    nuisance = np.random.default_rng(900 + seed).uniform(-0.05, 0.05, size=4)
    sizes = dict(zip("abcd", nuisance.tolist(), strict=True)) | effects
    rig = Rig(tuple((name, 2.0 * size) for name, size in sizes.items()), noise)
    return {
        test: [test.run(rig, 10_000 * (seed + 1) + 10 * n + k) for k in range(repeats)]
        for n, test in enumerate(tests)
    }


def found(responses, data, **options):
    return predicted(Rig(), responses, data, size_prior(responses), **options)


def named(answer):
    return {"abcd"[k] for k in np.flatnonzero(answer.posterior.beyond(UNNAMED) > 0.9)}


def misfit(answer):
    """Return the part of the observables in which a misfit shows, and the part of it that is left."""
    return answer.misfit.shown, answer.misfit.left


def interval(answer, name):
    k = "abcd".index(name)
    return answer.posterior.quantile(0.05)[k], answer.posterior.quantile(0.95)[k]


def test_what_nobody_added_is_no_cause(responses, nothing):
    """All other effects are a little off, and the empty set follows them as well as any other."""
    for answer in (nothing, found(responses, runs({}, 8))):
        assert answer.posterior.sets[0] == ()
        assert answer.posterior.probability[0] > 0.8
        assert (answer.posterior.beyond() < 0.05).all()
        assert not answer.misfit.rejected


def test_two_effects_that_interact_are_found_with_their_sizes(responses):
    """With b at 0.6 the effect a acts by half more than alone, which no sum of responses shows."""
    truth = {"a": 0.6, "b": 0.6}
    answer = found(responses, runs(truth))
    chance = dict(zip(answer.posterior.sets, answer.posterior.probability.tolist(), strict=True))
    assert chance[0, 1] + chance[1, 2] > 0.8
    one = answer.candidates[0, 1]
    assert one.theta[:2] == pytest.approx([0.6, 0.6], abs=0.06)
    low, high = interval(answer, "b")
    assert low <= 0.6 <= high
    shown, left = misfit(answer)
    assert shown > 0.5
    assert left < 0.05


def test_the_truth_lies_in_the_interval(responses):
    for seed in (1, 2):
        answer = found(responses, runs({"d": -0.5 - 0.2 * seed}, seed))
        assert named(answer) == {"d"}
        low, high = interval(answer, "d")
        assert low <= -0.5 - 0.2 * seed <= high


def test_two_effects_of_nearly_the_same_signature_share_the_probability(responses):
    answer = found(responses, runs({"a": 0.6}))
    assert named(answer) == set()
    assert answer.posterior.sets[:2] in (((0,), (2,)), ((2,), (0,)))
    assert answer.posterior.probability[1] > 0.1


def test_instruments_that_are_noisier_than_the_simulator_are_no_cause(responses, with_d):
    """They widen the intervals, and nothing else."""
    healthy, ill = (found(responses, runs(e, noise=5.0 * NOISE)) for e in ({}, {"d": 0.6}))
    assert (healthy.posterior.beyond() < 0.05).all()
    assert named(ill) == {"d"}
    low, high = interval(ill, "d")
    assert low <= 0.6 <= high
    assert high - low > 1.2 * np.diff(interval(with_d, "d"))


def test_runs_that_end_early_are_compared_as_far_as_they_go(responses):
    """Beyond 1.2 the effect d ends a run, of the machine and of the simulator, before half of its time."""
    data = runs({"d": 1.5})
    assert all(len(trace) == 90 for traces in data.values() for trace in traces)
    answer = found(responses, data)
    assert named(answer) == {"d"}
    low, high = interval(answer, "d")
    assert low <= 1.5 <= high


def test_one_test_that_ended_early_changes_little(responses, with_d):
    data = runs({"d": 0.6})
    cut = [Trace(t.times[:60], {n: x[:60] for n, x in t.channels.items()}, t.units) for t in data[TESTS[2]]]
    answer = found(responses, data | {TESTS[2]: cut})
    assert named(answer) == {"d"}
    assert answer.posterior.mean[0] == pytest.approx(with_d.posterior.mean[0], abs=0.03)


def test_fewer_than_five_tests_that_show_something_decide_nothing(responses, with_d):
    data = runs({"d": 0.6})
    assert with_d is not None
    assert found(responses, dict(list(data.items())[:4])) is None
    other = [Trace(TIMES, {"temperature": np.ones(len(TIMES))}, {"temperature": "K"})]
    assert found(responses, dict(list(data.items())[:4]) | {TESTS[4]: other}) is None


def test_the_order_of_tests_changes_nothing(responses, with_d):
    first, again = with_d, found(responses, dict(reversed(runs({"d": 0.6}).items())))
    assert again.posterior.sets[0] == first.posterior.sets[0] == (3,)
    assert again.posterior.mean[0] == pytest.approx(first.posterior.mean[0], abs=1e-6)
    assert again.posterior.deviation[0] == pytest.approx(first.posterior.deviation[0], abs=1e-6)
    # The bootstrap gives its weights to other tests.
    assert again.posterior.beyond() == pytest.approx(first.posterior.beyond(), abs=0.02)


def test_the_same_data_give_the_same_bits(responses, with_d):
    one, other = with_d.posterior, found(responses, runs({"d": 0.6})).posterior
    assert one.sets == other.sets
    assert (one.probability == other.probability).all()
    assert (one.mean == other.mean).all()


def test_a_proposed_set_is_tried_at_its_sizes(responses):
    proposed = (0, 1, 2, 3), np.full(4, 0.4)
    data = runs(dict.fromkeys("abcd", 0.4))
    assert proposed[0] in found(responses, data, proposed=[proposed]).candidates


def test_an_estimate_is_by_predictions_where_all_experiments_are_tests(responses, with_d, tmp_path):
    data = runs({"d": 0.6})
    answer = estimate(Rig(), responses, data)
    assert answer.posterior.sets[0] == with_d.posterior.sets[0] == (3,)
    assert answer.posterior.mean[0] == pytest.approx(with_d.posterior.mean[0], abs=0.01)
    few = estimate(Rig(), responses, dict(list(data.items())[:4]))
    both = library(Rig(), [*TESTS, SHAKE], cache=Cache(tmp_path))
    shaken = estimate(Rig(), both, data | runs({"d": 0.6}, tests=[SHAKE]))
    for other in (few, shaken):
        assert other.posterior.log_evidence != pytest.approx(answer.posterior.log_evidence)
        assert other.posterior.sets[0] == (3,)


@dataclass(frozen=True)
class Joints(Rig):
    """A rig whose friction has two parameters, each of which shows little alone."""

    def effects(self):
        size = replace(super().effects()[0].parameters[0])
        both = tuple(replace(size, name=name) for name in ("hip", "calf"))
        return (Effect("rub", "rig", "", both), Effect("d", "rig", "", (size,)))

    def with_effects(self, values):
        own = values.get("rub", {})
        sizes = {
            "a": own.get("hip", 0.0),
            "b": own.get("calf", 0.0),
            "d": values.get("d", {}).get("size", 0.0),
        }
        return replace(self, added=tuple(sizes.items()))


def test_an_effect_of_all_joints_is_found_with_the_size_of_each(tmp_path):
    responses = library(Joints(), TESTS, cache=Cache(tmp_path))
    data = runs({"a": 0.35, "b": 0.35}, 3, noise=4.0 * NOISE)
    answer = predicted(Joints(noise=4.0 * NOISE), responses, data, size_prior(responses))
    effects = answer.posterior.prior.effects(answer.posterior.sets[0])
    assert [*effects.values()] == [(0, 1)]
    low, high = answer.posterior.quantile(0.05), answer.posterior.quantile(0.95)
    assert (low[:2] <= 0.35).all()
    assert (high[:2] >= 0.35).all()
    # All choices of an effect's parameters are equally probable before the data.
    odds = answer.posterior.prior.log_odds
    assert odds((0, 1)) == odds((0,)) == odds((1,))
