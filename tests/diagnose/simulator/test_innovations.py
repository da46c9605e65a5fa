"""Errors of one-step predictions: what they show of a machine, and what they do not."""

import numpy as np
import pytest

from s2r_spec.diagnose.simulator.innovations import LAGS, Innovations, of_columns

N, GAIN = 500, 0.1
TIMES = np.arange(N + 1.0)
POSITION, COMMAND = slice(0, 1), slice(1, 2)


def loop(seed, feedback=0.3, gain=GAIN, delay=0, noise=0.02):
    """Return (N + 1, 2) position and command of a cart that follows a random target."""
    rng = np.random.default_rng(seed)
    target = np.repeat(rng.normal(size=N // 20 + 1), 20)
    x, u = np.zeros(N + 1), np.zeros(N + 1)
    for n in range(N + 1):
        u[n] = feedback * (target[n] - x[n])
        if n < N:
            x[n + 1] = x[n] + gain * u[max(n - delay, 0)] + noise * rng.normal()
    return np.column_stack([x, u])


def vector(innovations, x, columns, times=TIMES):
    return of_columns(innovations.of(x, times, float(N)), columns)


@pytest.fixture(scope="module")
def nominal():
    return Innovations.of_nominal([loop(seed) for seed in range(8)])


def mean(innovations, columns=POSITION, runs=16, **machine):
    each = [vector(innovations, loop(100 + k, **machine), columns) for k in range(runs)]
    return np.mean(each, axis=0), np.array(each)


def test_runs_of_the_nominal_machine_have_mean_0_and_covariance_1(nominal):
    average, each = mean(nominal, runs=60)
    assert np.abs(average).max() < 4.0 / np.sqrt(60) + 0.5
    assert np.var(each, axis=0).mean() == pytest.approx(1.0, abs=0.35)


def test_a_delay_and_a_gain_show_far_beyond_the_scatter(nominal):
    healthy, delayed, weak = (mean(nominal, **own)[0] for own in ({}, {"delay": 2}, {"gain": 0.8 * GAIN}))
    assert np.linalg.norm(delayed - healthy) > 5.0
    assert np.linalg.norm(weak - healthy) > 5.0
    cosine = (delayed - healthy) @ (weak - healthy)
    assert abs(cosine) < 0.9 * np.linalg.norm(delayed - healthy) * np.linalg.norm(weak - healthy)


def test_another_controller_does_not_show_in_the_motion_that_it_commands(nominal):
    healthy, other, weak = (mean(nominal, **own)[0] for own in ({}, {"feedback": 0.4}, {"gain": 0.8 * GAIN}))
    assert np.linalg.norm(other - healthy) < 0.3 * np.linalg.norm(weak - healthy)


def test_an_effect_of_half_the_size_shows_half_as_much(nominal):
    healthy, half, whole = (mean(nominal, gain=GAIN * factor)[0] for factor in (1.0, 0.8, 0.6))
    assert half - healthy == pytest.approx(0.5 * (whole - healthy), abs=0.15 * np.abs(whole - healthy).max())


def test_the_shift_by_noise_of_instruments_is_known(nominal):
    rng = np.random.default_rng(5)
    runs = [loop(200 + k) for k in range(24)]
    sigma = np.array([0.0, 0.1])
    clean, noisy = (
        np.array([vector(nominal, x, POSITION) for x in own])
        for own in (runs, [x + sigma * rng.normal(size=x.shape) for x in runs])
    )
    expected = of_columns(nominal.shift(loop(199), TIMES, float(N), sigma**2), POSITION)
    assert np.linalg.norm((noisy - clean).mean(axis=0) - expected) < 0.6 * np.linalg.norm(expected)
    assert of_columns(nominal.shift(loop(199), TIMES, float(N), np.zeros(2)), POSITION) == pytest.approx(
        np.zeros(expected.size)
    )


@pytest.mark.parametrize(
    ("more", "least", "most"), [({}, 0.7, 1.4), ({"noise": 0.04}, 2.5, 5.5), ({"delay": 2}, 0.6, 2.0)]
)
def test_the_scatter_follows_from_each_trace(nominal, more, least, most):
    """Twice the noise scatters four times as much; an effect does not."""
    each = [of_columns(nominal.scatter(loop(300 + k, **more), TIMES, float(N)), POSITION) for k in range(12)]
    assert least < np.mean(each) < most


def test_a_short_trace_and_one_of_few_samples_show_nothing(nominal):
    x = loop(0)
    assert np.isnan(vector(nominal, x[: N // 2], POSITION, TIMES[: N // 2])).all()
    assert np.isnan(vector(nominal, x[::3], POSITION, TIMES[::3])).all()
    assert np.isfinite(vector(nominal, x, POSITION)).all()


def test_it_is_read_as_it_was_written(nominal):
    again = Innovations.from_json(nominal.to_json())
    x = loop(3)
    for columns in (POSITION, COMMAND):
        assert vector(again, x, columns) == pytest.approx(vector(nominal, x, columns))
        assert again.size(columns) == nominal.size(columns) > 0


def test_a_column_that_never_changes_and_a_trace_of_few_samples_have_none():
    constant = np.column_stack([loop(1)[:, 0], np.ones(N + 1)])
    assert Innovations.of_nominal([constant]).size(COMMAND) == 0
    few = Innovations.of_nominal([loop(1)[: LAGS[-1]]])
    assert few.size(POSITION) == 0
    assert vector(few, loop(1)[: LAGS[-1]], POSITION, TIMES[: LAGS[-1]]).size == 0


def shaken(seed, size):
    """Return the cart with a sideways motion of a size, and a fixed multiple of it."""
    y, rng = np.zeros(N + 1), np.random.default_rng([seed, 1])
    for n in range(N):
        y[n + 1] = 0.9 * y[n] + size * rng.normal()
    return np.column_stack([loop(seed), y, 3.0 * y])


@pytest.mark.parametrize("still", [1e-6, 1e-9, 1e-15])
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_column_that_hardly_moves_in_nominal_runs_may_move_in_another_with_a_multiple_of_it(still, size):
    innovations = Innovations.of_nominal([shaken(seed, still) for seed in range(4)])
    alone = Innovations.of_nominal([loop(seed) for seed in range(4)])
    x = shaken(9, size)
    found, scatter = innovations.of(x, TIMES, float(N)), innovations.scatter(x, TIMES, float(N))
    assert found.keys() == scatter.keys() >= {0, 1, 2}
    assert all(np.isfinite(each).all() for each in (*found.values(), *scatter.values()))
    np.testing.assert_allclose(found[0], alone.of(x[:, :2], TIMES, float(N))[0], rtol=1e-9, atol=1e-12)
    x[5, 1:] = np.inf
    with np.errstate(invalid="ignore", over="ignore"):
        assert np.isnan(innovations.of(x, TIMES, float(N))[2]).all()
