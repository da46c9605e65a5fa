"""The values of a signal that a requirement allows over time: the bands of a plot."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.lang import formula as f
from s2r_spec.robustness.evaluation import Reading
from s2r_spec.robustness.ticks import clock_of

_POINTWISE = (
    f.Comparison, f.Number, f.SignalValue, f.ParamValue, f.Convert, f.Arithmetic, f.Elementary, f.Extremum, f.Norm,
    f.Initial, f.Overshoot,
)  # fmt: skip
"""Nodes that depend only on the present sample and on the trace's first one."""
_CANDIDATES = 2001


@dataclass(frozen=True)
class Tube:
    """A predicate that must hold throughout a time window, as bands of values of its one signal.

    Args:
        signal: name of the signal, with its index if it is a vector ("u[0]").
        predicate: the text of the predicate.
        start: the start of the window [s], inclusive.
        end: the end of the window [s], at most the trace's last time.
        bands: (from, to) of the allowed values, in the signal's unit; ±inf where a band is unbounded.
    """

    signal: str
    predicate: str
    start: float
    end: float
    bands: tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class Tolerances:
    """The signals that a requirement reads, in its units, with their allowed values.

    Args:
        times: (n,) [s].
        signals: label → (n,) samples.
        units: label → unit.
        levels: label → parameters in the same unit that a predicate compares with the signal.
        tubes: the tolerance tubes of the predicates that must hold throughout a window and look at one signal.
    """

    times: FloatArray
    signals: Mapping[str, FloatArray]
    units: Mapping[str, str]
    levels: Mapping[str, Mapping[str, float]]
    tubes: tuple[Tube, ...]


def tolerances(formula: f.Formula, reading: Reading) -> Tolerances:
    """Return the values of the signals that a formula allows, evaluated at the first sample."""
    formula = reading.bound(formula)
    signals: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    levels: dict[str, dict[str, float]] = {}
    for used in (node for node in f.walk(formula) if isinstance(node, f.SignalValue)):
        for row in range(len(reading.signals[used.name])):
            if used.index in (None, row):
                label = _label(used, row, reading)
                signals[label] = reading.signals[used.name][row]
                units[label] = _unit(used)
                levels.setdefault(label, {})
    tubes = []
    for predicate, start, end in _required_predicates(formula, 0.0, 0.0):
        nodes = list(f.walk(predicate))
        read = {(node.name, node.index) for node in nodes if isinstance(node, f.SignalValue)}
        if len(read) != 1 or not all(isinstance(node, _POINTWISE) for node in nodes):
            continue
        signal = next(node for node in nodes if isinstance(node, f.SignalValue))
        if signal.index is None and len(reading.signals[signal.name]) > 1:
            continue
        label = _label(signal, signal.index or 0, reading)
        for node in nodes:
            if isinstance(node, f.ParamValue) and _unit(node) == units[label]:
                levels[label][node.name] = float(reading.params[node.name].item())
        first, last = float(reading.times[0]), float(reading.times[-1])
        if first + start > last:
            continue  # the rollout ended before
        text, bands = " ".join(predicate.span.text.split()), _bands(predicate, signal, reading, levels[label])
        tubes.append(Tube(label, text, first + start, min(first + end, last), bands))
    return Tolerances(reading.times, signals, units, levels, tuple(tubes))


def _required_predicates(
    formula: f.Formula, start: float, end: float
) -> Iterator[tuple[f.Comparison, float, float]]:
    """Yield the predicates that must hold at all times of a window, relative to the first sample [s].

    Below a disjunction, a negation or an eventually no single predicate must hold.
    """
    match formula:
        case f.Comparison():
            yield formula, start, end
        case f.Named() | f.Rescale():
            yield from _required_predicates(formula.operand, start, end)
        case f.Junction(operator="and"):
            for operand in formula.operands:
                yield from _required_predicates(operand, start, end)
        case f.Temporal(operator="always", interval=interval):
            yield from _required_predicates(formula.operand, start + interval.low, end + interval.high)
        case _:
            return


def _bands(
    predicate: f.Comparison, signal: f.SignalValue, reading: Reading, levels: Mapping[str, float]
) -> tuple[tuple[float, float], ...]:
    """Return the values of a signal at which a predicate holds, by evaluation at many trial values.

    The recorded first sample is kept, for functions that depend on it.
    """
    row = signal.index or 0
    recorded = reading.signals[signal.name]
    centre, reach = _reach([*recorded[row].tolist(), *levels.values()])
    values = np.linspace(centre - reach, centre + reach, _CANDIDATES)
    trial = np.repeat(recorded[:, :1], _CANDIDATES + 1, axis=1)
    trial[row, 1:] = values
    times = np.arange(_CANDIDATES + 1.0)
    margins = Reading(times, {signal.name: trial}, reading.params, "samples", "open", clock_of(times)).signed(
        predicate
    )
    holds = np.concatenate(([False], margins[1:] > 0.0, [False]))
    edges = np.flatnonzero(np.diff(holds))
    begins, ends = [-math.inf, *values[1:].tolist()], [*values[:-1].tolist(), math.inf]
    return tuple((begins[start], ends[stop - 1]) for start, stop in zip(edges[::2], edges[1::2], strict=True))


def _reach(values: list[float]) -> tuple[float, float]:
    """Return the centre and the half width of the values to try: three times the range of the plotted values."""
    low, high = min(values), max(values)
    return (low + high) / 2, 1.5 * max(high - low, 0.1 * abs(high), 1e-3)


def _label(node: f.SignalValue, row: int, reading: Reading) -> str:
    return node.name if len(reading.signals[node.name]) == 1 else f"{node.name}[{row}]"


def _unit(node: f.Value) -> str:
    return "" if node.unit is None else node.unit.text
