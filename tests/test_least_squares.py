"""Regularised least squares in directions of very different size."""

import numpy as np
import pytest

from s2r_spec.base.least_squares import root, solved


def equations(sizes, seed=0):
    """Return A = 1 + JᵀJ whose J has these singular values, and its directions (k, k)."""
    rng = np.random.default_rng(seed)
    directions, _ = np.linalg.qr(rng.normal(size=(len(sizes), len(sizes))))
    j = np.diag(sizes) @ directions.T
    return np.eye(len(sizes)) + j.T @ j, directions


@pytest.mark.parametrize("sizes", [[0.0, 1.0, 30.0], [0.0, 0.0, 1e12], [1.0, 1e9, 1e17], [1e17, 1e17, 1e17]])
def test_the_large_directions_are_solved_and_what_rounding_hides_is_none_of_x(sizes):
    matrix, directions = equations(sizes)
    b = directions @ np.array([1.0, 2.0, 3.0])
    x = directions.T @ solved(matrix, b)
    expected = np.array([1.0, 2.0, 3.0]) / (1.0 + np.square(sizes))
    well = np.square(sizes) > 1e-10 * max(sizes) ** 2
    assert x[well] == pytest.approx(expected[well], rel=1e-5)
    assert np.abs(x).max() <= 1.001 * np.abs(expected).max()
    factor = root(matrix)
    assert factor @ factor.T == pytest.approx(matrix, abs=1e-14 * np.abs(matrix).max())


def test_with_a_usual_condition_x_is_that_of_elimination():
    matrix, directions = equations([0.0, 1.0, 1e4])
    assert np.array_equal(solved(matrix, directions), np.linalg.solve(matrix, directions))
    assert np.array_equal(root(matrix), np.linalg.cholesky(matrix))


def test_what_is_not_finite_is_nan():
    matrix, directions = equations([0.0, 1.0, 1e12])
    broken = np.where(directions > directions.min(), directions, np.nan)
    assert np.isnan(solved(matrix, broken)).all()
    assert np.isnan(solved(matrix * np.inf, directions)).all()
