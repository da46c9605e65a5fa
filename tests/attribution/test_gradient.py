"""The gradient of a margin: finite differences, and torch where torch has one."""

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from s2r_spec.attribution.gradient import margin_gradient
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.sampled import numbers_at, sampled_algebra
from s2r_spec.robustness.ticks import clock_of
from s2r_spec.spec import parse_spec
from tests.examples import examples
from tests.robustness.drawing import COMPARISONS, text_of

TEXTS = [
    "x * y / 2 <= p",
    "norm(x, y, u) > 1",
    "overshoot(x, y) <= abs(y - x) + min(x, y, 0.1)",
    "sqrt(abs(x)) + x^2 == 3",
    "if(x >= 0, x, 2 * y) <= 1",
    "delay(x, 0.2) >= deriv(y * 1 {s})",
    "integral(x) - integral(y, 0.25) != 0 {s}",
    "mean(y) + mean(x, 0.33) > 0",
    "norm(u) / (2 + x^2) + u[1] <= init(y)",
    "count(y > 0, 0.3) + sign(x) + x <= 1",
    "duration(x > 0) + x * 1 {s} <= 1 {s}",
]
HEAD = "signal x signal y signal u[2] param p in [-9, 9]\n"


def gradient(spec, signals, times, sample, p):
    clock = clock_of(times)
    node = spec.formulas["it"]

    def margin(given):
        numbers = numbers_at(SampledSignals(clock, given, {"p": np.full((1, 1), p)}))
        return float(np.broadcast_to(Walk(sampled_algebra(numbers))(node), times.size)[sample]), numbers

    _, numbers = margin(signals)
    return margin_gradient(node, numbers, sample), lambda given: margin(given)[0]


def random_signals(n, generator):
    return {
        "x": generator.normal(size=(1, n)),
        "y": generator.normal(size=(1, n)),
        "u": generator.normal(size=(2, n)),
    }


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("text", TEXTS)
def test_against_finite_differences(text, even):
    generator = np.random.default_rng(len(text))
    n = 12
    times = np.arange(n) * 0.1 if even else np.cumsum(generator.uniform(0.05, 0.15, n))
    signals = random_signals(n, generator)
    spec = parse_spec(f"{HEAD}require it: {text}")
    for sample in (0, 7, n - 1):
        found, margin = gradient(spec, signals, times, sample, 0.4)
        for name, values in signals.items():
            slope = found.get(name, np.zeros_like(values))
            for place in np.ndindex(values.shape):
                moved = {key: array.copy() for key, array in signals.items()}
                step = 1e-6
                moved[name][place] += step
                up = margin(moved)
                moved[name][place] -= 2 * step
                assert slope[place] == pytest.approx((up - margin(moved)) / (2 * step), abs=1e-6, rel=1e-5)


@settings(max_examples=examples(60), deadline=None)
@given(comparison=COMPARISONS, seed=st.integers(0, 1000), sample=st.integers(0, 4))
def test_against_torch(comparison, seed, sample):
    generator = np.random.default_rng(seed)
    signals = random_signals(5, generator)
    spec = parse_spec(f"{HEAD}require it: {text_of(comparison, 1)}")
    assume(spec.channels())
    found, _ = gradient(spec, signals, np.arange(5.0), sample, 0.37)
    tensors = {name: torch.tensor(signals[name][0], requires_grad=True) for name in ("x", "y")}
    rho = spec.robustness_tensor(tensors, "it", {"p": torch.tensor(0.37, dtype=torch.float64)}, period=1.0)
    torch.broadcast_to(rho, (5,))[sample].backward()
    for name, tensor in tensors.items():
        if tensor.grad is not None:
            np.testing.assert_allclose(
                found.get(name, np.zeros((1, 5)))[0], tensor.grad.numpy(), rtol=1e-9, atol=1e-12
            )
