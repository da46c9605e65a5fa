"""Tests that were fixed beforehand: any points of the box, any number of replicates, told at once."""

import numpy as np
import pytest

from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.tiling import Tiling
from s2r_spec.certify.search.search import Search
from s2r_spec.errors import UsageError
from s2r_spec.space import Space
from tests.certify.rkhs import RandomFunction, run
from tests.errors import naming, states

LINE = Space.of({"vd": (-0.2, 0.3)})
SQUARE = Space.of({"x": (0.0, 0.5), "y": (-0.5, 0.0)})
KERNEL = Kernel("matern52", 0.2)
USUAL = {"kernel": KERNEL, "B": 1.5, "R": 0.05, "delta": 0.1, "epsilon": 0.06}


def fixed_design(space, function, noise, rng, tests):
    """Return uniform random points with 1 to 10 replicates each, chosen before any noise is drawn."""
    points = rng.uniform(space.lower, space.upper, (tests, space.dim))
    counts = rng.integers(1, 11, tests)
    means = function(points)
    return [
        (space.point(point), mean + noise * rng.normal(size=count))
        for point, mean, count in zip(points, means, counts, strict=True)
    ]


@pytest.mark.parametrize("runs", [15, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("space", "tests", "fine"), [(LINE, 40, 2001), (SQUARE, 60, 101)])
def test_the_bound_holds_on_a_fixed_random_design(space, tests, fine, runs):
    wrong, widths = 0, []
    for seed in range(runs):
        rng = np.random.default_rng([11, seed])
        function = RandomFunction(KERNEL, space, 1.5, rng)
        search = Search(space, **USUAL)
        search.observe(fixed_design(space, function, 0.05, rng, tests), final=True)
        certificate, values = search.certificate(), function(space.grid((fine,) * space.dim))
        wrong += not certificate.lower <= values.max() <= certificate.upper
        wrong += not search.range[0] <= values.min()
        widths.append(certificate.epsilon)
    assert wrong == 0
    assert np.median(widths) < 1.0  # against 3 before any data


def test_a_design_moved_to_the_nearest_points_of_a_grid_would_be_noticed():
    """Why points are added and not snapped: with little noise, the function differs by more than the bound."""
    wrong = 0
    for seed in range(20):
        rng = np.random.default_rng([12, seed])
        function = RandomFunction(KERNEL, LINE, 1.5, rng)
        search = Search(LINE, **(USUAL | {"R": 1e-4}))
        design = fixed_design(LINE, function, 1e-4, rng, 40)
        search.observe([({"vd": round(point["vd"], 2)}, values) for point, values in design], final=True)
        certificate, values = search.certificate(), function(LINE.grid((2001,)))
        refused = certificate.label is Label.REFUSED
        wrong += refused or not certificate.lower <= values.max() <= certificate.upper
    assert wrong == 20


def test_the_order_of_the_list_changes_nothing_that_matters():
    rng = np.random.default_rng(0)
    design = fixed_design(LINE, RandomFunction(KERNEL, LINE, 0.5, rng), 0.05, rng, 30)
    one, other = Search(LINE, **USUAL), Search(LINE, **USUAL)
    one.observe(design, final=True)
    other.observe(reversed(design), final=True)
    assert one.certificate().upper == pytest.approx(other.certificate().upper, abs=1e-9)
    assert one.certificate().lower == pytest.approx(other.certificate().lower, abs=1e-9)


def test_a_final_design_ends_the_search_and_says_what_it_rests_on():
    search = Search(LINE, **USUAL)
    search.observe([({"vd": 0.123}, [0.1, 0.12]), ({"vd": 0.3}, 0.2)], final=True)
    certificate = search.certificate()
    assert search.done
    assert search.ask() == []
    assert certificate.label is Label.BUDGET
    assert (certificate.rollouts, certificate.points) == (3, 2)
    assert any(states(text, "3 outcomes") for text in certificate.assumptions)
    assert -0.2 <= search.suggestion["vd"] <= 0.3


def test_a_search_goes_on_from_a_fixed_design():
    rng = np.random.default_rng(3)
    function = RandomFunction(KERNEL, LINE, 0.4, rng)
    search = Search(LINE, **USUAL)
    search.observe(fixed_design(LINE, function, 0.05, rng, 60))
    assert not search.done
    before = search.certificate()
    run(search, function, 0.05, rng)
    certificate = search.certificate()
    assert certificate.label is Label.CERTIFIED
    assert certificate.rollouts > before.rollouts
    assert before.lower <= certificate.lower <= function(LINE.grid((2001,))).max() <= certificate.upper
    assert certificate.upper <= before.upper


def test_scatter_between_recorded_replicates_refutes_the_proxy():
    rng = np.random.default_rng(0)
    search = Search(LINE, **(USUAL | {"R": 0.01}))
    search.observe([({"vd": vd}, 0.05 * rng.normal(size=5)) for vd in (-0.1, 0.0, 0.1)], final=True)
    assert search.certificate().label is Label.REFUSED
    assert "R = 0.01" in search.certificate().reason


def test_bad_designs_get_a_sentence():
    search = Search(LINE, **USUAL)
    with pytest.raises(UsageError, match=naming("vd = 0.4", "[-0.2, 0.3]")):
        search.observe([({"vd": 0.4}, [1.0])])
    with pytest.raises(UsageError, match=naming("outcome 1", "{'vd': 0.0}")):
        search.observe([({"vd": 0.0}, [1.0, float("nan")])])
    with pytest.raises(UsageError, match=naming("(1, 2)")):
        search.observe([({"vd": 0.0}, [[1.0, 2.0]])])
    assert search.certificate().rollouts == 0
    search.ask()
    with pytest.raises(UsageError, match="open"):
        search.observe([({"vd": 0.0}, [1.0])])


@pytest.mark.parametrize("space", [LINE, SQUARE])
def test_an_added_point_keeps_its_coordinates_and_harms_no_later_split(space):
    tiling = Tiling(space, KERNEL, 0.01)
    rng = np.random.default_rng(0)
    added = rng.uniform(space.lower, space.upper, (5, space.dim))
    places = [tiling.add(vector) for vector in added]
    assert [tiling.add(vector) for vector in added] == places
    assert tiling.add(space.lower) < places[0]
    for _ in range(3):
        tiling.split(rng.choice(len(tiling), 5, replace=False))
        assert np.array_equal(tiling.points[places], added)
        corners = tiling.points[tiling.corners]
        sides = corners.max(axis=1) - corners.min(axis=1)
        assert np.prod(sides, axis=1).sum() == pytest.approx(np.prod(space.upper - space.lower))
        assert np.allclose(tiling.error, KERNEL.hidden(sides).sum(axis=-1))
