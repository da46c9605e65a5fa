"""The held-out gap before and after: from numbers, and of a cart."""

import json
from dataclasses import replace

import numpy as np
import pytest
from s2r_cart import SPEC, Cart, real

from s2r_spec import parse_spec
from s2r_spec.base.json_values import to_json
from s2r_spec.diagnose.gap.held_out import ClosedThere, background_machines, compare, held_out_gap, scatter
from s2r_spec.diagnose.gap.materiality import compared_at_all_tests
from s2r_spec.diagnose.gap.nominal import Nominal
from s2r_spec.diagnose.gap.shares import Share, gap
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.runs.compatibility import check_compatibility

TESTS = [{"v": k / 9} for k in range(9)]


def far(share=0.95, size=1.0, tuned=None, background=0.1, seen=None, tests=TESTS, named=True):
    """A gap that is the same at nine tests, and a patch that closes this part of it."""
    n = len(tests)
    closed = [np.full(n, (share if part is None else part) * size) for part in (tuned, None)]
    return compare(np.full(n, size), [np.zeros(n), *closed[: 1 + named]], tests, 0.01, background, "m", seen)


def test_gap_share_and_floor():
    found = far(share=0.5)
    assert (found.before.mean, found.after.mean) == (1.0, 0.5)
    assert found.floor == pytest.approx(0.01 * np.sqrt(2 / np.pi * 4 / 3))
    assert found.share.estimate == pytest.approx(0.5 / (1.0 - found.floor))
    assert found.tests[0].after == 0.5
    # With nine tests, 28 % of all tests may have a larger gap.


@pytest.mark.parametrize(
    ("found", "true"),
    [
        (far(0.95), {"material", "closed"}),
        (far(0.7), {"material", "short", "leaves_more"}),
        (far(0.3), {"material", "short", "leaves_more", "stays"}),
        (far(0.3, tuned=0.9), {"material", "short", "leaves_more", "closed", "better_tuned"}),
        (far(0.95, size=0.05), set()),
        (far(40.0, size=0.05), {"harmful"}),
        (far(0.95, size=0.05, seen=gap(np.ones(4), np.arange(4))), {"elsewhere"}),
    ],
)
def test_what_the_held_out_tests_say(found, true):
    names = ("material", "elsewhere", "closed", "short", "harmful", "leaves_more", "better_tuned")
    said = {name for name in names if getattr(found, name)} | ({"stays"} if found.stays(0.5) else set())
    assert said == true


@pytest.mark.parametrize(
    ("patched", "tuned", "true"),
    [
        (0.9, 0.3, {"closed", "explained"}),
        (0.3, 0.9, {"closed"}),
        (0.7, 0.7, set()),
        (None, 0.9, {"closed"}),
        (None, None, set()),
    ],
)
def test_what_closes_is_the_gap_where_it_shows(patched, tuned, true):
    shares = [None if part is None else Share(part, part - 0.2, part + 0.2) for part in (patched, tuned)]
    found = replace(far(0.0, size=0.05), closed_there=ClosedThere(2, *shares))
    assert {name for name in ("closed", "explained") if getattr(found, name)} == true
    # A material gap of the held-out tests is what has to close, whatever single tests say.
    assert not replace(far(0.3), closed_there=ClosedThere(2, *shares)).closed
    five = replace(found, closed_there=ClosedThere(5, *shares))
    assert (five.stays(0.5), five.short) == (False, patched is not None and patched + 0.2 < 0.8)
    # Few tests make nothing sure.
    low = (Share(0.3, 0.2, 0.4),) * 2
    stay = [replace(found, closed_there=ClosedThere(tests, *low)).stays(0.5) for tests in (2, 5)]
    assert stay == [False, True]
    unsure = replace(found, closed_there=ClosedThere(2, *(Share(0.9, -0.1, 1.1),) * 2))
    assert not unsure.closed


def test_a_gap_of_one_test_stays_for_nobody_knows():
    """The bootstrap over tests has shares from far below 0 to 1, where one test has all of the gap."""
    real = np.array([1.0] + [0.011] * 8)
    left = np.array([0.05] + [0.15] * 8)
    found = compare(real, [np.zeros(9), real - left, real - left], TESTS, 0.01, 0.0, "m")
    assert found.material
    assert not found.stays(0.8)
    assert not found.closed


def test_replicates_say_how_rho_scatters_where_there_are_enough():
    rng = np.random.default_rng(0)
    few = [({"v": 0.0}, 1.0), ({"v": 0.0}, 3.0), ({"v": 1.0}, 0.0)]
    assert scatter(few, 0.5) == 0.5
    many = [({"v": float(k // 4)}, float(k // 4 + 0.2 * rng.normal())) for k in range(400)]
    assert scatter(many, 9.0) == pytest.approx(0.2, rel=0.1)


def test_the_json_object_has_plain_values():
    found = to_json(far(0.7, seen=gap(np.ones(2), np.arange(2))))
    assert json.loads(json.dumps(found)) == found
    assert found["share"].keys() == {"estimate", "low", "high"}
    assert far(named=False).after is None


@pytest.fixture(scope="module")
def bench():
    spec = parse_spec(SPEC)
    return Bench(Cart(), spec, "tracking", check_compatibility(spec, "tracking", Cart()))


def nominal(bench, *parts):
    return Nominal.of(bench, [test for part in parts for test, _ in part], 0)


def runs(tests, effects, first):
    return [(test, real(test, first + k, effects)) for k, test in enumerate(tests)]


CART_TESTS = [{"vd": vd, "acc": acc} for vd in (0.3, 0.6, 0.9) for acc in (1.5, 3.5)]
SEEN, HELD = CART_TESTS[:3] * 2, CART_TESTS[3:] * 2


def test_the_right_patch_closes_the_gap_and_a_wrong_one_does_not(bench):
    held, seen = runs(HELD, {"tilt": -2.5}, 4000), runs(SEEN, {"tilt": -2.5}, 4050)
    tuned = {"tilt": {"force": -2.4}, "viscous": {"coefficient": 0.05}}
    sim = nominal(bench, held, seen)
    found = held_out_gap(bench, held, seen, {"tilt": {"force": -2.5}}, tuned, sim)
    assert found.closed
    assert not found.stays(0.5)
    assert found.seen.mean > found.at_most
    assert 0.0 < found.floor < found.background < found.before.mean
    assert (found.rollouts, found.unit, len(found.tests)) == (6, "m/s", 3)
    wrong = held_out_gap(bench, held, seen, {"motor": {"factor": 0.95}}, {"motor": {"factor": 0.94}}, sim)
    assert wrong.stays(0.5)
    assert wrong.before == found.before
    assert held_out_gap(bench, [], seen, {}, tuned, sim) is None


def test_a_gap_of_a_single_test_closes_there(bench):
    """A tilt of one test alone: on average over the held-out tests it is a little of everything."""
    quiet, tilted = CART_TESTS[3:], CART_TESTS[2:3]
    held = [*runs(quiet * 3, {}, 4000), *runs(tilted, {"tilt": -1.5}, 4050)]
    patch = {"tilt": {"force": -1.5}}
    sim = nominal(bench, held)
    matters = compared_at_all_tests(bench, held, sim)
    alone = replace(matters, tests=tuple(at for at in matters.tests if at.params in tilted))
    assert alone.matters
    found = held_out_gap(bench, held, [], patch, patch, sim, alone)
    assert not found.material
    assert found.closed_there.tests == 1
    assert found.closed
    wrong = {"motor": {"factor": 0.97}}
    assert not held_out_gap(bench, held, [], wrong, wrong, sim, alone).closed
    assert held_out_gap(bench, held, [], patch, patch, sim).closed_there is None


def test_a_gap_of_the_other_tests_closes_there(bench):
    held, seen = runs(HELD, {}, 4000), runs(SEEN, {"tilt": -2.5}, 4050)
    found = held_out_gap(bench, held, seen, {}, {"tilt": {"force": -2.5}}, nominal(bench, held, seen))
    assert found.elsewhere
    assert found.closed_there.tests == len(CART_TESTS[:3])
    assert (found.closed_there.share, found.closed, found.explained) == (None, True, False)


def test_a_healthy_machine_has_no_material_gap_and_one_test_is_enough_to_measure_it(bench):
    for tests in (HELD, HELD[:1] * 4):
        held = runs(tests, {}, 9000)
        found = held_out_gap(bench, held, [], {}, {}, nominal(bench, held))
        assert not found.material
        assert (found.after, found.seen) == (None, None)


def test_random_machines_have_a_little_of_every_effect_within_its_range(bench):
    machines = background_machines(bench, 0)
    assert machines == background_machines(bench, 0) != background_machines(bench, 1)
    tilt = np.array([one["tilt"]["force"] for one in machines])
    drag = np.array([one["viscous"]["coefficient"] for one in machines])
    # Typical sizes are 2 N and 2 N s/m, of which 5 % is the deviation.
    assert 0.06 < tilt.std() < 0.14
    assert tilt.min() < 0.0 <= drag.min()
