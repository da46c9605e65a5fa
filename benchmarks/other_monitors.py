"""Other monitors on the formulas of language_speed.py, each called as its own documentation does.

A tool is a function (formula, window [s], x, y) → (prepare, run, profile) or None where it
cannot do that. ``prepare()`` gives fresh inputs, outside of the clock, and
``run(inputs)`` is what is timed; it returns ρ along the trace, or at its start
alone. ``profile`` says which values these are (s2r_spec/robustness/profiles.py).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

PERIOD = 0.01
Run = tuple[Callable[[], Any], Callable[[Any], Any], str]


def nothing() -> None:
    return None


def rtamt_discrete(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Run:
    import rtamt

    text = {
        "a": f"always[0:{1000 * window:.0f}ms](x <= 1)",
        "b": f"always[0:{100_000 * window:.0f}ms](eventually[0:{1000 * window:.0f}ms](x > 0.5))",
        "c": f"(x > 0) until[0:{1000 * window:.0f}ms] (y > 0)",
    }[formula]
    spec = rtamt.StlDiscreteTimeSpecification()
    spec.declare_var("x", "float")
    spec.declare_var("y", "float")
    spec.set_sampling_period(10, "ms", 0.1)
    spec.spec = text
    spec.parse()

    def prepare() -> list[dict[str, list[float]]]:
        time = (np.arange(x.shape[-1]) * PERIOD).tolist()
        pairs = zip(np.atleast_2d(x), np.atleast_2d(y), strict=True)
        return [{"time": time[:], "x": one.tolist(), "y": two.tolist()} for one, two in pairs]

    def run(data: list[dict[str, list[float]]]) -> list[float]:
        found = [spec.evaluate(one) for one in data]
        return [value for _, value in found[0]]

    return prepare, run, "rtamt"


def rtamt_dense(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Run:
    import rtamt

    # in seconds: its dense time takes a bound in ms a thousand times too long
    text = {
        "a": f"always[0:{window:g}](x <= 1)",
        "b": f"always[0:{100 * window:g}](eventually[0:{window:g}](x > 0.5))",
        "c": f"(x > 0) until[0:{window:g}] (y > 0)",
    }[formula]
    spec = rtamt.StlDenseTimeSpecification()
    spec.declare_var("x", "float")
    spec.declare_var("y", "float")
    spec.spec = text
    spec.parse()
    names = {"c": "xy"}.get(formula, "x")

    def prepare() -> list[list[list[Any]]]:
        time = np.arange(x.shape[-1]) * PERIOD
        pairs = zip(np.atleast_2d(x), np.atleast_2d(y), strict=True)
        return [
            [[name, np.stack((time, {"x": one, "y": two}[name]), axis=1).tolist()] for name in names]
            for one, two in pairs
        ]

    def run(data: list[list[list[Any]]]) -> float:
        found = [spec.evaluate(*one) for one in data]
        _, value = found[0][0]
        return value

    return prepare, run, "rtamt-dense"


def tidystl(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Run:
    from tidystl import Signal, parse, robustness

    text = {
        "a": f"G[0,{window}](x <= 1)",
        "b": f"G[0,{100 * window}](F[0,{window}](x > 0.5))",
        "c": f"(x > 0) U[0,{window}] (y > 0)",
    }[formula]
    phi = parse(text)
    signal = Signal.from_dict(np.arange(x.shape[-1]) * PERIOD, {"x": x, "y": y})
    return nothing, lambda _: robustness(phi, signal)[0], "tidystl"


def stlcgpp(formula: str, window: float, x: np.ndarray, y: np.ndarray, backward: bool = False) -> Run:
    import torch
    from stlcgpp.formula import Always, Eventually, Predicate, Until

    first = Predicate("x", lambda signal: signal[..., 0])
    second = Predicate("y", lambda signal: signal[..., 1])
    steps = round(window / PERIOD)
    phi = {
        "a": lambda: Always(first <= 1, interval=[0, steps]),
        "b": lambda: Always(Eventually(first > 0.5, interval=[0, steps]), interval=[0, 100 * steps]),
        "c": lambda: Until(first > 0, second > 0, interval=[0, steps]),
    }[formula]()
    stacked = np.stack((x, y), axis=-1)

    def rho(signal: torch.Tensor) -> torch.Tensor:
        one = partial(phi, padding="last")
        return torch.vmap(one)(signal) if signal.ndim == 3 else one(signal)

    def prepare() -> torch.Tensor:
        return torch.tensor(stacked, dtype=torch.float32, requires_grad=backward)

    def run(signal: torch.Tensor) -> np.ndarray:
        if backward:
            found = rho(signal)
            found[..., 0].sum().backward()
        else:
            with torch.no_grad():
                found = rho(signal)
        return found.detach().numpy() if found.ndim == 1 else found[0].detach().numpy()

    return prepare, run, "stlcgpp"


def stlcgpp_backward(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Run:
    return stlcgpp(formula, window, x, y, backward=True)


def _stlrom(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Any:
    import stlrom

    text = {
        "a": f"alw_[0, {window}] (x[t] <= 1)",
        "b": f"alw_[0, {100 * window}] (ev_[0, {window}] (x[t] > 0.5))",
        "c": f"(x[t] > 0) until_[0, {window}] (y[t] > 0)",
    }[formula]
    driver = stlrom.STLDriver()
    driver.parse_string(f"signal x, y\nphi := {text}\n")
    driver.data = np.stack((np.arange(x.size) * PERIOD, x, y), axis=1).tolist()
    return driver.get_monitor("phi"), float((x.size - 1) * PERIOD)


def stlrom(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Run | None:
    if x.ndim > 1:
        return None
    monitor, end = _stlrom(formula, window, x, y)
    return nothing, lambda _: monitor.eval_rob(0.0, end), "stlrom"


def stlrom_first(formula: str, window: float, x: np.ndarray, y: np.ndarray) -> Run | None:
    if x.ndim > 1:
        return None
    monitor, _ = _stlrom(formula, window, x, y)
    return nothing, lambda _: monitor.eval_rob(0.0), "stlrom"


MONITORS = {
    "rtamt": ("rtamt", rtamt_discrete),
    "rtamt dense": ("rtamt", rtamt_dense),
    "tidystl": ("tidystl", tidystl),
    "stlcgpp": ("stlcgpp", stlcgpp),
    "stlcgpp backward": ("stlcgpp", stlcgpp_backward),
    "stlrom": ("stlrom", stlrom),
    "stlrom, first time only": ("stlrom", stlrom_first),
}
"""What a row of the table is called → the package that it needs, and how it is run."""
