"""The gap over the test space: bands that hold, a worst test that is where it is, and words about thin data."""

import importlib
import json
import math

import numpy as np
import pytest
from scipy.stats import norm

from s2r_spec.base.json_values import to_json
from s2r_spec.diagnose.gap.materiality import RolloutsAtTest
from s2r_spec.diagnose.gap.surface import Predicted, floor, folded_normal_mean, gap_surface, grid_of
from s2r_spec.errors import UsageError
from s2r_spec.space import Space

LINE = Space.of({"vd": (-0.2, 0.3)}, {"vd": "m/s"})
NOISE = 0.004


def seen(space, gap, places, generator, real=3, simulated=4):
    """Rollouts at places, with this gap and noise on both sides."""
    return tuple(
        RolloutsAtTest(
            space.point(np.atleast_1d(place)),
            gap(np.atleast_1d(place)) + NOISE * generator.normal(size=real),
            NOISE * generator.normal(size=simulated),
        )
        for place in places
    )


def smooth(generator):
    """Return a random function of the line, about 0.02 large."""
    pace, phase, size = (
        generator.normal(0, 8, 30),
        generator.uniform(0, 6.3, 30),
        generator.normal(0, 0.004, 30),
    )
    return lambda x: float(np.cos(pace * x[0] + phase) @ size)


def test_the_band_holds_everywhere_at_once_and_the_worst_test_is_as_sure_as_it_says():
    generator, trials = np.random.default_rng(1), 40
    held = found = 0
    claimed = 0.0
    for trial in range(trials):
        gap = smooth(generator)
        result = gap_surface(LINE, seen(LINE, gap, np.linspace(-0.2, 0.3, 10), generator), seed=trial)
        truth = np.array([gap(place) for place in result.grid])
        size = folded_normal_mean(truth, math.sqrt(2) * NOISE)
        held += bool(((truth >= result.signed.lower) & (truth <= result.signed.upper)).all())
        found += abs(result.worst["vd"] - result.grid[size.argmax(), 0]) <= 0.05 + 1e-9
        claimed += result.worst_probability
    assert held >= 0.9 * trials
    assert found >= 0.75 * trials
    # as often right as it says, give or take three deviations
    assert found == pytest.approx(claimed, abs=3 * math.sqrt(trials * 0.25))


def test_a_folded_normal_is_what_many_draws_say():
    draws = np.random.default_rng(0).normal(size=200_000)
    for mean in (-2.0, 0.0, 0.3):
        assert folded_normal_mean(np.array(mean), 0.5) == pytest.approx(
            np.abs(mean + 0.5 * draws).mean(), abs=0.005
        )
    assert folded_normal_mean(np.array([-1.0, 2.0]), 0.0).tolist() == [1.0, 2.0]


def test_a_gap_at_one_end_is_found_there_and_beyond_the_tolerance_there_only():
    generator = np.random.default_rng(2)
    tests = seen(
        LINE, lambda x: -0.04 * norm.cdf((x[0] - 0.15) / 0.05), np.linspace(-0.2, 0.3, 10), generator
    )
    result = gap_surface(LINE, tests, unit="m/s")
    assert result.worst["vd"] > 0.25
    assert result.worst_probability > 0.9
    assert result.worst_within["vd"][0] > 0.2
    assert floor(tests) == pytest.approx(2 * NOISE / math.sqrt(math.pi), rel=0.3)
    assert result.tolerance == 2 * result.floor
    plain = to_json(result)
    assert json.loads(json.dumps(plain)) == plain
    assert plain["notes"] == []
    assert plain["largest"]["low"] < 0.04 < plain["largest"]["high"]


def test_no_gap_is_within_the_band():
    generator = np.random.default_rng(3)
    result = gap_surface(LINE, seen(LINE, lambda x: 0.0, np.linspace(-0.2, 0.3, 10), generator))
    assert result.signed.lower.max() < 0 < result.signed.upper.min()


@pytest.mark.parametrize("dim", [2, 3, 4])
def test_a_corner_of_a_box(dim):
    space = Space.of({f"p{k}": (0.0, 1.0) for k in range(dim)})
    generator = np.random.default_rng(dim)
    places = generator.uniform(size=(25, dim))
    result = gap_surface(space, seen(space, lambda x: 0.05 * float(x[0] + x[1]), places, generator, real=1))
    assert result.worst["p0"] > 0.7
    assert result.worst["p1"] > 0.7
    assert any("0 of 25 tests" in note for note in result.notes)
    assert len(result.along(0)) >= 5


def test_one_rollout_at_one_test_says_so():
    result = gap_surface(LINE, (RolloutsAtTest({"vd": 0.1}, np.array([0.01]), np.array([0.02])),))
    assert any("at 1 test of a space with 1 parameter" in note for note in result.notes)
    assert result.floor is None
    plain = to_json(result)
    # What scatter alone would make is not known.
    assert [plain[name] for name in ("floor", "tolerance")] == [None] * 2


def test_what_cannot_be_asked():
    with pytest.raises(UsageError, match="at least one real rollout"):
        gap_surface(LINE, ())
    many = Space.of({f"p{k}": (0, 1) for k in range(5)})
    with pytest.raises(UsageError, match=r"one to four .* has 5"):
        gap_surface(many, (RolloutsAtTest({}, np.zeros(1), np.zeros(1)),))


CUBE = Space.of({"a": (0.0, 1.0), "b": (0.0, 1.0), "c": (0.0, 1.0)}, {"a": "m", "b": "m", "c": "m"})


def bumpy(x):
    """A gap of which 18 tests do not show where it is largest."""
    return 0.05 * float(np.sin(5 * x[0]) * np.cos(4 * x[1]) + x[2] ** 3)


@pytest.mark.slow
def test_an_improved_simulator_says_where_the_gap_is_largest_between_the_tests():
    generator = np.random.default_rng(4)
    alone = predicted = 0
    for trial in range(6):
        places = generator.uniform(size=(18, 3))
        tests = seen(CUBE, bumpy, places, generator)
        grid = grid_of(CUBE)
        truth = np.array([bumpy(x) for x in grid])
        nearly = Predicted(
            np.array([0.9 * bumpy(x) + 0.002 for x in places]),
            np.array([0.9 * bumpy(x) + 0.002 for x in grid]),
        )
        far = [
            np.abs(
                CUBE.vector(gap_surface(CUBE, tests, seed=trial, predicted=f).worst) - grid[truth.argmax()]
            )
            for f in (None, nearly)
        ]
        alone += bool(far[0].max() <= 0.1)
        predicted += bool(far[1].max() <= 0.1)
    assert predicted == 6
    assert alone < 6


def test_a_simulator_that_predicts_something_else_is_not_used():
    generator = np.random.default_rng(5)
    places = generator.uniform(size=(18, 3))
    tests = seen(CUBE, bumpy, places, generator)
    wrong = Predicted(
        np.array([0.05 * np.cos(9 * x.sum()) for x in places]),
        np.array([0.05 * np.cos(9 * x.sum()) for x in grid_of(CUBE)]),
    )
    plain, misled = (gap_surface(CUBE, tests, seed=1, predicted=f) for f in (None, wrong))
    assert misled.worst == plain.worst
    np.testing.assert_allclose(misled.signed.mean, plain.signed.mean, atol=0.005)


@pytest.mark.slow
def test_a_simulator_that_foretells_everything_is_heard_three_quarters_at_most(monkeypatch):
    """It was fitted to the same rollouts: the box of the worst test must allow for what they do not show."""
    generator = np.random.default_rng(6)
    places = generator.uniform(size=(18, 3))
    tests = seen(CUBE, bumpy, places, generator)
    exact = Predicted(np.array([bumpy(x) for x in places]), np.array([bumpy(x) for x in grid_of(CUBE)]))

    def volume(answer):
        return np.prod([1e-9 + high - low for low, high in answer.worst_within.values()])

    bounded = gap_surface(CUBE, tests, seed=1, predicted=exact)
    monkeypatch.setattr(importlib.import_module("s2r_spec.diagnose.gap.surface"), "MOST_PREDICTED", 1.0)
    surface = gap_surface(CUBE, tests, seed=1, predicted=exact)
    assert bounded.worst == surface.worst
    assert volume(bounded) > 10 * volume(surface)
