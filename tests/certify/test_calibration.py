"""Does the bound hold? Random functions whose RKHS norm is exactly B, noise exactly at the proxy R.

With δ = 0.1 the interval may be wrong in one run of ten; the guarantee has
slack, so that no wrong run is expected. Each mutant breaks one line of the
bound, and the same measurement must notice.

The same holds for searches that end as soon as their verdict is known. Their
functions have maxima near 0, so that the rule matters, and a norm that the guard
accepts, so that a refusal of B or of the bounds counts as wrong, too.

The bound that needs no B is measured where it is used: on functions whose norm is
many times the declared B, with maxima near 0, looked at after every batch.
"""

import dataclasses

import numpy as np
import pytest
from scipy.stats import binom, chi2

from s2r_spec.certify.bound import confidence, modes, posterior
from s2r_spec.certify.bound.certificate import Label
from s2r_spec.certify.bound.kernels import Kernel
from s2r_spec.certify.bound.modes import MODES
from s2r_spec.certify.search.search import Search
from s2r_spec.space import Space
from tests.certify.rkhs import RandomFunction, near_zero, run

RUNS = 20
LINE = Space.of({"vd": (-0.2, 0.3)})
B, R, DELTA, EPSILON = 1.5, 0.05, 0.1, 0.06


def most_wrong(runs: int) -> int:
    """Return the number of wrong runs that at most one measurement in a hundred exceeds, each wrong with 0.1."""
    return int(binom.isf(0.01, runs, DELTA))


def wrong_runs(name: str, mode: str, runs: int = RUNS) -> int:
    """Count the runs in which the true maximum over the box is outside the interval, at any time."""
    kernel = Kernel(name, 0.2)
    wrong = 0
    for seed in range(runs):
        rng = np.random.default_rng([7, seed])
        function = RandomFunction(kernel, LINE, B, rng)
        search = Search(
            LINE, kernel=kernel, B=B, R=R, delta=DELTA, epsilon=EPSILON, mode=mode, seed=seed, budget=2000
        )
        run(search, function, R, rng)
        certificate = search.certificate()
        truth = function(LINE.grid((2001,))).max()
        wrong += not certificate.lower <= truth <= certificate.upper
    return wrong


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", ["rbf", "matern52"])
@pytest.mark.parametrize("runs", [6, pytest.param(60, marks=pytest.mark.slow)])
def test_the_bound_holds(name, mode, runs):
    assert wrong_runs(name, mode, runs) == 0


@pytest.mark.parametrize("mode", MODES)
def test_with_the_variance_in_place_of_the_standard_deviation_it_fails(monkeypatch, mode):
    """The paper's σ_n(z) = k_n(z, z), as typed."""
    honest = posterior._Spectrum.moments

    def as_typed(self, scales, points):
        result = honest(self, scales, points)
        return dataclasses.replace(result, std=result.std**2 * R)

    monkeypatch.setattr(posterior._Spectrum, "moments", as_typed)
    assert wrong_runs("rbf", mode) > most_wrong(RUNS)


def test_with_a_third_of_the_width_it_fails(monkeypatch):
    honest = confidence.width
    monkeypatch.setattr(confidence, "width", lambda *args: honest(*args) / 3)
    assert wrong_runs("rbf", "rigorous") > most_wrong(RUNS)


def decided_runs(name: str, runs: int) -> tuple[int, int]:
    """Return how many searches were wrong, or refused although R is right, and how many a known verdict ended."""
    kernel, wrong, decided = Kernel(name, 0.2), 0, 0
    for seed in range(runs):
        rng = np.random.default_rng([8, seed])
        function = near_zero(kernel, LINE, 0.45 * B, 0.2, rng)
        search = Search(
            LINE, kernel=kernel, B=B, R=R, delta=DELTA, epsilon=0.02, seed=seed, budget=200, stop="decided"
        )
        run(search, function, R, rng)
        certificate = search.certificate()
        truth = function(LINE.grid((2001,))).max()
        # Noise exactly at R is refuted with probability ≤ δ, too; this says nothing about the bound.
        noise = certificate.log_e_value >= -np.log(DELTA)
        refused = certificate.label is Label.REFUSED and not noise
        wrong += refused or not certificate.lower <= truth <= certificate.upper
        decided += certificate.label is Label.DECIDED
    return wrong, decided


@pytest.mark.parametrize(
    ("name", "runs"), [("rbf", 20), ("matern52", 12), pytest.param("rbf", 1000, marks=pytest.mark.slow)]
)
def test_the_bound_holds_when_the_verdict_ends_the_search(name, runs):
    wrong, decided = decided_runs(name, runs)
    assert wrong == 0
    assert decided > runs / 2


def test_with_a_third_of_the_width_a_decided_verdict_fails(monkeypatch):
    honest = confidence.width
    monkeypatch.setattr(confidence, "width", lambda *args: honest(*args) / 3)
    assert decided_runs("rbf", RUNS)[0] > most_wrong(RUNS)


def test_with_the_variance_in_place_of_the_standard_deviation_a_decided_verdict_fails(monkeypatch):
    honest = posterior._Spectrum.moments

    def as_typed(self, scales, points):
        result = honest(self, scales, points)
        return dataclasses.replace(result, std=result.std**2 * R)

    monkeypatch.setattr(posterior._Spectrum, "moments", as_typed)
    assert decided_runs("rbf", RUNS)[0] > most_wrong(RUNS)


def test_with_the_radius_of_one_look_at_one_test_a_decided_verdict_fails(monkeypatch):
    """A χ² quantile holds for one test at one time. It leaves out the price of looking after every batch."""
    monkeypatch.setattr(modes.Mode, "radius", lambda self, data, delta: float(chi2.isf(delta, 1)))
    assert decided_runs("rbf", RUNS)[0] > most_wrong(RUNS)


def one_sided_runs(runs: int, level: float) -> tuple[int, int]:
    """Return how many searches ever bound a maximum from below wrongly, and how many bound it from below at all.

    The outcome is a step, ``level`` and a little less, and no B fits it. It is equally large at many tests, so that
    the price of looking at all of them after every batch matters.
    """
    wrong, stated = 0, 0
    for seed in range(runs):
        rng = np.random.default_rng([9, seed])
        search = Search(LINE, kernel=Kernel("matern52", 0.2), B=0.15, R=R, delta=DELTA, epsilon=EPSILON)
        highest = -np.inf
        for _ in range(40):  # a search whose B is refuted ends, so the tests are chosen here
            places = rng.uniform(-0.2, 0.3, size=2).round(2)
            outcomes = [level - 0.02 * (vd > 0.2) + R * rng.normal(size=2) for vd in places]
            search.observe([({"vd": vd}, values) for vd, values in zip(places, outcomes, strict=True)])
            if (found := search.one_sided()) is not None:
                highest = max(highest, found.lower)
        wrong += highest > level
        stated += highest > -np.inf
    return wrong, stated


@pytest.mark.parametrize("level", [0.3, 0.0])
@pytest.mark.parametrize("runs", [8, pytest.param(100, marks=pytest.mark.slow)])
def test_the_bound_without_b_holds_where_no_b_fits(level, runs):
    wrong, stated = one_sided_runs(runs, level)
    assert wrong == 0
    assert stated >= 0.95 * runs if level else not stated


def test_with_a_third_of_the_width_the_bound_without_b_fails(monkeypatch):
    honest = confidence.norm_free_lower
    monkeypatch.setattr(
        confidence, "norm_free_lower", lambda counts, means, radius: honest(counts, means, radius / 9)
    )
    assert one_sided_runs(RUNS // 2, 0.3)[0] > most_wrong(RUNS // 2)


def test_with_the_radius_of_one_look_at_one_test_the_bound_without_b_fails(monkeypatch):
    monkeypatch.setattr(modes.Mode, "radius", lambda self, data, delta: float(chi2.isf(delta, 1)))
    assert one_sided_runs(RUNS // 2, 0.3)[0] > most_wrong(RUNS // 2)
