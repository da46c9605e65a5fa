"""Which parameters are simulated at more than their typical size."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from s2r_spec.backend.effects import catalogue_of
from s2r_spec.diagnose.simulator.axes import effect_axes
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.curve import ResponseCurve
from s2r_spec.diagnose.simulator.library import library, most_rollouts, refined
from s2r_spec.diagnose.simulator.points import all_points, is_curved, points_of, to_refine
from tests.diagnose.toy import SHOW, SPLIT, TEST, Toy

AXES = effect_axes(catalogue_of(Toy()))
NAMES = [axis.name for axis in AXES]


@dataclass(frozen=True)
class Slow(Toy):
    """A machine whose rollouts are too expensive for all sizes of every effect."""

    cost: float = 10.0


@dataclass(frozen=True)
class Limited(Slow):
    """A machine whose effect c begins at 1 N, half of its typical size."""

    def with_effects(self, values):
        machine = super().with_effects(values)
        late = {name: np.sign(x) * max(abs(x) - 1.0, 0.0) if name == "c" else x for name, x in machine.added}
        return replace(machine, added=tuple(late.items()))


def test_the_first_points_are_the_typical_sizes():
    for axis in AXES:
        assert points_of(axis) == (-1.0, 1.0)
        assert points_of(axis, refined=True) == (-2.0, -1.0, -0.3, 0.3, 1.0, 2.0)


@pytest.mark.parametrize(
    ("values", "curved"),
    [
        ([0.0, 0.3, 1.0, 2.0], False),
        ([0.0, 0.4, 1.0, 1.5], False),
        ([0.0, 0.0, 1.0, 2.0], True),
        ([0.0, 0.9, 1.0, 1.0], True),
        ([0.0, 0.0, 0.0, 0.0], False),
    ],
)
def test_a_curve_is_far_from_the_line_to_its_typical_size(values, curved):
    both = np.outer(values, [1.0, -2.0, 0.0])
    both[:, 2] = np.nan
    curve = ResponseCurve(np.array([0.0, 0.3, 1.0, 2.0]), both)
    noise = np.outer([0.0, 9.0, 9.0, 9.0], np.ones(3))
    assert is_curved(curve) == curved
    assert not is_curved(replace(curve, noise=noise))
    assert not is_curved(curve.at_points(np.array([True, False, True, False])))


def test_one_wild_number_at_a_large_size_hides_no_curve():
    both = np.outer([0.0, 0.9, 1.0, 1.0], [1.0, -2.0, 1e6])
    noise = np.outer([0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 1e12])
    assert is_curved(ResponseCurve(np.array([0.0, 0.3, 1.0, 2.0]), both, noise))


def test_a_parameter_is_refined_if_its_estimate_may_reach_the_smallest_point():
    mean, deviation = np.array([0.0, 0.5, -0.2, 0.0]), np.array([0.05, 0.05, 0.05, 0.2])
    assert to_refine(AXES, mean, deviation) == {NAMES[1], NAMES[2], NAMES[3]}
    assert to_refine(AXES, np.zeros(4), np.zeros(4)) == set()


def test_only_a_response_that_is_no_straight_line_has_all_points(tmp_path):
    experiments = [TEST, SPLIT, SHOW]
    made = library(Limited(), experiments, cache=Cache(tmp_path))
    assert all("c.size" in all_points(AXES, made.response(e)) for e in experiments)
    assert "b.size" not in all_points(AXES, made.response(TEST))
    assert sum(most_rollouts(Limited(), experiments, Cache(tmp_path)).values()) == 0


def test_a_cheap_simulator_has_all_sizes_of_every_effect(tmp_path):
    made = library(Toy(), [TEST], cache=Cache(tmp_path))
    assert all_points(AXES, made.response(TEST)) == set(NAMES)


def test_a_refined_library_is_made_of_earlier_and_of_new_runs(tmp_path, monkeypatch):
    first = library(Slow(), [TEST, SHOW], cache=Cache(tmp_path))
    one, other, *_ = [name for name in NAMES if name not in all_points(AXES, first.response(TEST))]
    ran, rollout = [], Slow.rollout

    def counted(self, params, seed):
        ran.append(dict(self.added))
        return rollout(self, params, seed)

    monkeypatch.setattr(Slow, "rollout", counted)
    finer = refined(Slow(), first, {TEST: [one]}, None, lambda done, of: None, Cache(tmp_path))
    assert finer.response(SHOW) is first.response(SHOW)
    assert all_points(AXES, finer.response(TEST)) >= {one}
    assert {tuple(added) for added in ran} <= {(one[0],)}
    before, after = (made.response(TEST).curves[NAMES.index(one)] for made in (first, finer))
    assert set(before.coordinates) < set(after.coordinates)
    assert after.at(1.0) == pytest.approx(before.at(1.0), rel=0.05, abs=0.02)
    ran.clear()
    again = refined(Slow(), finer, {TEST: [other]}, None, lambda done, of: None, Cache(tmp_path))
    assert {tuple(added) for added in ran} <= {(other[0],)}
    assert all_points(AXES, again.response(TEST)) >= {one, other}
