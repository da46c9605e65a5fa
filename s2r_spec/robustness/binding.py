"""The names that a formula reads, and the substitution of parameters in time bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar, cast

from s2r_spec.base.errors import UsageError
from s2r_spec.lang import formula as f
from s2r_spec.robustness.once import once

N = TypeVar("N", bound=f.Node)


@dataclass(frozen=True)
class Names:
    """Names in a formula: signals, parameters, and the parameters that are time bounds, which ``params`` has, too."""

    signals: frozenset[str]
    params: frozenset[str]
    times: frozenset[str]


@once
def names(formula: f.Formula) -> Names:
    """Return the names that a formula reads."""
    nodes = list(f.walk(formula))
    signals = (node.name for node in nodes if isinstance(node, f.SignalValue | f.Flag))
    params = (node.name for node in nodes if isinstance(node, f.ParamValue))
    within = (node.interval for node in nodes if isinstance(node, f.Temporal | f.Until))
    times = frozenset(end.name for interval in within for end in interval.param_times)
    return Names(frozenset(signals), times.union(params), times)


def bind(formula: f.Formula, params: Mapping[str, float]) -> f.Formula:
    """Return the formula with numbers for the parameters in its time bounds.

    Raises:
        UsageError: with these values an interval is negative or empty.
    """
    if not names(formula).times:
        return formula
    done: dict[int, f.Node] = {}

    def rebuilt(node: N) -> N:
        if id(node) not in done:
            parts: dict[str, Any] = {item.name: part(getattr(node, item.name)) for item in fields(node)}
            done[id(node)] = replace(node, **parts)
        return cast(N, done[id(node)])

    def part(value: object) -> object:
        if isinstance(value, f.Node):
            return rebuilt(value)
        if isinstance(value, f.Interval):
            return _interval(value, params)
        return tuple(map(part, value)) if isinstance(value, tuple) else value

    return rebuilt(formula)


def _interval(interval: f.Interval, params: Mapping[str, float]) -> f.Interval:
    low, high = interval.low, interval.high
    if interval.low_param is not None:
        low = interval.low_param.factor * params[interval.low_param.name]
    if interval.high_param is not None:
        high = interval.high_param.factor * params[interval.high_param.name]
    closed = interval.low_closed and interval.high_closed
    if not 0 <= low <= high or (low == high and not closed):
        values = ", ".join(f"{end.name} = {params[end.name]:g}" for end in interval.param_times)
        raise UsageError(
            f"with {values} the interval `{interval.span.text}` ({interval.span.place}) "
            f"goes from {low:g} s to {high:g} s, so it is empty"
        )
    return replace(interval, low=low, high=high, low_param=None, high_param=None)
