import numpy as np
import pytest

from s2r_spec.certify.kernels import Kernel
from s2r_spec.certify.maximise import MOST_POINTS, grid_for
from s2r_spec.errors import UsageError
from s2r_spec.space import Space


def matern52(r):
    s = np.sqrt(5) * r
    return (1 + s + s**2 / 3) * np.exp(-s)


def rbf(r):
    return np.exp(-(r**2) / 2)


@pytest.mark.parametrize(("name", "formula"), [("rbf", rbf), ("matern52", matern52)])
def test_gpytorchs_kernel_is_the_textbook_formula(name, formula):
    rng = np.random.default_rng(0)
    left, right = rng.uniform(-1, 1, (20, 2)), rng.uniform(-1, 1, (30, 2))
    scales = np.array([0.2, 0.7])
    distance = np.sqrt((((left[:, None] - right) / scales) ** 2).sum(-1))
    assert np.allclose(Kernel(name, (0.2, 0.7)).gram(left, right), formula(distance), atol=1e-12, rtol=0)


@pytest.mark.parametrize("name", ["rbf", "matern52"])
@pytest.mark.parametrize("dim", [1, 2])
def test_the_interpolation_bound_covers_the_true_supremum_and_is_not_idle(name, dim):
    """‖φ(z) − Σ w φ(corner)‖ is computed exactly from the kernel over one cell."""
    kernel = Kernel(name, 0.2)
    steps = np.full(dim, 0.05)
    corners = np.stack(np.meshgrid(*[[0, 1]] * dim, indexing="ij"), -1).reshape(-1, dim)
    inner = np.stack(np.meshgrid(*[np.linspace(0, 1, 21)] * dim, indexing="ij"), -1).reshape(-1, dim)
    weights = np.prod(np.where(corners[None], inner[:, None], 1 - inner[:, None]), axis=-1)
    cross = kernel.gram(inner * steps, corners * steps)
    gram = kernel.gram(corners * steps, corners * steps)
    squared = 1 - 2 * (weights * cross).sum(1) + ((weights @ gram) * weights).sum(1)
    truth = np.sqrt(squared.max())
    assert truth <= kernel.interpolation(steps) <= 3 * truth


def test_a_grid_is_as_fine_as_asked_or_says_how_coarse_it_is():
    kernel = Kernel("matern52", 0.2)
    line = grid_for(Space.of({"x": (-0.2, 0.3)}), kernel, 1e-4)
    assert line.interpolation <= 1e-4
    assert {line.points[0, 0], line.points[-1, 0]} == {-0.2, 0.3}
    box = grid_for(Space.of(dict.fromkeys("abcd", (0, 1))), kernel, 1e-6)
    assert len(box.points) <= MOST_POINTS
    assert box.interpolation > 1e-6


@pytest.mark.parametrize(
    ("name", "lengthscale", "message"),
    [
        ("matern", 0.2, "no kernel 'matern'; did you mean 'matern52'? there are matern52, rbf"),
        ("rbf", 0.0, "the lengthscale of rbf is 0.0; it must be positive"),
        ("rbf", (0.2, -1), r"the lengthscale of rbf is \(0.2, -1.0\); it must be positive"),
    ],
)
def test_a_bad_kernel_is_refused(name, lengthscale, message):
    with pytest.raises(UsageError, match=message.replace("?", r"\?")):
        Kernel(name, lengthscale)


def test_one_lengthscale_per_axis_or_one_for_all():
    with pytest.raises(UsageError, match="rbf has 2 lengthscales, but the test space has 3 parameters"):
        Kernel("rbf", (0.1, 0.2)).lengthscales(3)
