"""Whether a gap matters: field cases, machines without a gap, failures, and values that are no number."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.base.json_values import to_json
from s2r_spec.diagnose.gap.materiality import (
    RolloutsAtTest,
    compared_at_all_tests,
    materiality,
    moderate,
    same_failures,
    smallest_tolerance,
    tail,
)
from s2r_spec.diagnose.gap.nominal import Nominal
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.errors import UsageError
from s2r_turtlebot.effects import turtlebot
from tests.errors import naming

SPEC = Path(__file__).parents[2] / "specs" / "turtlebot.stl"
TESTS, SEEDS = 20, 100
REPLICATED = (3,) * 7 + (1,) * 13
SCATTER = {
    "normal": lambda rng, size: rng.normal(size=size),
    "least of a window": lambda rng, size: (np.euler_gamma - rng.gumbel(size=size)) * np.sqrt(6) / np.pi,
    "one-sided": lambda rng, size: 1.0 - rng.exponential(size=size),
}


def draw(rng, margin, gap=0.0, of="normal", real=(1,) * TESTS, ratio=1.0, uneven=0.0):
    """Return rollouts at 20 tests; lengths in standard deviations of ρ, ``gap`` one number or one for each test."""
    size, gap = np.exp(uneven * rng.normal(size=TESTS)), np.broadcast_to(gap, TESTS)
    return [
        RolloutsAtTest(
            {"v": float(t)},
            margin + gap[t] + ratio * size[t] * SCATTER[of](rng, real[t]),
            margin + size[t] * SCATTER[of](rng, 6),
        )
        for t in range(TESTS)
    ]


@pytest.mark.parametrize("of", SCATTER)
def test_a_machine_without_a_gap_is_not_material_in_95_of_100_seeds_at_a_margin_of_0(of):
    alarms = [
        materiality(draw(np.random.default_rng(seed), 0.0, of=of, uneven=0.5)).matters
        for seed in range(SEEDS)
    ]
    assert sum(alarms) <= 5


def test_a_machine_that_scatters_twice_as_much_has_no_gap_either():
    alarms = [
        materiality(draw(np.random.default_rng(seed), 0.0, 0.0, "least of a window", REPLICATED, 2.0)).matters
        for seed in range(SEEDS)
    ]
    assert sum(alarms) <= 5


def test_changes_of_sign_at_4_of_20_tests_are_found():
    """ρ like that of a twin of the A1 with weak motors, in m/s: lower the faster it walks."""
    rng = np.random.default_rng(0)
    margin = np.linspace(0.035, 0.017, TESTS)
    lost = np.linspace(0.0, 0.027, TESTS)
    tests = [
        RolloutsAtTest(
            {"vd": float(t)},
            margin[t] - lost[t] + 0.0015 * rng.normal(size=1),
            margin[t] + 0.0015 * rng.normal(size=6),
        )
        for t in range(TESTS)
    ]
    found = materiality(tests, "m/s", 0.03)
    assert found.matters
    assert sum(at.changes_sign for at in found.places) == sum(at.real < 0 for at in found.tests) >= 4
    assert found.largest.params["vd"] == found.places[0].params["vd"] >= 16.0
    assert to_json(found)["places"][0]["high"] < 0.0


def test_one_test_of_20_is_found_although_it_loses_less_than_half_of_its_margin():
    """A tracker froze at one test: 0.044 m of a margin of 0.10 m are lost, and ρ scatters by 0.003 m."""
    rng = np.random.default_rng(1)
    frozen = np.arange(TESTS) == 7
    found = materiality(draw(rng, 0.10 / 0.003, -0.044 / 0.003 * frozen))
    assert [at.params["v"] for at in found.places] == [7.0]
    assert not found.places[0].changes_sign
    assert found.places[0].gap > -0.5 * found.places[0].simulated
    # A gap that replicates show to be less than half of the margin does not matter.
    often = materiality(draw(rng, 0.10 / 0.003, -0.030 / 0.003 * frozen, real=(20,) * TESTS))
    assert [at.params["v"] for at in often.tests if at.differs] == [7.0]
    assert not often.matters


def test_a_machine_that_does_better_differs_as_well():
    rng = np.random.default_rng(2)
    assert materiality(draw(rng, -20.0, 40.0)).matters
    assert materiality(draw(rng, 20.0, 40.0)).matters


def test_intervals_of_all_tests_hold_the_gap():
    gap, missed = np.linspace(-10, 10, TESTS), 0
    for seed in range(SEEDS):
        found = materiality(draw(np.random.default_rng(seed), 5.0, gap, "least of a window"))
        missed += any(not at.low <= g <= at.high for at, g in zip(found.tests, gap, strict=True))
    assert missed <= 5


def test_replicates_make_intervals_shorter_unless_the_machine_scatters_more():
    def width(real, ratio=1.0):
        at = materiality(draw(np.random.default_rng(3), 5.0, real=real, ratio=ratio)).tests[-1]
        return at.high - at.low

    single, some = (1,) * TESTS, (4,) * 10 + (1,) * 10
    assert width(some) < width(single) < width(some, 4.0)


def test_a_simulator_without_scatter_takes_that_of_the_machine():
    rng = np.random.default_rng(4)
    tests = [RolloutsAtTest({"v": float(t)}, rng.normal(size=2), np.zeros(6)) for t in range(TESTS)]
    assert not materiality(tests).matters
    alone = [RolloutsAtTest({"v": float(t)}, np.full(1, 1.0 + t), np.full(6, 1.0 + t)) for t in range(3)]
    assert not materiality(alone).matters  # nothing scatters, and nothing differs
    assert materiality([*alone, RolloutsAtTest({"v": 9.0}, np.array([0.4]), np.ones(6))]).matters


def test_failures_count_and_their_place_does():
    def found(*tables):
        rest = [(0, 1, 0, 6)] * (TESTS - len(tables))
        return [
            RolloutsAtTest({"v": float(t)}, np.ones(n - a), np.ones(m - b), a, b)
            for t, (a, n, b, m) in enumerate((*tables, *rest))
        ]

    assert materiality(found()).failures is None
    assert not materiality(found((1, 1, 0, 6))).matters  # one may be an accident
    assert materiality(found((1, 1, 0, 6), (1, 1, 0, 6))).matters
    assert materiality(found((3, 3, 0, 6))).matters
    assert materiality(found((0, 3, 6, 6))).matters  # the simulator falls, and the machine does not
    assert not materiality(found((3, 3, 6, 6))).matters  # both fall there
    assert materiality(found((3, 3, 6, 6), (3, 3, 0, 6))).matters
    alone = materiality([RolloutsAtTest({}, np.empty(0), np.empty(0), 3, 6)])
    assert (alone.tests, alone.largest, alone.matters) == ((), None, False)


def test_failures_without_a_difference_are_called_one_in_20_times_at_most():
    rng, alarms = np.random.default_rng(5), 0
    for _ in range(100):
        p = rng.choice([0.0, 0.02, 0.1, 0.5], TESTS)
        tables = [(int(rng.binomial(1, q)), 1, int(rng.binomial(6, q)), 6) for q in p]
        alarms += same_failures(tables) <= 0.05
    assert alarms <= 0.05 * 100 + 5


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("side", ["real", "simulated"])
def test_a_rho_that_is_no_number_is_refused(value, side):
    one = RolloutsAtTest({"vd": 0.3}, np.ones(2), np.ones(2))
    with pytest.raises(UsageError, match=naming("vd", side)):
        materiality([one, replace(one, **{side: np.array([0.1, value])})])


def test_variances_are_pooled_as_far_as_they_agree():
    rng, freedom = np.random.default_rng(6), np.full(400, 5.0)
    alike = rng.chisquare(5, 400) / 5
    own, of = moderate(alike, freedom)
    assert np.ptp(np.log(own)) < 0.3 * np.ptp(np.log(alike))
    assert of > 50.0
    true = 4.0 / rng.chisquare(4, 400)
    own, of = moderate(true * alike, freedom)
    assert of == pytest.approx(9.0, rel=0.3)
    assert np.log(own / true).std() < np.log(alike).std()
    assert moderate(np.array([2.0]), np.array([5.0])) == (np.array([2.0]), 5.0)


def test_the_tail_bounds_that_of_log_concave_densities():
    z = np.linspace(0.5, 8.0, 31)
    bound = tail(z)
    assert np.all(np.diff(bound) <= 0.0)
    assert np.all(bound >= np.exp(-1.0 - z))  # exponential
    assert np.all(bound >= np.exp(-np.sqrt(2.0) * z))  # Laplace
    assert np.all(bound >= np.maximum(0.0, 1.0 - z / np.sqrt(3.0)))  # uniform


@pytest.mark.parametrize(
    ("bound", "size"),
    [
        ("abs(x - r) <= 2 {mm}", 0.002),
        ("x >= 0.2 {m} and x <= 0.3 {m}", 0.2),
        ("x >= 0 {m}", None),
        ("x <= r", None),
        ("x <= 0.2 {m} and v <= 1 {m/s}", None),
    ],
)
def test_the_tolerance_is_the_smallest_constant_of_the_unit_of_rho(bound, size):
    spec = s2r.parse_spec(
        f"signal x {{m}}\nsignal r {{m}}\nsignal v {{m/s}}\nrequire near: always ({bound})\n"
    )
    found = smallest_tolerance(spec.formulas["near"])
    assert found == (None if size is None else pytest.approx(size))


def diagnosed_turtlebot(machine, frozen=()):
    """Return whether the gap of a turtlebot matters, from one rollout at each of 8 tests; some end early."""
    spec = s2r.load_spec(SPEC)
    bench = Bench.of(spec, spec.requirements[0], turtlebot())
    rng = np.random.default_rng(0)
    tests = [
        spec.space.point(spec.space.lower + u * (spec.space.upper - spec.space.lower))
        for u in rng.uniform(size=(8, 2))
    ]
    rollouts = [(test, turtlebot(machine).rollout(test, 50 + n)) for n, test in enumerate(tests)]
    rollouts = [
        (test, replace(trace, meta={"failure": "lost"}) if n in frozen else trace)
        for n, (test, trace) in enumerate(rollouts)
    ]
    return compared_at_all_tests(bench, rollouts, Nominal.of(bench, tests, 0))


def test_a_turtlebot_is_compared_at_all_of_its_tests():
    same = diagnosed_turtlebot("")
    assert (same.matters, len(same.tests), same.unit, same.tolerance) == (False, 8, "m", 0.2)
    turned = diagnosed_turtlebot("heading_bias.angle=-0.3")
    assert turned.places
    assert all(at.gap < 0.0 for at in turned.places)
    lost = diagnosed_turtlebot("", frozen=(2, 5))
    assert (len(lost.tests), lost.failures.real, lost.failures.matters) == (6, 2, True)
