"""Noise of the instruments: measured in a log, and what it adds to the observables."""

import numpy as np
import pytest

from s2r_spec.diagnose.inference.instruments import instrument_variance, white_noise
from s2r_spec.diagnose.simulator.observables import Observables
from s2r_spec.trace import Trace

TIMES = 0.005 * np.arange(1200)
MOTION = np.column_stack([np.sin(3.0 * TIMES), 0.5 * np.cos(2.0 * TIMES) + 0.2 * TIMES])
NOISE = np.array([0.02, 0.005])
"""Standard deviation of either column."""


def trace(seed=None, extra=0.0, noise=NOISE):
    """A motion of two columns; without a seed it has no noise."""
    rng = np.random.default_rng(seed)
    values = MOTION + extra + (0.0 if seed is None else noise * rng.normal(size=MOTION.shape))
    return Trace(TIMES, {"q": values}, {"q": "rad"})


@pytest.fixture(scope="module", params=[True, False], ids=["in time", "any time"])
def observables(request):
    """Those of traces that agree in time or do not: means over 50 equal parts, or over six windows."""
    made = Observables.of_nominal([trace(), trace()])
    return Observables(made.duration, made.quantities, made.flags, request.param)


def in_units(observables):
    return (NOISE / observables.quantities[0].scale) ** 2


def test_white_noise_on_a_smooth_motion_is_measured(observables):
    found = white_noise(observables, [trace(1), trace(2)])
    assert found["q"] == pytest.approx(in_units(observables), rel=0.2)


def test_a_motion_without_noise_has_none(observables):
    assert (white_noise(observables, [trace()])["q"] < 1e-4 * in_units(observables)).all()


def test_steps_and_impacts_change_nothing(observables):
    steps = (
        np.cumsum(np.arange(len(TIMES)) % 100 == 50)[:, None]
        + 3.0 * (np.arange(len(TIMES)) % 130 == 7)[:, None]
    )
    plain, stepped = (white_noise(observables, [trace(3, extra)])["q"] for extra in (0.0, steps))
    assert stepped == pytest.approx(plain, rel=0.15)


def test_a_channel_that_a_log_lacks_has_no_noise(observables):
    other = Trace(TIMES, {"temperature": np.ones(len(TIMES))}, {"temperature": "K"})
    assert white_noise(observables, [other])["q"] == pytest.approx(np.zeros(2))
    assert white_noise(observables, [])["q"] == pytest.approx(np.zeros(2))


def test_a_log_of_three_samples_says_nothing(observables):
    short = Trace(TIMES[:3], {"q": MOTION[:3]}, {"q": "rad"})
    assert white_noise(observables, [short])["q"] == pytest.approx(np.zeros(2))


def test_the_variance_of_means_is_that_of_many_simulated_logs(observables):
    nominal = observables.vector(trace())
    vectors = np.array([observables.vector(trace(seed)) for seed in range(200)])
    added = instrument_variance(observables, nominal, {"q": in_units(observables)}, len(TIMES))
    group = next(g for g in observables.groups if g.statistic in ("bin", "mean"))
    places = slice(group.start, group.stop)
    assert added[places] == pytest.approx(vectors[:, places].var(axis=0), rel=0.35)
    ratio = (vectors[:, places].var(axis=0) / added[places]).reshape(-1, 2)
    assert ratio.mean(axis=0) == pytest.approx(np.ones(2), abs=0.1)


@pytest.mark.parametrize("size", [1.0, 10.0])
def test_noise_makes_a_ripple_larger_by_the_root_of_its_variance(observables, size):
    nominal = observables.vector(trace())
    noisy = np.mean([observables.vector(trace(seed, noise=size * NOISE)) for seed in range(40)], axis=0)
    added = instrument_variance(observables, nominal, {"q": size**2 * in_units(observables)}, len(TIMES))
    group = next(g for g in observables.groups if g.statistic == "ripple")
    places = slice(group.start, group.stop)
    assert np.sqrt(added[places]) == pytest.approx((noisy - nominal)[places], rel=0.15, abs=2e-3)


def test_no_noise_adds_nothing(observables):
    added = instrument_variance(observables, observables.vector(trace()), {"q": np.zeros(2)}, len(TIMES))
    assert added == pytest.approx(np.zeros(observables.size))


def test_what_a_nominal_run_lacks_adds_a_finite_variance(observables):
    nominal = np.full(observables.size, np.nan)
    assert np.isfinite(instrument_variance(observables, nominal, {"q": in_units(observables)}, 1200)).all()
