"""Robustness on torch tensors: the same numbers, with gradients.

On a regular grid, as in :mod:`s2r_spec.robustness.sampled`: numbers are
(…, width, n), conditions (…, n), any batch axes first. The gradient is an exact
sub-gradient (:mod:`s2r_spec.robustness.tensor_windows`); with a temperature it
is the gradient of the smooth minimum (:mod:`s2r_spec.robustness.smooth`).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from s2r_spec.base.errors import UsageError, one_of
from s2r_spec.lang import formula as f
from s2r_spec.lang.declarations import Param, Signal
from s2r_spec.robustness.binding import names
from s2r_spec.robustness.evaluate import Algebra, Walk, Witness
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.narrow import narrowest, refuse_short
from s2r_spec.robustness.numbers import MARGIN
from s2r_spec.robustness.smooth import Smooth, shift
from s2r_spec.robustness.tensor_values import TensorValues

if TYPE_CHECKING:
    from torch import Tensor

_INF = float("inf")
Window = Callable[["Tensor", int, "int | None"], "Tensor"]


def read_tensors(channels: Iterable[Signal], signals: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return name → (…, width, n) of every channel.

    Raises:
        UsageError: a channel has no signal, or there is no channel.
    """
    read: dict[str, Tensor] = {}
    for channel in channels:
        if channel.name not in signals:
            raise UsageError(f"there is no signal {channel.name!r}; the signals are {one_of(signals)}")
        tensor = signals[channel.name]
        read[channel.name] = tensor if channel.vector else tensor.unsqueeze(-2)
    if not read:
        raise UsageError("this requirement reads no signal, so there is nothing to differentiate")
    return read


def read_numbers(
    formula: f.Formula, declared: Mapping[str, Param], values: Mapping[str, Tensor], like: Tensor
) -> dict[str, Tensor]:
    """Return name → (…, 1, 1) of the parameters that a formula reads, of the type and on the device of ``like``.

    Raises:
        UsageError: a time bound is a parameter, or a parameter has no value.
    """
    import torch

    if names(formula).times:
        raise UsageError("a time bound that is a parameter has no gradient; make it a constant")
    numbers: dict[str, Tensor] = {}
    for name in names(formula).params:
        number = values.get(name, declared[name].default)
        if number is None:
            raise UsageError(f"the parameter {name!r} has no value: give params={{{name!r}: …}}")
        numbers[name] = torch.as_tensor(number, dtype=like.dtype, device=like.device)[..., None, None]
    return numbers


def evaluate_tensors(
    formula: f.Formula,
    signals: Mapping[str, Tensor],
    params: Mapping[str, Tensor],
    period: float,
    until: Witness,
    temperature: float,
) -> Tensor:
    """Return (…, n): ρ of a formula; see :meth:`s2r_spec.spec.Spec.robustness_tensor`.

    ``signals`` and ``params`` come from :func:`read_tensors` and :func:`read_numbers`.

    Raises:
        UsageError: a window is shorter than the period.
    """
    samples = next(iter(signals.values())).shape[-1]
    grid = Grid(samples, Fraction(period).limit_denominator(10**9))
    refuse_short(narrowest(formula), grid.step)
    return Walk(tensor_algebra(grid, signals, params, temperature), until)(formula)


def tensor_algebra(
    grid: Grid, signals: Mapping[str, Tensor], params: Mapping[str, Tensor], temperature: float
) -> Algebra[Tensor]:
    """Return the operations on robustness signals as tensors (…, n)."""
    import torch

    from s2r_spec.robustness import tensor_windows

    # both have least, window_min, window_max and until
    windows: Any = Smooth(temperature) if temperature else tensor_windows
    value, count = TensorValues(signals, params), grid.count

    def truth(holds: bool) -> Tensor:
        return value.like.new_full((count,), _INF if holds else -_INF)

    def margin(node: f.Comparison) -> Tensor:
        """Return (…, n): the margin of the comparison; NaN where it is undefined."""
        result: Tensor = MARGIN[node.operator](value(node.left)[..., 0, :], value(node.right)[..., 0, :])
        return result.expand(*result.shape[:-1], count)

    def over(window: Window) -> Callable[[Tensor, f.Interval, bool], Tensor]:
        def windowed(x: Tensor, interval: f.Interval, past: bool) -> Tensor:
            low, high = grid.window(interval)
            x = x.expand(*x.shape[:-1], count)
            return window(x.flip(-1), low, high).flip(-1) if past else window(x, low, high)

        return windowed

    def until(left: Tensor, right: Tensor, interval: f.Interval, past: bool) -> Tensor:
        low, high = grid.window(interval)
        shape = np.broadcast_shapes(left.shape, right.shape, (count,))
        left, right = left.expand(shape), right.expand(shape)
        if past:
            return witnessed(left.flip(-1), right.flip(-1), low, high).flip(-1)
        return witnessed(left, right, low, high)

    def witnessed(left: Tensor, right: Tensor, low: int, high: int | None) -> Tensor:
        rest: Tensor = windows.until(left, right, None if high is None else high - low)
        if low:
            rest = windows.least(windows.window_min(left, 0, low - 1), shift(rest, low, -_INF))
        return rest

    def step(x: Tensor, node: f.AdjacentSample) -> Tensor:
        x = x.expand(*x.shape[:-1], count)
        return shift(x, 1, -_INF) if node.operator == "next" else shift(x.flip(-1), 1, -_INF).flip(-1)

    def edge(now: Tensor, before: Tensor, earlier: float) -> Tensor:
        now, before = (x.expand(*x.shape[:-1], count) for x in (now, before))
        result: Tensor = windows.least(now, -shift(before.flip(-1), 1, earlier).flip(-1))
        return result

    return Algebra(
        truth=truth,
        flag=lambda node: torch.where(value.signals[node.name][..., 0, :] > 0, truth(True), truth(False)),
        margin=margin,
        negative=operator.neg,
        scale=lambda x, factor: factor * x,
        least=windows.least,
        greatest=lambda x, y: -windows.least(-x, -y),
        always=over(windows.window_min),
        eventually=over(windows.window_max),
        until=until,
        step=step,
        edge=edge,
    )
