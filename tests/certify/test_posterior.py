import numpy as np
import pytest

from s2r_spec.certify.bound import confidence
from s2r_spec.certify.bound.confidence import SampleEvidence
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.modes import MODES
from s2r_spec.certify.bound.posterior import GPyTorch, Spectral
from s2r_spec.certify.bound.samples import OutcomeSamples


def problem(name, dim, most):
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 0.5, (300, dim))
    counts = np.floor(10 ** rng.uniform(0, np.log10(most), 30))
    samples = OutcomeSamples(rng.choice(300, 30, replace=False), counts, counts * rng.normal(size=30))
    return Kernel(name, 0.2), points, samples


@pytest.mark.parametrize(
    ("name", "dim"), [("rbf", 1), ("matern52", 1), ("matern32", 2), ("rbf", 3), ("matern52", 3)]
)
@pytest.mark.parametrize(("most", "digits"), [(40, 1e-9), (1e6, 1e-6)])
def test_both_engines_agree(name, dim, most, digits):
    """Counts of 1e6 are noise variances that GPyTorch would clamp; they cost both sides some digits."""
    kernel, points, samples = problem(name, dim, most)
    scales = np.array([0.5, 50.0, 1125.0])
    ours, theirs = (engine(kernel).condition(points, samples) for engine in (Spectral, GPyTorch))
    for left, right in (
        (ours.evidence(scales), theirs.evidence(scales)),
        (ours.moments(scales, points), theirs.moments(scales, points)),
    ):
        for mine, other in zip(vars(left).values(), vars(right).values(), strict=True):
            assert np.allclose(mine, other, atol=digits, rtol=digits)


def test_points_that_are_added_later_change_nothing_of_the_old_ones():
    kernel, points, samples = problem("matern52", 2, 40)
    scales = np.array([1.0, 10.0])
    engine = Spectral(kernel)
    assert samples.at.max() < 299
    engine.condition(points[:299], samples)
    grown = engine.condition(points, samples)
    for where in (points, points[250:]):
        fresh = Spectral(kernel).condition(points, samples).moments(scales, where)
        assert np.allclose(grown.moments(scales, where).mean, fresh.mean, atol=1e-12)
        assert np.allclose(grown.moments(scales, where).std, fresh.std, atol=1e-9)


def test_replicates_at_one_point_are_worth_exactly_their_single_rollouts():
    """The posterior and the determinant from means equal those from every rollout by itself."""
    rng = np.random.default_rng(0)
    kernel, c = Kernel("matern52", 0.2), 30.0
    grid = np.linspace(0, 1, 50)[:, None]
    at, counts = np.array([3, 20, 41]), np.array([1, 4, 7])
    single = rng.normal(size=counts.sum())
    means = np.array([part.mean() for part in np.split(single, np.cumsum(counts)[:-1])])
    merged = Spectral(kernel).condition(grid, OutcomeSamples(at, counts.astype(float), counts * means))
    moments, evidence = merged.moments(np.array([c]), grid), merged.evidence(np.array([c]))
    each = grid[np.repeat(at, counts)]
    K, k = c * kernel.gram(each, each), c * kernel.gram(each, grid)
    inverse = np.linalg.inv(K + np.eye(len(each)))
    assert np.allclose(moments.mean[0], k.T @ inverse @ single, atol=1e-9)
    assert np.allclose(moments.std[0] ** 2, c - np.einsum("ng,nm,mg->g", k, inverse, k), atol=1e-9)
    # Within-batch residuals leave the quadratic form of single rollouts larger by their scatter, and nothing else.
    scatter = single @ single - counts @ means**2
    assert evidence.quadratic[0] == pytest.approx(single @ inverse @ single - scatter)
    assert evidence.log_det[0] == pytest.approx(np.linalg.slogdet(np.eye(len(each)) + K)[1])


def test_with_one_scale_the_width_is_beta():
    """β_n = sqrt(B²/c + ln det(I + cM^½KM^½) + 2 ln(1/δ)), whatever the outcomes."""
    log_det, quadratic, c, B, delta = (
        np.array([3.0]),
        np.array([7.0]),
        np.array([0.5]),
        np.array([1.5, 3.0]),
        0.1,
    )
    radius = confidence.data_radius(SampleEvidence(log_det, quadratic), delta)
    widths = confidence.width(B, c, radius, quadratic)
    assert widths[:, 0] == pytest.approx(np.sqrt(B**2 / 0.5 + 3.0 + 2 * np.log(10)))


def test_a_mixture_costs_at_most_the_logarithm_of_its_size_over_its_best_scale():
    log_det, quadratic = np.array([3.0, 9.0, 30.0]), np.array([7.0, 4.0, 1.0])
    mixed = confidence.data_radius(SampleEvidence(log_det, quadratic), 0.1)
    single = [confidence.data_radius(SampleEvidence(log_det[[i]], quadratic[[i]]), 0.1) for i in range(3)]
    assert min(single) <= mixed <= min(single) + 2 * np.log(3)


def test_the_published_beta_is_the_papers_line_2():
    """Against the determinant itself, and never below Theorem A of docs/explanation/certificate.md."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (7, 1))
    gram, (B, R, delta) = Kernel("rbf", 0.3).gram(points, points), (1.5, 0.05, 1e-6)
    eta = 2 / 7
    det = np.linalg.det((1 + eta) * np.eye(7) + gram)
    published = confidence.published_beta(B, R, np.log(det), delta)
    assert published == pytest.approx(B + R * np.sqrt(2 * np.log(np.sqrt(det) / delta)))
    log_det = np.linalg.slogdet(np.eye(7) + gram)[1]
    assert published >= B + R / np.sqrt(1 + eta) * np.sqrt(log_det + 2 * np.log(1 / delta))


def test_the_papers_mode_is_its_algorithm_written_out_over_single_rollouts():
    rng = np.random.default_rng(2)
    kernel, (B, R, delta) = Kernel("matern52", 0.3), (1.5, 0.05, 1e-3)
    grid = np.linspace(0, 1, 30)[:, None]
    at, counts = np.array([2, 11, 25]), np.array([1, 3, 2])
    single = rng.normal(size=counts.sum())
    ridge = 1 + 2 / len(single)
    each = grid[np.repeat(at, counts)]
    K, k = kernel.gram(each, each), kernel.gram(each, grid)
    inverse = np.linalg.inv(K + ridge * np.eye(len(each)))
    mean, std = k.T @ inverse @ single, np.sqrt(1 - np.einsum("ng,nm,mg->g", k, inverse, k))
    beta = confidence.published_beta(B, R, np.linalg.slogdet(K + ridge * np.eye(len(each)))[1], delta)
    norms = np.array([B / R])
    sums = np.array([part.sum() for part in np.split(single / R, np.cumsum(counts)[:-1])])
    data = Spectral(kernel).condition(grid, OutcomeSamples(at, counts.astype(float), sums))
    bound = MODES["paper"](kernel, norms).bound(data, len(single), norms, delta)
    moments = data.moments(bound.scales, grid)
    assert np.allclose(moments.mean[0] * R, mean, atol=1e-9)
    assert np.allclose(bound.widths[0, 0] * moments.std[0] * R, beta * std, atol=1e-9)


def test_a_norm_that_no_data_allow_has_no_width():
    assert np.isnan(confidence.width(np.array([0.1]), np.array([1.0]), 1.0, np.array([5.0]))).all()


def test_a_norm_that_the_data_just_allow_has_the_width_0():
    assert confidence.width(np.array([1.0]), np.array([4.0]), 0.75, np.array([1.0])).tolist() == [[0.0]]


def test_data_that_the_zero_function_fits_ask_for_no_norm():
    gram = Kernel("rbf", 0.3).gram(np.array([[0.0], [0.5]]), np.array([[0.0], [0.5]]))
    assert confidence.smallest_norm(gram, np.array([2.0, 3.0]), np.array([0.1, -0.2]), 1.0) == 0.0


def test_the_dual_bound_is_the_exact_maximum_over_the_confidence_set():
    """max J(z) over ‖J‖ ≤ B and (ȳ−J)ᵀM(ȳ−J) ≤ r, solved as a convex programme by brute force."""
    from scipy.optimize import minimize

    rng = np.random.default_rng(5)
    kernel = Kernel("rbf", 0.3)
    grid = np.array([0.0, 0.4, 0.9, 0.65])[:, None]  # the last one is z
    at, counts, means = np.arange(3), np.array([4.0, 9.0, 2.0]), np.array([1.0, 2.0, 0.5])
    B, radius = 3.0, 4.0
    gram, data = kernel.gram(grid, grid), kernel.gram(grid[:3], grid)
    best = max(
        (
            minimize(
                lambda w: -(gram[3] @ w),
                rng.normal(size=4),
                jac=lambda w: -gram[3],
                constraints=[
                    {"type": "ineq", "fun": lambda w: B**2 - w @ gram @ w},
                    {"type": "ineq", "fun": lambda w: radius - counts @ (means - data @ w) ** 2},
                ],
                options={"maxiter": 1000, "ftol": 1e-14},
            )
            for _ in range(5)
        ),
        key=lambda result: -result.fun if result.success else -np.inf,
    )
    scales = np.geomspace(1e-5, 1e3, 3000)
    fitted = Spectral(kernel).condition(grid, OutcomeSamples(at, counts, counts * means))
    widths = confidence.width(np.array([B]), scales, radius, fitted.evidence(scales).quadratic)[0]
    moments = fitted.moments(scales, grid[3:])
    upper = (moments.mean[:, 0] + widths * moments.std[:, 0]).min()
    assert upper == pytest.approx(-best.fun, abs=1e-4)


def test_the_smallest_norm_is_the_minimum_over_the_data_fit_set():
    """Against the dual solved by brute force: min ‖f‖ s.t. (ȳ−f)ᵀM(ȳ−f) ≤ r, f in the span of the sections."""
    from scipy.optimize import minimize

    rng = np.random.default_rng(1)
    kernel = Kernel("rbf", 0.3)
    points = np.linspace(0, 1, 4)[:, None]
    gram, counts, means, radius = (
        kernel.gram(points, points),
        np.array([3.0, 1, 8, 2]),
        5 * rng.normal(size=4),
        6.0,
    )
    best = minimize(
        lambda a: a @ gram @ a,
        np.linalg.solve(gram, means),
        jac=lambda a: 2 * gram @ a,
        constraints={"type": "ineq", "fun": lambda a: radius - counts @ (means - gram @ a) ** 2},
        options={"maxiter": 1000, "ftol": 1e-12},
    )
    assert best.success
    found = confidence.smallest_norm(gram, counts, means, radius)
    assert found <= np.sqrt(best.fun) * (1 + 1e-6)
    assert found >= np.sqrt(best.fun) * 0.99


def test_the_e_value_refutes_a_small_proxy_and_spares_a_right_one():
    rng = np.random.default_rng(0)
    degrees = 400

    def log_e(std):
        return confidence.noise_e_value(float((std * rng.normal(size=degrees) ** 2).sum()), degrees)

    assert all(log_e(1.0) < np.log(1e3) for _ in range(50))
    scatter = float(((1.5 * rng.normal(size=degrees)) ** 2).sum())
    assert confidence.noise_e_value(scatter, degrees) > np.log(1e6)
    assert confidence.noise_e_value(0.0, 0) == pytest.approx(0.0)


@pytest.mark.parametrize(("scatter", "degrees"), [(0.5, 1), (12.0, 7), (30.0, 0), (900.0, 400)])
def test_the_e_value_is_the_mean_over_the_scales_of_the_formula(scatter, degrees):
    s = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95])
    each = (1 - s) ** (degrees / 2) * np.exp(s * scatter / 2)
    assert confidence.noise_e_value(scatter, degrees) == pytest.approx(np.log(each.mean()))


def test_the_e_value_averages_to_at_most_one_when_the_proxy_is_right():
    """The defining property, exact for Gaussian noise at the proxy: E exp = 1 for each scale."""
    rng = np.random.default_rng(0)
    degrees = 2
    values = [
        np.exp(confidence.noise_e_value(float((rng.normal(size=degrees) ** 2).sum()), degrees))
        for _ in range(20000)
    ]
    # The largest scales are so heavy-tailed that an average over samples sits below the expectation 1.
    assert np.mean(values) <= 1.1
