"""What is seen test by test, and what through a few functions of the test."""

from types import SimpleNamespace

import numpy as np
import pytest

from s2r_spec.diagnose.evidence import believed
from s2r_spec.diagnose.held_out import scatter
from s2r_spec.diagnose.how_far import gap, how_far
from s2r_spec.diagnose.joint import Joint, seen_through
from s2r_spec.diagnose.layout import SHOTS, Layout
from s2r_spec.diagnose.models import Surrogate
from s2r_spec.diagnose.prepare import LEAST, LEFT, TREND, _nearer, _of_replicates, _trend
from s2r_spec.space import Axis, Space

pytestmark = pytest.mark.slow  # parts of the first design, which go when the second answers

SPACE = Space((Axis("v", 0.0, 1.0, "m/s"),))
BANK = [{"v": v} for v in np.linspace(0, 1, 7)]
TESTS = [{"v": v} for v in np.linspace(0.02, 0.98, 15)]


class Quiet:
    """Signatures of a simulator that scatters a little."""

    noise = 0.01 * np.eye(3)


def trend(means):
    layout = Layout.of(SPACE, BANK, TESTS)
    return _trend(layout, layout.each(1.0), means, Quiet, np.diag(Quiet.noise))


def test_a_gap_with_a_trend_is_held_by_a_few_functions():
    v = np.array([test["v"] for test in TESTS])
    assert trend(np.stack([5 + v, 3 * v, v**2], axis=1)) > 0.95


def test_a_limit_that_is_reached_at_one_test_is_not():
    means = np.zeros((15, 3))
    means[14] = 20.0
    assert trend(means) < TREND


def test_scatter_is_no_lack_of_a_trend():
    # A gap that is hardly more than its scatter leaves most of itself to scatter, whatever the functions are.
    rng = np.random.default_rng(0)
    found = []
    for _ in range(40):
        scatter = np.sqrt(0.01 * (1.0 + 1.0 / SHOTS)) * rng.normal(size=(15, 3))
        found.append((trend(scatter), trend(0.1 + scatter)))
    alone, small = np.array(found).T
    assert np.mean(alone < TREND) < 0.1
    assert np.mean(small < TREND) < 0.1
    # And where there is a limit besides, it is still seen.
    limited = scatter + np.where(np.arange(15) == 14, 20.0, 0.0)[:, np.newaxis]
    assert trend(limited) < TREND


def test_each_test_by_itself_scatters_as_its_own_rollouts_do():
    layout = Layout.of(SPACE, BANK, [*TESTS, TESTS[0], TESTS[0]])
    each = layout.each(2.0)
    assert each.project.shape == (15, 15)
    np.testing.assert_allclose(np.diag(each.scatter)[:2], [2 / 3 + 1 / SHOTS, 2 + 1 / SHOTS])
    np.testing.assert_allclose(each.through, layout.interpolate)
    data = np.arange(30.0).reshape(15, 2)
    np.testing.assert_allclose(each.level(data), (data**2).mean(axis=0))


def test_coefficients_scatter_as_machine_and_simulator_do_together():
    layout = Layout.of(SPACE, BANK, [*TESTS, TESTS[0], TESTS[0]])
    machine, simulator = np.array([4.0, 1.0]), np.array([0.5, 2.0])
    found = layout.variance(machine, simulator)
    rng = np.random.default_rng(1)
    draws = [
        layout.project
        @ (
            layout.mean(rng.normal(size=(17, 2)) * np.sqrt(machine))
            - (rng.normal(size=(SHOTS, 15, 2)) * np.sqrt(simulator)).mean(axis=0)
        )
        for _ in range(4000)
    ]
    np.testing.assert_allclose(np.var(draws, axis=0), found, rtol=0.15)


def test_replicates_say_how_each_number_scatters():
    rng = np.random.default_rng(2)
    layout = Layout.of(SPACE, BANK, [test for test in TESTS for _ in range(3)])
    rows = rng.normal(size=(45, 3)) * np.array([0.1, 0.1, 2.0])
    multiple, machine = _of_replicates(layout, rows, Quiet)
    assert multiple > 50 / 3
    # 30 degrees of freedom against 10 that say all scatter alike: towards the truth, 1 and 400 times the simulator's.
    assert machine[2] / machine[0] > 3.0
    once = Layout.of(SPACE, BANK, TESTS)
    multiple, machine = _of_replicates(once, rows[:15], Quiet)
    assert multiple == 1.0
    np.testing.assert_allclose(machine, 0.01)


def test_a_fit_seen_through_functions_is_that_of_the_functions():
    rng = np.random.default_rng(0)
    rest, jacobian, project = rng.normal(size=(15, 2)), rng.normal(size=(4, 15, 2)), rng.normal(size=(3, 15))
    seen = seen_through(
        Joint(np.zeros(4), rest, jacobian, 1.0, 2.0), project, np.ones((3, 2)), np.zeros((0, 3, 2))
    )
    np.testing.assert_allclose(seen.rest, project @ rest)
    np.testing.assert_allclose(seen.jacobian[2], project @ jacobian[2])
    assert seen.misfit == pytest.approx(((project @ rest) ** 2).mean())


def far(named, tuned):
    real = np.full(9, 1.0)
    tests = [{"v": k / 9} for k in range(9)]
    return how_far(real, np.zeros(9), real - named, real - tuned, tests, 0.01, 0.05, 3, "m")


def test_a_gap_is_open_only_if_a_little_of_everything_does_not_close_it_either():
    assert far(named=0.7, tuned=0.1).open is False
    assert far(named=0.7, tuned=0.6).open is True
    assert far(named=0.1, tuned=0.6).open is False
    assert far(named=0.7, tuned=0.1).gone is True


def test_what_is_named_falls_short_whatever_a_little_of_everything_closes():
    assert far(named=0.5, tuned=0.1).short
    assert far(named=0.5, tuned=0.1).leaves_more
    assert far(named=0.5, tuned=0.1).better_tuned
    enough = far(named=0.05, tuned=0.05)
    assert (enough.short, enough.leaves_more, enough.better_tuned) == (False, False, False)
    no_gap = how_far(np.zeros(9), np.zeros(9), None, None, [{"v": k} for k in range(9)], 0.01, 0.05, 3, "m")
    assert (no_gap.short, no_gap.leaves_more, no_gap.better_tuned) == (False, False, False)


@pytest.mark.parametrize("machines", [40, pytest.param(120, marks=pytest.mark.slow)])
def test_scatter_alone_is_rarely_a_material_gap_and_one_bad_test_is_one(machines):
    rng, tests = np.random.default_rng(0), [{"v": k / 9} for k in range(9)]
    spread = 0.01 * np.sqrt(1.0 + 1.0 / 3.0)
    alarms = 0
    for _ in range(machines):
        real = spread * rng.normal(size=9)
        alarms += how_far(real, np.zeros(9), None, None, tests, 0.01, 0.0, 3, "m").material
    assert alarms < 0.1 * machines
    bad = np.array([1e-4, 2e-4, 1e-4, 0.4])
    found = how_far(bad, np.zeros(4), None, np.zeros(4), tests[:4], 2e-4, 0.0, 3, "m")
    assert found.before.low < found.floor
    assert found.material
    assert found.open


def test_a_gap_at_tests_that_were_not_held_out_is_told_apart():
    tests, none = [{"v": k / 9} for k in range(9)], np.full(9, 1e-4)
    seen = gap(np.array([1e-4] * 20 + [0.5]), np.arange(21))
    found = how_far(none, np.zeros(9), None, np.zeros(9), tests, 1e-3, 0.0, 3, "m", seen=seen)
    assert (found.material, found.elsewhere) == (False, True)
    assert found.to_json()["elsewhere"] is True
    assert found.to_json()["seen"]["worst"] == 0.5
    both = how_far(none + 1.0, np.zeros(9), None, np.zeros(9), tests, 1e-3, 0.0, 3, "m", seen=seen)
    assert (both.material, both.elsewhere) == (True, False)
    quiet = gap(np.full(21, 1e-4), np.arange(21))
    assert not how_far(none, np.zeros(9), None, np.zeros(9), tests, 1e-3, 0.0, 3, "m", seen=quiet).elsewhere


def test_a_gap_at_held_out_tests_alone_that_nothing_closes_was_overlooked():
    tests, none = [{"v": k / 9} for k in range(9)], np.full(9, 1e-4)
    real = none.copy()
    real[[2, 5]] = -0.4, 0.6
    seen = gap(np.full(21, 1e-4), np.arange(21))
    found = how_far(real, np.zeros(9), None, none, tests, 1e-3, 0.0, 3, "m", seen=seen)
    assert found.overlooked
    assert [test.params for test in found.odd] == [tests[5], tests[2]]
    assert not how_far(
        real, np.zeros(9), None, real, tests, 1e-3, 0.0, 3, "m", seen=seen
    ).overlooked  # closed
    there = gap(np.full(21, 0.5), np.arange(21))
    assert not how_far(real, np.zeros(9), None, none, tests, 1e-3, 0.0, 3, "m", seen=there).overlooked


def test_rho_scatters_as_replicates_do_and_one_unsteady_test_counts_as_one():
    rng = np.random.default_rng(0)
    tests = [{"v": float(k)} for k in range(40) for _ in range(3)]
    even = 0.02 * rng.normal(size=120)
    assert scatter(tests, even, 9.0) == pytest.approx(0.02, rel=0.2)
    # One of forty tests scatters a hundred times as much: the mean |Δρ| is 3.5 times, the mean square 16.
    wild = even * np.where(np.arange(120) < 3, 100.0, 1.0)
    assert scatter(tests, wild, 9.0) == pytest.approx(0.02 * 139 / 40, rel=0.5)
    assert scatter(tests[:6], even[:6], 9.0) == 9.0  # of two tests three each: four degrees of freedom


def test_a_gap_that_a_patch_may_close_for_all_that_its_interval_says_is_not_open():
    tests = [{"v": k / 9} for k in range(9)]
    real = np.array([1.0] * 8 + [60.0])
    # All is closed but the gap at one test, which 1 in 3 resamples do not have.
    simulated = np.append(real[:8], 0.0)
    found = how_far(real, np.zeros(9), simulated, simulated, tests, 0.01, 0.0, 3, "m")
    assert found.material
    assert found.share[0] < 0.5 < 1.0 <= found.share[2]
    assert (found.open, found.unexplained) == (False, False)
    assert not found.harmful
    half = how_far(real, np.zeros(9), 0.3 * real, 0.3 * real, tests, 0.01, 0.0, 3, "m")
    assert half.share[2] < 1.0
    assert (half.open, half.unexplained) == (True, True)
    # Nearly closed but for one test, which the patch makes six times as bad: for all one knows it helps, or harms.
    wild = np.array([0.9] * 8 + [-5.5])
    found = how_far(np.ones(9), np.zeros(9), wild, wild, tests, 0.01, 0.0, 3, "m")
    assert found.share[1] < -1.0 < found.share[0] < 0.5
    assert found.share[2] < 1.0
    assert (found.open, found.unexplained) == (False, False)
    # One that surely harms does not close it.
    worse = how_far(np.ones(9), np.zeros(9), -1.5 * np.ones(9), -1.5 * np.ones(9), tests, 0.01, 0.0, 3, "m")
    assert worse.share[2] < -1.0
    assert (worse.open, worse.unexplained) == (True, True)
    assert not worse.harmful  # the gap was there before
    small = 0.005 * np.ones(9)
    one_test = np.where(np.arange(9) == 4, 3.0, small)
    made = how_far(small, np.zeros(9), small - one_test, small, tests, 0.01, 0.0, 3, "m")
    assert made.harmful
    assert not made.material
    # Nearly a gap before, and a little more than nearly after: not the patch's making.
    close = np.where(np.arange(9) == 4, 0.06, small)
    more = np.where(np.arange(9) == 4, -0.12, small)
    nearly = how_far(close, np.zeros(9), close - more, close, tests, 0.01, 0.0, 3, "m")
    assert not nearly.material
    assert nearly.after.mean > nearly.before.mean
    assert nearly.after.mean > nearly._at_most
    assert not nearly.harmful


@pytest.mark.parametrize(("left", "part"), [(0.0, LEAST), (0.15, 0.15 / LEFT), (LEFT, 1.0), (4.0, 1.0)])
def test_a_simulator_that_is_nearly_right_is_believed_nearer_but_never_than_it_scatters(left, part):
    scatter = np.full((1, 50), 0.01)
    usual = believed(scatter, 0.0)
    view = SimpleNamespace(
        layout=SimpleNamespace(level=lambda data: np.zeros(50)),
        data=np.zeros((1, 50)),
        nuisances=np.zeros((0, 1, 50)),
    )
    near = _nearer(view, scatter, SimpleNamespace(rest=np.sqrt(left * usual)))
    np.testing.assert_allclose(near - scatter, part * (usual - scatter), rtol=1e-9)
    assert (near >= scatter).all()


def test_how_an_effect_acts_begins_where_no_other_explains_it():
    """Friction that fades with the speed looks like friction if it hardly fades."""
    narrow, usual, wide = (np.array(x)[None, None] for x in ([1, 0, 0, 0.0], [1, 0.5, 0, 0], [1, 1, 1, 0.9]))
    ends = np.array([-1.0, 1.0])
    curves = (
        SimpleNamespace(coordinates=ends, change=np.stack([-np.ones((1, 4)), np.ones((1, 4))])),
        SimpleNamespace(coordinates=ends, change=np.concatenate([-usual, usual])),
        SimpleNamespace(coordinates=ends, change=np.concatenate([narrow - usual, wide - usual])),
    )
    catalogue = SimpleNamespace(
        curves=curves,
        owner=np.array([0, 1, 1]),
        first=np.array([0, 1, 1]),
        based=np.array([False, False, True]),
        lower=-np.ones(3),
        upper=np.ones(3),
    )
    surrogate = Surrogate(catalogue, np.eye(1))
    data = np.ones((1, 4)) + 0.3 * narrow[0]
    variance = np.full((1, 4), 1e-4)
    assert surrogate.turned(data, variance).tolist() == [0.0, 0.0, 1.0]
    assert surrogate.turned(data, variance, beside=True).tolist() == [0.0, 0.0, -1.0]


def test_a_patch_that_closes_what_one_test_has_is_not_sure_to_have_closed_the_gap():
    """Of four held-out tests one has nearly all of the gap, and the patch makes two of the others worse."""
    tests = [{"v": k / 9} for k in range(4)]
    real, tuned = np.array([0.01, 0.01, 0.01, 0.5]), np.array([0.04, 0.05, 0.01, 0.5])
    found = how_far(real, np.zeros(4), None, tuned, tests, 0.001, 0.0, 3, "m")
    assert found.material
    assert found.gone
    assert found.tuned_share[1] < 0
    assert not found.closed
    assert far(named=0.7, tuned=0.1).closed
