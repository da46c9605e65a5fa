"""A lengthscale in the wrong unit is refused, or tested inside the box before it is used."""

import numpy as np
import pytest

import s2r_spec as s2r
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.search.plan_request import plan
from s2r_spec.certify.search.search import Search
from s2r_spec.errors import UsageError
from s2r_spec.space import Space
from tests.certify.rkhs import RandomFunction, run
from tests.errors import naming, states

PLANE = Space.of({"x": (-0.3, 0.3), "y": (0.0, 0.3)}, {"x": "m", "y": "m"})
LINE = Space.of({"v": (0.0, 2.0)}, {"v": "m/s"})
USUAL = {"B": 1.5, "R": 0.02, "delta": 1e-3, "epsilon": 0.1, "budget": 600}
BROAD = ("rbf", "matern52", "matern32")


def searched(space, kernel, function, seed=0, **changes):
    search = Search(space, kernel=kernel, seed=seed, **(USUAL | changes))
    rng = np.random.default_rng(seed)
    while not search.done:
        for query in search.ask():
            noise = search.R * rng.normal(size=query.replicates)
            search.tell(query, function(**query.point) + noise)
    return search


@pytest.mark.parametrize("name", BROAD)
@pytest.mark.parametrize("times", [1e2, 1e3, 1e9])
def test_a_parameter_that_the_kernel_makes_constant_is_named_before_any_rollout(name, times):
    certificate = searched(PLANE, Kernel(name, (0.2, 0.3 * times)), lambda x, y: 0.0).certificate()
    assert certificate.label is Label.REFUSED
    assert certificate.rollouts == 0
    assert states(certificate.reason, "lengthscale", "y", "epsilon", "0.1")


@pytest.mark.parametrize("lengthscale", [1.0, 3.0, (0.2, 1.5), (1.5, 0.2)])
def test_what_is_true_inside_refutes_a_kernel_that_is_longer_than_the_box(lengthscale):
    """At the corners of the box the outcome is nearly 0; inside it is not."""
    for seed in range(3):
        certificate = searched(
            PLANE,
            Kernel("matern52", lengthscale),
            lambda x, y: 0.4 * np.cos(np.pi * x / 0.6) * np.sin(np.pi * y / 0.3),
            seed,
        ).certificate()
        assert certificate.label is Label.REFUSED or certificate.lower <= 0.4 <= certificate.upper


@pytest.mark.parametrize("name", BROAD)
def test_a_kernel_that_is_longer_and_true_is_certified_after_each_eighth_was_tested(name):
    kernel = Kernel(name, 3.0)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        function = RandomFunction(kernel, LINE, 0.3, rng)
        search = Search(LINE, kernel=kernel, seed=seed, **USUAL)
        run(search, function, USUAL["R"], rng)
        certificate = search.certificate()
        assert certificate.label is Label.CERTIFIED
        assert certificate.lower <= function(LINE.grid((2001,))).max() <= certificate.upper
        assert (np.histogram(search.tested[:, 0], 8, (0.0, 2.0))[0] > 0).all()
        assert any(states(text, "kernel", "range of v") for text in certificate.assumptions)


def test_as_many_rollouts_in_each_eighth_as_tell_zero_from_epsilon():
    counts = np.zeros(8)
    search = Search(LINE, kernel=Kernel("rbf", 3.0), B=0.4, R=0.05, delta=1e-3, epsilon=0.05, budget=5000)
    rng = np.random.default_rng(0)
    while not search.done:
        for query in search.ask():
            counts[min(7, int(query.point["v"] * 4))] += query.replicates
            search.tell(query, 0.05 * rng.normal(size=query.replicates))
    assert search.certificate().label is Label.CERTIFIED
    assert counts.min() >= 14  # 2 (R/ε)² kl(δ, 1 − δ) is 13.8


def test_recordings_at_the_ends_of_a_range_alone_certify_nothing():
    search = Search(LINE, kernel=Kernel("matern52", 5.0), **(USUAL | {"budget": None}))
    search.observe([({"v": end}, 0.02 * np.ones(30)) for end in (0.0, 2.0)], final=True)
    certificate = search.certificate()
    assert certificate.label is Label.REFUSED
    assert "v in [0.25, 0.5]" in certificate.reason


def test_a_budget_that_ends_before_the_inside_was_tested_certifies_nothing():
    search = searched(LINE, Kernel("matern52", 5.0), lambda v: 0.0, budget=10)
    assert search.certificate().label is Label.REFUSED


def test_a_lengthscale_as_long_as_its_range_changes_nothing():
    """The first batch is of the largest upper bounds: the corners of the box, before anything is known."""
    for lengthscale, inside in ((0.3, False), (0.31, True)):
        search = Search(PLANE, kernel=Kernel("rbf", (0.2, lengthscale)), seed=3, **USUAL)
        points = np.array([query.point["y"] for query in search.ask()])
        assert (len(points) == 8) is inside


@pytest.mark.parametrize(
    ("space", "lengthscale", "budget", "name"),
    [
        (PLANE, 1e-4, 600, "x"),
        (PLANE, (0.2, 1e-6), 600, "y"),
        (LINE, 1e-90, 600, "v"),
        (LINE, 1e-3, None, "v"),
    ],
)
def test_a_lengthscale_that_is_far_too_short_is_refused_at_once(space, lengthscale, budget, name):
    search = searched(space, Kernel("matern52", lengthscale), lambda **point: 0.0, budget=budget)
    certificate = search.certificate()
    assert certificate.label is Label.REFUSED
    assert certificate.rollouts == 0
    assert states(certificate.reason, "lengthscale", name)


@pytest.mark.parametrize("lengthscale", [1e-5, 500.0])
def test_a_plan_names_the_lengthscale(lengthscale):
    settings = {"B": 1.5, "R": 0.02, "delta": 1e-3, "epsilon": 0.1}
    with pytest.raises(UsageError, match=naming("lengthscale", "v")):
        plan(LINE, kernel=Kernel("rbf", lengthscale), **settings)


def test_a_budget_below_the_first_tests_of_a_long_axis_is_refused_before_any_rollout():
    kernel = Kernel("rbf", 3.0)
    first = sum(query.replicates for query in Search(LINE, kernel=kernel, **USUAL).ask())
    assert first > 8
    Search(LINE, kernel=kernel, **(USUAL | {"budget": first})).refuse_hopeless()
    with pytest.raises(UsageError, match=naming("budget", str(first))):
        Search(LINE, kernel=kernel, **(USUAL | {"budget": first - 1})).refuse_hopeless()


def test_an_epsilon_that_nobody_can_run_for_needs_a_budget():
    search = Search(LINE, kernel=Kernel("rbf", 0.5), **(USUAL | {"epsilon": 1e-12, "budget": None}))
    assert search.done
    assert "epsilon" in search.certificate().reason


SPEC = """\
signal vx {m/s}
param  vd {m/s} in [-0.2, 0.3]
require walking: always[0.5 s, 1.5 s] (abs(vx - vd) <= 0.1 {m/s})
certify walking: delta = 1e-3, epsilon = 0.05, B = 0.5, R = 0.02, kernel = rbf(200 {m/s}), fall = -0.5
"""


@pytest.mark.usefixtures("toy")
def test_a_check_begins_no_run(tmp_path):
    with pytest.raises(UsageError, match=naming("lengthscale", "vd", "200 m/s", "400")):
        s2r.check(s2r.parse_spec(SPEC), "toy", tmp_path / "run")
    assert not (tmp_path / "run").exists()
