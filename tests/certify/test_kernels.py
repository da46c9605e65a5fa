import numpy as np
import pytest

from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.errors import UsageError
from tests.errors import naming


def matern52(r):
    s = np.sqrt(5) * r
    return (1 + s + s**2 / 3) * np.exp(-s)


def matern32(r):
    s = np.sqrt(3) * r
    return (1 + s) * np.exp(-s)


def rbf(r):
    return np.exp(-(r**2) / 2)


@pytest.mark.parametrize(("name", "formula"), [("rbf", rbf), ("matern52", matern52), ("matern32", matern32)])
def test_the_kernel_is_the_textbook_formula_in_gpytorch_and_in_closed_form(name, formula):
    rng = np.random.default_rng(0)
    left, right = rng.uniform(-1, 1, (20, 2)), rng.uniform(-1, 1, (30, 2))
    scales = np.array([0.2, 0.7])
    distance = np.sqrt((((left[:, None] - right) / scales) ** 2).sum(-1))
    kernel = Kernel(name, (0.2, 0.7))
    torch = pytest.importorskip("torch")  # it loads for seconds
    by_torch = kernel.torch(2)(torch.from_numpy(left), torch.from_numpy(right)).to_dense().numpy()
    for values in (kernel.gram(left, right), by_torch):
        assert np.allclose(values, formula(distance), atol=1e-12, rtol=0)


@pytest.mark.parametrize("name", ["rbf", "matern52", "matern32"])
@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("side", [0.002, 0.05, 0.3])
def test_the_interpolation_bound_covers_the_true_supremum_and_is_not_idle(name, dim, side):
    """‖φ(z) − Σ w φ(corner)‖ is computed exactly from the kernel over one cell."""
    kernel = Kernel(name, 0.2)
    steps = np.full(dim, side)
    corners = np.stack(np.meshgrid(*[[0, 1]] * dim, indexing="ij"), -1).reshape(-1, dim)
    inner = np.stack(np.meshgrid(*[np.linspace(0, 1, 21)] * dim, indexing="ij"), -1).reshape(-1, dim)
    weights = np.prod(np.where(corners[None], inner[:, None], 1 - inner[:, None]), axis=-1)
    cross = kernel.gram(inner * steps, corners * steps)
    gram = kernel.gram(corners * steps, corners * steps)
    squared = 1 - 2 * (weights * cross).sum(1) + ((weights @ gram) * weights).sum(1)
    truth = np.sqrt(squared.max())
    slack = 5 if side < 0.2 else 50  # the bound is meant for small cells; on large ones it need only hold
    assert truth <= kernel.hidden(steps).sum(axis=-1) <= slack * truth


@pytest.mark.parametrize(("name", "formula"), [("rbf", rbf), ("matern52", matern52), ("matern32", matern32)])
def test_a_function_changes_by_no_more_than_the_bound_and_nearly_by_it_over_a_short_side(name, formula):
    """|J(x) − J(y)| ≤ ‖J‖ sqrt(2 − 2k), which the difference of two sections attains."""
    for side, slack in ((1e-4, 1.001), (0.05, 1.5), (0.7, 10.0)):
        truth = np.sqrt(2 - 2 * formula(side / np.array([0.2, 0.7])))
        change = Kernel(name, (0.2, 0.7)).change(np.full(2, side))
        assert (truth <= change).all()
        assert (change <= slack * truth).all()


@pytest.mark.parametrize(("name", "formula"), [("rbf", rbf), ("matern52", matern52)])
def test_what_a_cell_hides_is_h2_8_times_the_largest_second_derivative(name, formula):
    """That is at most the root of the kernel's fourth derivative at 0, here by differences."""
    step = 0.01
    fourth = (2 * formula(2 * step) - 8 * formula(step) + 6) / step**4
    hidden = Kernel(name, 1.0).hidden(np.array([0.1]))[0]
    assert hidden == pytest.approx(np.sqrt(fourth) / 8 * 0.1**2, rel=0.05)


def test_what_a_cell_of_the_once_differentiable_kernel_hides_is_h_4_times_the_change_of_the_derivative():
    """Twice the change of k'' bounds its square, and k'' changes fastest at 0."""
    r = np.geomspace(1e-6, 1, 200)
    second = 3 * (np.sqrt(3) * r - 1) * np.exp(-np.sqrt(3) * r)
    steepest = (2 * (second + 3) / r).max()
    hidden = Kernel("matern32", 1.0).hidden(np.array([0.1]))[0]
    assert hidden == pytest.approx(np.sqrt(steepest * 0.1) * 0.1 / 4, rel=1e-3)


@pytest.mark.parametrize("length", [1e300, 1e-300, np.inf])
def test_a_lengthscale_that_cannot_be_squared_is_refused(length):
    with pytest.raises(UsageError, match="lengthscale of rbf"):
        Kernel("rbf", (0.2, length))


@pytest.mark.parametrize("name", ["rbf", "matern52", "matern32"])
@pytest.mark.parametrize("dim", [1, 3])
def test_sides_for_an_error_have_it_and_each_axis_an_equal_part(name, dim):
    kernel = Kernel(name, tuple(0.2 + np.arange(dim)))
    sides = kernel.sides_for(0.01, dim)
    assert kernel.hidden(sides).sum(axis=-1) == pytest.approx(0.01)
    assert kernel.hidden(sides) == pytest.approx(np.full(dim, 0.01 / dim))


@pytest.mark.parametrize(
    ("name", "lengthscale", "facts"),
    [
        ("matern", 0.2, ["'matern'", "did you mean 'matern52'", "matern32, matern52, rbf"]),
        ("rbf", 0.0, ["lengthscale", "rbf", "0.0"]),
        ("rbf", (0.2, -1), ["lengthscale", "rbf", "(0.2, -1.0)"]),
    ],
)
def test_a_bad_kernel_is_refused(name, lengthscale, facts):
    with pytest.raises(UsageError, match=naming(*facts)):
        Kernel(name, lengthscale)


def test_one_lengthscale_per_axis_or_one_for_all():
    with pytest.raises(UsageError, match=naming("rbf", "2", "3")):
        Kernel("rbf", (0.1, 0.2)).lengthscales(3)
