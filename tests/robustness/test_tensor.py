"""torch gives numpy's numbers, and gradients that finite differences confirm."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings

from s2r_spec.errors import UsageError
from s2r_spec.robustness import kernels, tensor_windows
from s2r_spec.spec import parse_spec
from tests.errors import naming
from tests.examples import examples
from tests.robustness.definitions import evaluated
from tests.robustness.drawing import Case, cases


@settings(max_examples=examples(120), deadline=None)
@given(case=cases("regular"))
def test_torch_gives_numpys_numbers(case: Case) -> None:
    case = Case(**(vars(case) | {"end": "clip"}))
    signals = {"x": torch.tensor(case.x, dtype=torch.float64), "y": torch.tensor(case.y, dtype=torch.float64)}
    spec = parse_spec(case.text)
    if not spec.channels() or len(case.ticks) == 1:  # one sample has no period
        return
    found = spec.robustness_tensor(
        signals, "it", {"p": torch.tensor(case.param)}, period=float(case.period), until=case.until
    )
    np.testing.assert_allclose(
        np.broadcast_to(found.numpy(), len(case.x)), evaluated(case).values, atol=1e-12
    )


SMOOTH = [
    "always[0, 0.3] (x > 0) and eventually[0.1, 0.4] (y > 0.3)",
    "x > 0 until[0, 0.5] y > 0",
    "x > 0 until[0.2, 0.5) y > 0",
    "(x > -1 release[0, 0.3] y > 0) or norm(x, y) <= 1",
    "always (rise(x > 0) -> once[0, 0.2] (abs(x - y) <= p))",
    "eventually (overshoot(x, p) <= y * x / 2)",
    "x^2 > y since y > 0",
]


@pytest.mark.parametrize("temperature", [0.0, 0.1])
@pytest.mark.parametrize("text", SMOOTH)
def test_gradients_against_finite_differences(text: str, temperature: float) -> None:
    spec = parse_spec(f"signal x signal y param p in [0, 1] require it: {text}")
    generator = torch.Generator().manual_seed(1)
    x, y = torch.randn(2, 2, 12, generator=generator, dtype=torch.float64).requires_grad_()
    p = torch.full((2,), 0.37, dtype=torch.float64, requires_grad=True)

    def rho(x: torch.Tensor, y: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
        found = spec.robustness_tensor({"x": x, "y": y}, "it", {"p": p}, period=0.1, temperature=temperature)
        return found[..., 0][torch.isfinite(found[..., 0])]

    assert torch.autograd.gradcheck(rho, (x.detach().requires_grad_(), y.detach().requires_grad_(), p))


@pytest.mark.parametrize("text", SMOOTH)
def test_a_cold_minimum_is_the_exact_one(text: str) -> None:
    spec = parse_spec(f"signal x signal y param p = 0.37 require it: {text}")
    x, y = torch.randn(2, 5, 20, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    exact, *smooth = (
        spec.robustness_tensor({"x": x, "y": y}, "it", period=0.1, temperature=t)[:, 0]
        for t in (0, 1e-2, 1e-4)
    )
    # 40 numbers at most meet in a minimum, in at most 6 levels
    for t, found in zip((1e-2, 1e-4), smooth, strict=True):
        assert torch.allclose(found, exact, atol=6 * t * np.log(40))


WINDOWS = [(0, 0), (0, 2), (3, 9), (1, 40), (0, None), (2, None), (70, 80)]


@pytest.mark.parametrize("rows", [(), (2, 3)])
@pytest.mark.parametrize("pieces", [7, 1 << 14])
def test_windows_in_pieces_and_their_gradients(rows: tuple[int, ...], pieces: int, monkeypatch) -> None:
    monkeypatch.setattr(tensor_windows, "PIECE", pieces)
    monkeypatch.setattr(tensor_windows, "RUN", min(pieces, 3))
    left, right = np.random.default_rng(0).normal(size=(2, *rows, 31))
    tensors = [torch.tensor(side).requires_grad_() for side in (left, right)]
    for low, high in WINDOWS:
        for mine, theirs in (
            (tensor_windows.window_min, kernels.window_min),
            (tensor_windows.window_max, kernels.window_max),
        ):
            agrees(mine(tensors[0], low, high), theirs(left, low, high), tensors[:1])
        if low == 0:
            agrees(tensor_windows.until(*tensors, high), kernels.until(left, right, 0, high), tensors)


def agrees(found: torch.Tensor, expected: np.ndarray, sources: list[torch.Tensor]) -> None:
    """Each value is one sample, so that all the gradient of it goes to one sample of that value."""
    np.testing.assert_array_equal(found.detach().numpy(), expected)
    for t in range(found.shape[-1]):
        grads = torch.autograd.grad(found[..., t].sum(), sources, retain_graph=True)
        once, both = torch.cat(grads, -1), torch.cat(sources, -1)
        finite = torch.isfinite(found[..., t])
        assert (once.sum(-1) == finite).all()
        assert ((once == 0) | (both == found[..., t : t + 1])).all()


def test_of_equal_samples_the_earliest_has_the_gradient_whole() -> None:
    x = torch.tensor([2.0, 1.0, 1.0, 3.0], requires_grad=True)
    tensor_windows.window_min(x, 0, 2).sum().backward()
    assert x.grad.tolist() == [0, 2, 1, 1]


def test_nan_is_passed_on() -> None:
    x = torch.tensor([1.0, float("nan"), 2.0, 3.0], requires_grad=True)
    assert tensor_windows.window_max(x, 0, 1).isnan().tolist() == [True, True, False, False]
    assert tensor_windows.until(x, -x, 1).isnan().tolist() == [True, True, False, False]


def test_a_batch_of_vectors_and_parameters() -> None:
    spec = parse_spec("signal u[2] {V} param limit {V} in [1, 9] require it: always[0, 0.2] norm(u) <= limit")
    u = torch.zeros(4, 2, 5, dtype=torch.float64, requires_grad=True)
    rho = spec.robustness_tensor({"u": u}, "it", {"limit": torch.arange(4.0)}, period=0.1)
    assert rho[:, 0].tolist() == [0, 1, 2, 3]
    rho.sum().backward()
    assert torch.isfinite(u.grad).all()


def test_what_torch_does_not_do_is_said() -> None:
    spec = parse_spec(
        "signal x param T in [0, 1] require a: mean(x) > 0 require b: always[0, T] x > 0", "a.stl"
    )
    x = {"x": torch.zeros(3)}
    with pytest.raises(UsageError, match=naming("`mean(x)`", "line 1 of a.stl", "gradient")):
        spec.robustness_tensor(x, "a", period=0.1)
    with pytest.raises(UsageError, match=naming("parameter", "gradient")):
        spec.robustness_tensor(x, "b", {"T": torch.tensor(1.0)}, period=0.1)
    with pytest.raises(UsageError, match=naming("'x'", "y")):
        spec.robustness_tensor({"y": torch.zeros(3)}, "a", period=0.1)
