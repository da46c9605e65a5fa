import numpy as np
import pytest

from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.tiling import FIRST_POINTS, Tiling
from s2r_spec.certify.search.search import Search
from s2r_spec.space import Space
from tests.certify.rkhs import RandomFunction, run

KERNEL = Kernel("matern52", 0.2)


def boxes(tiling):
    """Return (C, dim) low and high corners, from the points."""
    corners = tiling.points[tiling.corners]
    return corners.min(axis=1), corners.max(axis=1)


@pytest.mark.parametrize("dim", [1, 2, 3, 4])
def test_cells_cover_the_box_without_overlap_however_they_are_split(dim):
    space = Space.of({name: (-0.2, 0.3 + i) for i, name in enumerate("abcd"[:dim])})
    tiling = Tiling(space, KERNEL, 0.01)
    assert len(tiling.points) <= FIRST_POINTS
    rng = np.random.default_rng(0)
    for _ in range(4):
        before = boxes(tiling)
        known = tiling.points.copy()
        parents = tiling.split(rng.choice(len(tiling), min(50, len(tiling)), replace=False))
        low, high = boxes(tiling)
        assert np.prod(high - low, axis=1).sum() == pytest.approx(np.prod(space.upper - space.lower))
        assert (low >= before[0][parents] - 1e-12).all()
        assert (high <= before[1][parents] + 1e-12).all()
        assert np.array_equal(tiling.points[: len(known)], known)
        assert len(np.unique(tiling.points, axis=0)) == len(tiling.points)
        assert np.allclose(tiling.error, KERNEL.hidden(high - low).sum(axis=-1))
    inside = rng.uniform(space.lower, space.upper, (200, dim))
    low, high = (corner[tiling.containing(inside)] for corner in boxes(tiling))
    assert ((low <= inside) & (inside <= high)).all()


def test_both_ends_of_a_range_are_points_exactly():
    points = Tiling(Space.of({"x": (-0.2, 0.3)}), KERNEL, 1e-3).points[:, 0]
    assert {points.min(), points.max()} == {-0.2, 0.3}


def test_a_cell_that_cannot_be_halved_any_more_says_so():
    tiling = Tiling(Space.of({"x": (0.0, 1.0)}), Kernel("rbf", 5.0), 10.0)
    for _ in range(20):
        assert tiling.splittable()[-1]
        tiling.split(np.array([len(tiling) - 1]))
    assert not tiling.splittable()[-1]


@pytest.mark.parametrize(
    ("dim", "name", "fine", "seeds"),
    [
        (1, "rbf", 5001, range(3)),
        (1, "matern32", 5001, range(3)),
        (2, "matern52", 301, range(1)),
        (3, "rbf", 61, range(1)),
        pytest.param(2, "matern52", 301, range(1, 3), marks=pytest.mark.slow),
        pytest.param(3, "rbf", 61, range(1, 3), marks=pytest.mark.slow),
    ],
)
def test_the_certified_maximum_is_never_below_that_of_a_ten_times_finer_grid(dim, name, fine, seeds):
    """Without noise to speak of, all that separates the bound from the truth is what cells may hide."""
    space, kernel = Space.of(dict.fromkeys("abc"[:dim], (0.0, 0.5))), Kernel(name, 0.2)
    for seed in seeds:
        rng = np.random.default_rng(seed)
        function = RandomFunction(kernel, space, 1.0, rng)
        search = Search(space, kernel=kernel, B=2.5, R=1e-4, delta=0.1, epsilon=0.02, seed=seed, budget=3000)
        run(search, function, 0.0, rng)
        certificate, truth = search.certificate(), function(space.grid((fine,) * dim)).max()
        assert certificate.label is Label.CERTIFIED
        assert certificate.lower <= truth <= certificate.upper
        assert 0 <= certificate.discretisation <= 0.02


def test_the_band_contains_the_function_everywhere():
    space = Space.of({"x": (0.0, 0.5), "y": (0.0, 0.5)})
    rng = np.random.default_rng(1)
    function = RandomFunction(KERNEL, space, 0.5, rng)
    search = Search(space, kernel=KERNEL, B=1.5, R=0.02, delta=0.1, epsilon=0.1)
    where = rng.uniform(0, 0.5, (300, 2))
    widths = []
    while not search.done:
        for query in search.ask():
            mean = function(space.vector(query.point))[0]
            search.tell(query, mean + 0.02 * rng.normal(size=query.replicates))
        lower, upper = search.band(where)
        assert (lower <= function(where)).all()
        assert (function(where) <= upper).all()
        widths.append((upper - lower).mean())
    assert widths[-1] < widths[0]
