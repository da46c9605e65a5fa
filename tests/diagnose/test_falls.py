"""What may have ended real rollouts early: asked of a cart whose motor trips where it is asked for too much."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from s2r_cart import SPEC, Cart

import s2r_spec as s2r
from s2r_spec.diagnose.data.rollouts import as_experiment
from s2r_spec.diagnose.gap.nominal import Nominal
from s2r_spec.diagnose.notes import early_ends
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.library import library
from s2r_spec.diagnose.simulator.score import Score

TRIPS = 0.35
"""Speed [m/s] that the measured one may be off from what is wanted, from 0.4 s on."""


@dataclass(frozen=True)
class Tripping(Cart):
    """The cart with a guard that stops it."""

    trips: float = TRIPS

    def rollout(self, params, seed):
        trace = super().rollout(params, seed)
        off = abs(trace["v_ref"] - trace["v_meas"])[(trace.times > 0.4) & (trace.times < 1.0)]
        return (
            replace(trace, meta=dict(trace.meta) | {"failure": "tripped"})
            if off.max() > self.trips
            else trace
        )


def machine(**effects):
    return replace(Tripping(), added=tuple(sorted(effects.items())))


TESTS = [{"vd": 0.2 + 0.1 * n, "acc": 2.0} for n in range(9)]


def asked(real, cache, sim=None):
    """Return what may have ended rollouts of a machine early, and whether each ended early."""
    runs = [(test, real.rollout(test, 7 + n)) for n, test in enumerate(TESTS)]
    return why(runs, cache, sim or Tripping())[0], [trace.failure is not None for _, trace in runs]


def why(runs, cache, sim, simulated=TESTS):
    bench = Bench.of(s2r.parse_spec(SPEC), "tracking", sim)
    tests = [as_experiment(bench, test) for test in simulated]
    score = Score(bench.spec, bench.requirement, bench.matched)
    made = library(Tripping(), tests, cache=Cache(cache), score=score)
    return early_ends(bench, made, runs, Nominal.of(bench, TESTS, 0))


def test_what_ends_the_simulator_early_at_the_same_tests_and_not_at_others_is_told_with_its_size(cache):
    words, ended = asked(machine(motor=0.62), cache)
    assert 0 < sum(ended) < 5
    [size] = re.findall(r"motor\.\w+ = ([\d.]+)", words)
    assert 0.5 <= float(size) < 0.95
    _, fell = asked(machine(motor=float(size)), cache)
    assert all(then for then, now in zip(fell, ended, strict=True) if now)
    assert f"of {len(TESTS) - sum(ended)} others" in words


def test_a_simulated_test_nearest_to_a_fall_and_to_a_rollout_that_stood_does_not_tell_them_apart(cache):
    real = machine(motor=0.62)
    runs = [(test, real.rollout(test, 7 + n)) for n, test in enumerate(TESTS)]
    assert [trace.failure is not None for _, trace in runs][-4:] == [False, True, True, True]
    assert why(runs, cache, Tripping(), TESTS[-1:])[0] == ""
    words = why(runs, cache, Tripping(), [TESTS[0], TESTS[-1]])[0]
    assert "motor" in words
    assert "of 1 other" in words


def test_a_simulator_that_ends_early_there_by_itself_is_no_gap(cache):
    real = machine(motor=0.62)
    words, ended = asked(real, cache, real)
    assert any(ended)
    assert words == "The simulator ends early at these tests, too"


def test_a_fall_that_no_effect_makes_has_no_suspect(cache):
    runs = [(test, Cart().rollout(test, n)) for n, test in enumerate(TESTS)]
    runs[0] = (runs[0][0], replace(runs[0][1], meta={"failure": "emergency stop"}))
    assert why(runs, cache, Tripping())[0].startswith("No simulated size of a single effect")


def test_nothing_is_asked_where_nothing_fell_or_everything_did(cache):
    words, ended = asked(machine(), cache)
    assert not any(ended)
    assert words == ""
    runs = [(test, replace(Cart().rollout(test, 1), meta={"failure": "fall"})) for test in TESTS]
    assert why(runs, cache, Cart())[0] == ""


def test_where_the_simulator_ends_early_by_itself_and_no_real_rollout_does_is_found(cache):
    weak = machine(motor=0.62)
    ended = [test for n, test in enumerate(TESTS) if weak.rollout(test, 7 + n).failure is not None]
    assert 0 < len(ended) < len(TESTS)
    strong = [(test, Cart().rollout(test, 7 + n)) for n, test in enumerate(TESTS)]
    assert why(strong, cache, weak)[1] == ended
    assert why([(test, weak.rollout(test, 1)) for test in TESTS], cache, weak)[1] == []


@pytest.mark.slow
def test_falls_that_the_machine_does_not_have_hide_no_gap(cache):
    """They would make scatter a hundred times, and a little of everything ten times as large as they are."""
    rng = np.random.default_rng(0)
    tests = [{"vd": float(rng.uniform(0.2, 1.0)), "acc": float(rng.uniform(1.0, 4.0))} for _ in range(18)]
    runs = [(test, Cart().rollout(test, n)) for n, test in enumerate(tests)]

    def asked_of(trips):
        sim = replace(machine(), trips=trips)
        return s2r.diagnose(s2r.parse_spec(SPEC), sim, runs, cache=cache, where=False)

    stands, may_fall, falls_itself = map(asked_of, (0.35, 0.25, 0.23))
    assert not any("ends early" in note for note in stands.notes)
    assert may_fall.how_far.background < 1.5 * stands.how_far.background
    assert falls_itself.how_far.floor < 1.5 * stands.how_far.floor
    assert falls_itself.how_far.material
    [note] = [note for note in falls_itself.notes if "ends early at" in note]
    assert f"of {len(tests)} tests" in note
