"""What may have ended real rollouts early: asked of a cart whose motor trips where it is asked for too much."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from s2r_cart import SPEC, Cart

import s2r_spec as s2r
from s2r_spec.diagnose.falls import falls, falls_alone
from s2r_spec.diagnose.gap.nominal import Nominal
from s2r_spec.diagnose.simulator.axes import effect_axes
from s2r_spec.diagnose.simulator.bench import Bench

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


def asked(real, sim=None):
    bench = Bench.of(s2r.parse_spec(SPEC), s2r.parse_spec(SPEC).requirements[0], sim or Tripping())
    runs = [(test, real.rollout(test, 7 + n)) for n, test in enumerate(TESTS)]
    nominal = Nominal.of(bench, TESTS, 0)
    return falls(bench, effect_axes(Cart().effects()), runs, nominal), [
        t.failure is not None for _, t in runs
    ]


def test_what_ends_the_simulator_early_at_the_same_tests_and_not_at_others_is_told_with_its_size():
    found, ended = asked(machine(motor=0.62))
    assert 0 < sum(ended) < 5
    assert not found.nominal
    motor = [each for each in found.culprits if each.axis.effect == "motor"]
    assert motor, str(found)
    least = motor[0].axis.value(motor[0].coordinate)
    assert 0.62 <= least < 0.95
    _, fell = asked(machine(motor=least))
    assert fell[-1], "with the least of it, too, the cart trips where it trips most"
    assert motor[0].others == 0
    assert str(motor[0]).split()[0] == f"motor.{motor[0].axis.parameter}"
    assert f" {least:.3g}" in str(motor[0])
    first = found.culprits[0]
    assert abs(first.coordinate) == min(abs(each.coordinate) for each in found.culprits)
    assert f"{first} or " in str(found)
    assert f"of {found.others} other tests" in str(found)


def test_a_range_on_one_side_of_nominal_is_asked_up_to_its_far_end():
    sided = [
        line
        for line in effect_axes(Cart().effects())
        if (line.low == line.nominal) != (line.high == line.nominal)
    ]
    assert sided
    real = machine(coulomb=2.0)
    found, ended = asked(real)
    assert any(ended)
    [coulomb] = [each for each in found.culprits if each.axis.effect == "coulomb"]
    assert 0.0 < coulomb.axis.value(coulomb.coordinate) <= 2.0


def test_a_simulator_that_ends_early_there_by_itself_is_no_gap():
    real = machine(motor=0.62)
    found, ended = asked(real, real)
    assert any(ended)
    assert found.nominal
    assert not found.culprits


def test_a_fall_that_no_effect_makes_has_no_culprit():
    runs = [(test, Cart().rollout(test, n)) for n, test in enumerate(TESTS)]
    runs[0] = (runs[0][0], replace(runs[0][1], meta={"failure": "emergency stop"}))
    bench = Bench.of(s2r.parse_spec(SPEC), "tracking", Cart())
    found = falls(bench, effect_axes(Cart().effects()), runs, Nominal.of(bench, TESTS, 0))
    assert found.culprits == ()


def test_nothing_is_asked_where_nothing_fell_or_everything_did():
    found, ended = asked(machine())
    assert not any(ended)
    assert found is None
    runs = [(test, replace(Cart().rollout(test, 1), meta={"failure": "fall"})) for test in TESTS]
    bench = Bench.of(s2r.parse_spec(SPEC), "tracking", Cart())
    assert falls(bench, effect_axes(Cart().effects()), runs, Nominal.of(bench, TESTS, 0)) is None


def test_where_the_simulator_ends_early_by_itself_and_no_real_rollout_does_is_found():
    weak = machine(motor=0.62)
    ended = [test for n, test in enumerate(TESTS) if weak.rollout(test, 7 + n).failure is not None]
    assert 0 < len(ended) < len(TESTS)
    bench = Bench.of(s2r.parse_spec(SPEC), "tracking", weak)
    strong = [(test, Cart().rollout(test, 7 + n)) for n, test in enumerate(TESTS)]
    nominal = Nominal.of(bench, TESTS, 0)
    assert falls_alone(strong, nominal) == ended
    assert falls_alone([(test, weak.rollout(test, 1)) for test in TESTS], nominal) == []


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
