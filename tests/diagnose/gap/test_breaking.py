"""The size at which an effect breaks the requirement: stated from the library, and simulated."""

from dataclasses import dataclass, replace

import jsonschema
import numpy as np
import pytest
from s2r_cart import SPEC, Cart

import s2r_spec as s2r
from s2r_spec.backend import Channel, Effect, EffectParameter, Parameter
from s2r_spec.diagnose.gap.breaking import breaking_sizes
from s2r_spec.diagnose.inference.estimates import EffectEstimate, ParameterEstimate
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import library, most_rollouts
from s2r_spec.diagnose.simulator.score import Score
from s2r_spec.report.records.schema import schema
from s2r_spec.trace import Trace

CART = s2r.parse_spec(SPEC.replace("0.25 {m/s}", "0.8 {m/s}"))
FOUND = {"coulomb": {"force": 0.7}}
TIMES = np.linspace(0.0, 1.0, 21)
LINES = """
param  v in [0, 1]
signal x {m}
require high: always[0, 1 s] (x >= 0 {m})
require higher: always[0, 1 s] (x >= 0.5 {m})
"""


@dataclass(frozen=True)
class Lines:
    """x = 1 − v/2 − a + bump(b): ρ falls by one unit for each of a, sinks and rises with b, and c above 1 ends it."""

    added: tuple[tuple[str, float], ...] = ()
    name: str = "lines"
    model_hash: str = "1"
    duration: float = 1.0
    deterministic: bool = True
    cost: float = 1e-3
    channels: tuple[Channel, ...] = (Channel("x", "m", "height"),)
    parameters: tuple[Parameter, ...] = (Parameter("v", "", 0.0, 1.0, 0.5, "speed"),)

    def effects(self):
        return tuple(
            Effect(name, "", "", (EffectParameter("size", "N", -4.0, 4.0, 0.0, "normal, 0.5 N"),))
            for name in "abc"
        )

    def with_effects(self, values):
        return replace(self, added=tuple((name, of["size"]) for name, of in values.items()))

    def rollout(self, params, seed):
        own = {"a": 0.0, "b": 0.0, "c": 0.0} | dict(self.added)
        b = own["b"]
        height = 1.0 - params["v"] / 2 - own["a"] + (0.4 * b if b < 0.5 else 2.0 - 4.0 * b)
        height -= 0.4 * b if 0 < b < 0.5 else 0.0
        kept = 5 if own["c"] > 1.5 else len(TIMES)
        x = height + 1e-3 * np.random.default_rng(seed).normal(size=kept)
        return Trace(TIMES[:kept], {"x": x}, {"x": "m"}, {"failure": "fell"} if kept == 5 else {})


def sized(a=0.0, b=0.0, c=0.0):
    """Return estimates of these sizes [N], in typical ones of 1 N."""
    return [
        EffectEstimate(
            name,
            "",
            0.0,
            0.0,
            (ParameterEstimate("size", "N", x, x - 0.1, x + 0.1, x, x - 0.1, x + 0.1, 0.1),),
        )
        for name, x in (("a", a), ("b", b), ("c", c))
    ]


def found_on(machine, effects, tmp_path, requirement="high", speeds=(0.2, 1.0)):
    """Return what the library of two tests says of a machine."""
    spec = s2r.parse_spec(LINES)
    bench = Bench.of(spec, requirement, Lines())
    score = Score(spec, requirement, bench.matched)
    made = library(
        bench.backend, [Experiment.test({"v": v}) for v in (0.2, 1.0)], cache=Cache(tmp_path), score=score
    )
    runs = [({"v": v}, machine.rollout({"v": v}, seed)) for seed, v in enumerate(speeds)]
    return breaking_sizes(bench, made, runs, effects)


def test_a_straight_line_breaks_where_it_crosses_zero(tmp_path):
    breaking = found_on(Lines((("a", 0.1),)), sized(a=0.1), tmp_path)
    assert breaking.holds
    assert breaking.rho == pytest.approx(0.4, abs=0.01)
    assert breaking.test == {"v": 1.0}
    one = breaking.by_name["a.size"]
    assert one.below is None
    assert one.above.estimate == pytest.approx(0.5, abs=0.02)
    assert (one.above.low, one.above.high) == (pytest.approx(0.3), pytest.approx(1.0))
    assert one.simulated == (pytest.approx(-2.0), pytest.approx(2.0))
    assert breaking.sizes[0] == one


def test_what_the_others_have_used_up_counts(tmp_path):
    """The machine has 0.3 N of another cause, which the real rollouts show."""
    breaking = found_on(Lines((("a", 0.3),)), sized(), tmp_path)
    assert breaking.by_name["a.size"].above.estimate == pytest.approx(0.2, abs=0.02)


def test_a_test_that_is_not_in_the_library_has_the_response_of_its_neighbour(tmp_path):
    breaking = found_on(Lines(), sized(), tmp_path, speeds=(0.2, 0.6))
    assert breaking.test == {"v": 0.6}
    assert breaking.by_name["a.size"].above.estimate == pytest.approx(0.7, abs=0.02)


def test_an_early_end_gives_an_interval_only(tmp_path):
    one = found_on(Lines(), sized(), tmp_path).by_name["c.size"]
    assert one.above.estimate is None
    assert (one.above.low, one.above.high) == (pytest.approx(1.0), pytest.approx(2.0))
    assert one.below is None


def test_a_machine_that_fails_is_told_what_restores_the_requirement(tmp_path):
    breaking = found_on(Lines((("a", 0.8),)), sized(a=0.8), tmp_path)
    assert not breaking.holds
    one = breaking.by_name["a.size"]
    assert one.above is None
    assert one.below.estimate == pytest.approx(0.5, abs=0.02)


def test_another_requirement_runs_single_effects_again_and_changes_no_response(tmp_path, monkeypatch):
    spec = s2r.parse_spec(LINES)
    bench, tests = Bench.of(spec, "high", Lines()), [Experiment.test({"v": 0.2})]
    first, other = (Score(spec, name, bench.matched) for name in ("high", "higher"))
    cache = Cache(tmp_path)
    most = sum(most_rollouts(bench.backend, tests, cache).values())
    made = library(bench.backend, tests, cache=cache, score=first)
    assert sum(most_rollouts(bench.backend, tests, cache, first).values()) == 0
    assert 0 < sum(most_rollouts(bench.backend, tests, cache, other).values()) < most
    again = library(bench.backend, tests, cache=cache, score=other)
    for one, two in zip(made.responses[0].curves, again.responses[0].curves, strict=True):
        np.testing.assert_array_equal(one.values, two.values)
    here, there = (one.responses[0].robustness[0] for one in (made, again))
    assert here.rho - there.rho == pytest.approx(np.full(here.rho.size, 0.5))
    monkeypatch.setattr(Lines, "rollout", None)
    for score in (None, first, other):
        library(bench.backend, tests, cache=cache, score=score)


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    """A cart with dry friction, and the answer to its rollouts."""
    machine, rng = Cart().with_effects(FOUND), np.random.default_rng(0)
    drawn = CART.space.lower + rng.uniform(size=(20, 2)) * (CART.space.upper - CART.space.lower)
    tests = [dict(zip(CART.space.names, one.tolist(), strict=True)) for one in drawn]
    runs = [(test, machine.rollout(test, 700 + i)) for i, test in enumerate(tests)]
    return tests, s2r.diagnose(CART, Cart(), runs, cache=tmp_path_factory.mktemp("cache"), where=False)


def lowest(tests, size):
    """Return the least mean ρ of the cart as it was found with one more effect."""
    cart = Cart().with_effects(FOUND | size)
    return min(
        np.mean([CART.robustness(cart.rollout(test, seed), params=test)["tracking"] for seed in range(9, 19)])
        for test in tests
    )


def test_on_the_cart_the_stated_size_is_where_the_simulated_rho_changes_its_sign(cart):
    tests, diagnosis = cart
    assert diagnosis.breaking.holds
    crossed = {one.axis.effect: side for one in diagnosis.breaking.sizes for side in one.crossings}
    for name in ("payload", "motor", "tilt"):
        side = crossed[name]
        near, past, at = (
            lowest(tests, side.axis.at(side.axis.value(x))) for x in (side.before, side.after, side.at)
        )
        print(name, near, at, past)
        assert past < 0.0 < near, name
        assert abs(at) < 0.2 * diagnosis.breaking.rho, name


def test_on_the_cart_no_simulated_size_breaks_where_none_is_stated(cart):
    tests, diagnosis = cart
    stands = [one for one in diagnosis.breaking.sizes if not one.crossings]
    assert stands
    for one in stands:
        for end in one.simulated:
            assert lowest(tests, one.axis.at(end)) > 0.0, one.name


def test_the_sizes_are_in_the_json_object(cart):
    _, diagnosis = cart
    jsonschema.validate(diagnosis.to_json(), schema("s2r/diagnosis/2"))
    sizes = diagnosis.to_json()["breaking"]["sizes"]
    assert sizes[0]["effect"] in {"payload", "motor", "tilt"}
    assert {"estimate", "low", "high", "test"} == {*(sizes[0]["above"] or sizes[0]["below"])}
