import numpy as np
import pytest

from s2r_spec.robustness import kernels
from s2r_spec.robustness.kernels import shift, until, window_max, window_min

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("n", [1, 2, 3, 17, 64])
@pytest.mark.parametrize("low", [0, 1, 5])
@pytest.mark.parametrize("width", [1, 2, 3, 8, 13, None])
def test_windows_over_a_batch(n: int, low: int, width: int | None) -> None:
    x = RNG.normal(size=(2, 3, n))
    high = None if width is None else low + width - 1
    last = n if high is None else high + 1
    cut = [x[..., t + low : t + last] for t in range(n)]
    least = np.stack([part.min(-1, initial=np.inf) for part in cut], axis=-1)
    most = np.stack([part.max(-1, initial=-np.inf) for part in cut], axis=-1)
    np.testing.assert_array_equal(window_min(x, low, high), least)
    np.testing.assert_array_equal(window_max(x, low, high), most)


@pytest.mark.parametrize("high", [0, 1, 4, 7, 30, None])
@pytest.mark.parametrize("low", [0, 3])
def test_until_of_a_batch_is_until_of_each(low: int, high: int | None) -> None:
    high = None if high is None else low + high
    left, right = RNG.normal(size=(2, 4, 31))
    each = [until(p, q, low, high) for p, q in zip(left, right, strict=True)]
    np.testing.assert_array_equal(until(left, right, low, high), each)
    # one side for the whole batch
    np.testing.assert_array_equal(until(left[0], right, low, high)[2], until(left[0], right[2], low, high))


def test_nan_spreads_to_the_windows_that_contain_it() -> None:
    x = np.arange(8.0)
    x[4] = np.nan
    assert np.isnan(window_min(x, 0, 2)).tolist() == [t in (2, 3, 4) for t in range(8)]
    assert np.isnan(window_max(x, 1, 2)).tolist() == [t in (2, 3) for t in range(8)]


def test_inputs_stay_as_they_are() -> None:
    x = RNG.normal(size=9)
    x.setflags(write=False)
    for result in (
        window_min(x, 0, 3),
        window_min(x, 0, None),
        window_max(x, 2, 3),
        until(x, x, 0, 4),
        shift(x, 0, 0.0),
    ):
        assert not np.shares_memory(result, x)


def test_shift() -> None:
    x = np.array([1.0, 2.0, 3.0])
    assert shift(x, 1, 9).tolist() == [2, 3, 9]
    assert shift(x, -1, 9).tolist() == [9, 1, 2]
    assert shift(x, -2, 9).tolist() == [9, 9, 1]
    assert shift(x, 7, 9).tolist() == shift(x, -7, 9).tolist() == [9, 9, 9]


@pytest.mark.parametrize("n", [1, 5, 8, 9, 31, 64])
@pytest.mark.parametrize("rows", [(), (1,), (2, 3)])
def test_small_pieces_give_the_same_as_one(n: int, rows: tuple[int, ...], monkeypatch) -> None:
    left, right = RNG.normal(size=(2, *rows, n))
    windows = [(0, 0), (0, 2), (3, 9), (1, 40), (2, None)]

    def every() -> list[np.ndarray]:
        functions = (lambda a, b: window_min(left, a, b)), (lambda a, b: until(left, right, a, b))
        return [function(*window) for function in functions for window in windows]

    whole = every()
    monkeypatch.setattr(kernels, "PIECE", 7)
    monkeypatch.setattr(kernels, "RUN", 3)
    np.testing.assert_equal(every(), whole)


def until_by_loops(left: np.ndarray, right: np.ndarray, first: np.ndarray, last: np.ndarray) -> list[float]:
    """The definition, for witnesses first[t] … last[t]."""
    return [
        max((min([right[s], *left[t:s]]) for s in range(first[t], last[t] + 1)), default=-np.inf)
        for t in range(len(left))
    ]


@pytest.mark.parametrize("n", [1, 2, 9, 40])
@pytest.mark.parametrize(
    ("low", "high"), [(0, 0), (0, 1), (0, 5), (1, 1), (2, 7), (3, 60), (0, None), (4, None)]
)
def test_until_is_its_definition(n: int, low: int, high: int | None, monkeypatch) -> None:
    left, right = RNG.normal(size=(2, n))
    here = np.arange(n)
    last = np.full(n, n - 1) if high is None else np.minimum(here + high, n - 1)
    expected = until_by_loops(left, right, here + low, last)
    np.testing.assert_array_equal(until(left, right, low, high), expected)
    monkeypatch.setattr(kernels, "PIECE", 7)
    monkeypatch.setattr(kernels, "RUN", 3)
    np.testing.assert_array_equal(until(left, right, low, high), expected)


@pytest.mark.parametrize("n", [1, 2, 9, 40])
def test_windows_of_any_place_and_length_are_their_definitions(n: int) -> None:
    for _ in range(20):
        left, right = RNG.normal(size=(2, n))
        first = np.minimum(np.arange(n) + RNG.integers(0, 4, n), n)
        last = np.minimum(first + RNG.integers(-1, n, n), n - 1)
        least = [min(left[a : b + 1], default=np.inf) for a, b in zip(first, last, strict=True)]
        np.testing.assert_array_equal(kernels.range_min(left, first, last), least)
        np.testing.assert_array_equal(kernels.range_min(np.stack([right, left]), first, last)[1], least)
        found = kernels.range_until(left, right, first, last)
        np.testing.assert_array_equal(found, until_by_loops(left, right, first, last))
