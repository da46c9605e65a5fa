"""The values of a signal that a requirement allows at each time, for pictures of a trace."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.lang import formula as f
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

_MOST_SAMPLES = 240


@dataclass(frozen=True)
class Component:
    """A scalar channel (its index is None), or one component of a vector channel, counted from 0."""

    channel: str
    index: int | None = None

    @classmethod
    def of_label(cls, label: str) -> Component:
        """Return the component of a label such as ``u[1]``, or the scalar channel ``x``."""
        channel, _, index = label.partition("[")
        return cls(channel, int(index[:-1]) if index else None)

    @property
    def label(self) -> str:
        """The name, with the index of a component: ``u[1]``."""
        return self.channel if self.index is None else f"{self.channel}[{self.index}]"

    def samples(self, trace: Trace) -> FloatArray:
        """Return (n,): its samples in a trace."""
        return trace[self.channel] if self.index is None else trace[self.channel][:, self.index]


@dataclass(frozen=True)
class HeldPredicate:
    """A predicate that must hold from ``start`` to ``end`` [s] after the trace's first time."""

    predicate: f.Comparison
    start: float
    end: float


@dataclass(frozen=True)
class Margins:
    """How far a predicate would be from failing if a signal had other values.

    Attributes:
        times: (n,) [s].
        values: (m,) of the signal.
        margins: (m, n), negative where the predicate would fail.
    """

    times: FloatArray
    values: FloatArray
    margins: FloatArray


def held_predicates(formula: f.Formula, start: float = 0.0, end: float = 0.0) -> Iterator[HeldPredicate]:
    """Yield the predicates that must hold throughout; those below an or, a not or an until need not."""
    match formula:
        case f.Comparison():
            yield HeldPredicate(formula, start, end)
        case f.Named() | f.Rescale():
            yield from held_predicates(formula.operand, start, end)
        case f.Junction(operator="and"):
            for operand in formula.operands:
                yield from held_predicates(operand, start, end)
        case f.Temporal(operator="always"):
            yield from held_predicates(
                formula.operand, start + formula.interval.low, end + formula.interval.high
            )


def reads(predicate: f.Comparison, component: Component) -> bool:
    """Return whether a predicate reads a component at the present instant."""
    nodes = list(f.walk(predicate))
    if any(isinstance(node, f.Initial) for node in nodes):
        return False  # one value cannot stand for the first sample and for the present one
    return any(
        isinstance(node, f.SignalValue)
        and node.name == component.channel
        and node.index in (None, component.index)
        for node in nodes
    )


def margins(
    spec: Spec,
    trace: Trace,
    params: Mapping[str, float],
    must: HeldPredicate,
    component: Component,
    values: FloatArray,
    around: FloatArray | None = None,
) -> Margins | None:
    """Return a predicate's margins for other values of a component; None if the trace ends before its window.

    With ``around`` (samples of the trace,) the values are differences from these.
    """
    begin = trace.times[0]
    inside = np.flatnonzero((trace.times >= begin + must.start) & (trace.times <= begin + must.end))
    if inside.size < 2:
        return None
    chosen = inside[np.unique(np.linspace(0, inside.size - 1, _MOST_SAMPLES).astype(int))]
    # The first sample stays: overshoot takes its direction from it.
    kept = np.union1d([0], chosen)
    alone = replace(spec, formulas={"predicate": must.predicate}, certify={})
    middle = np.zeros(len(kept)) if around is None else around[kept]
    rows = [
        alone.robustness_signal(_with_values(trace, kept, component, middle + value), "predicate", params)
        for value in values
    ]
    return Margins(trace.times[chosen], values, np.array(rows)[:, np.isin(kept, chosen)])


def _with_values(trace: Trace, kept: NDArray[np.intp], component: Component, value: FloatArray) -> Trace:
    channels = {name: np.array(samples[kept]) for name, samples in trace.channels.items()}
    if component.index is None:
        channels[component.channel][:] = value
    else:
        channels[component.channel][:, component.index] = value
    return Trace(trace.times[kept], channels, trace.units, trace.meta)
