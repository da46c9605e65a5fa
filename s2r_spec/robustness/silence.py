"""Times at which a signal has no valid value, and bounds on ρ there.

Data: for each signal, open intervals (a, b) of time without a valid value: a periodic signal has no message for more
than :data:`s2r_spec.trace.messages.SILENT` periods, has had none yet, or has ended. Model: the margin of a predicate
that reads the signal there is any number, −inf to +inf (:mod:`s2r_spec.robustness.bounds`). A predicate with functions
of the past reads the signal also later, and one with a condition on the future also earlier.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.lang import formula as f
from s2r_spec.robustness.bounds import RhoBounds, bounded_algebra
from s2r_spec.robustness.curve import Curve
from s2r_spec.robustness.evaluate import Algebra, Walk
from s2r_spec.robustness.held import Courses, held_algebra, signals_of
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.sampled import numbers_at, sampled_algebra
from s2r_spec.robustness.ticks import Ticks
from s2r_spec.trace.messages import Span

S = TypeVar("S")

MOST_INSTANTS = 2**20
"""Budget: instants that stand for the silences of sampled signals, 1 million."""


def reach(node: f.Node) -> tuple[float, float]:
    """Return for how long before and after an instant a predicate reads its signals [s], at most."""
    back = ahead = 0.0
    for part in f.walk(node):
        match part:
            case f.Delayed() | f.Accumulated() | f.Count():
                back += part.seconds
            case f.Duration():
                back = math.inf
            case f.Temporal(operator="historically" | "once") | f.Until(operator="since"):
                back += part.interval.high
            case f.Temporal() | f.Until():
                ahead += part.interval.high
    return back, ahead


def at_begin(node: f.Node) -> set[str]:
    """Return the signals whose values at the begin a predicate reads at every instant."""
    parts = [
        part.operand if isinstance(part, f.Initial) else part
        for part in f.walk(node)
        if isinstance(part, f.Initial | f.Overshoot)
    ]
    return {name for part in parts for name in signals_of(part)}


def edge_signals(formula: f.Formula) -> frozenset[str]:
    """Return the signals of which a formula reads an edge: their values at an instant and just before."""
    return frozenset(
        name for part in f.walk(formula) if isinstance(part, f.Edge) for name in signals_of(part)
    )


def read_spans(node: f.Node, silences: Mapping[str, Sequence[Span]]) -> list[Span]:
    """Return the spans at which a predicate reads a signal without a valid value."""
    back, ahead = reach(node)
    if any(start < 0.0 < end for name in at_begin(node) for start, end in silences.get(name, ())):
        return [(-math.inf, math.inf)]
    return [(start - ahead, end + back) for name in signals_of(node) for start, end in silences.get(name, ())]


@dataclass(frozen=True)
class HeldBounds:
    """The bounds of predicates as curves.

    Args:
        variants: the signals once, or several times with each of the several values with one stamp.
        silences: signal → spans without a valid value, after the start [s].
        unseen: signals without a message before the start, in a log that began before.
        open_steps: whether what is known at samples alone may have any value, instead of an error.
    """

    variants: Sequence[Courses]
    silences: Mapping[str, Sequence[Span]]
    unseen: frozenset[str] = frozenset()
    open_steps: bool = False

    @property
    def courses(self) -> Courses:
        """The signals; of several values with one stamp the first one."""
        return self.variants[0]

    def walk(self) -> Walk[RhoBounds[Curve]]:
        """Return the walk that gives bounds on the robustness of a formula."""
        algebras = [held_algebra(one) for one in self.variants]
        first, snap = algebras[0], self.courses.snap
        anything = RhoBounds(first.truth(False), first.truth(True))

        def leaf(node: f.Comparison | f.Flag) -> RhoBounds[Curve]:
            if self.open_steps and self.courses.needs_samples(node):
                return anything
            lower = upper = margin_of(first, node)
            for other in algebras[1:]:
                margin = margin_of(other, node)
                lower, upper = first.least(lower, margin), first.greatest(upper, margin)
            if spans := read_spans(node, self.silences):
                lower = _replace(lower, spans, -math.inf, snap)
                upper = _replace(upper, spans, math.inf, snap)
            return RhoBounds(lower, upper, not self.unseen.isdisjoint(signals_of(node)))

        algebra = bounded_algebra(first, leaf)
        if self.open_steps:
            algebra = replace(algebra, step=lambda x, node: anything)
        return Walk(algebra, self.courses.until)


def margin_of(algebra: Algebra[S], node: f.Comparison | f.Flag) -> S:
    """Return the robustness of a predicate or of a boolean signal."""
    return algebra.flag(node) if isinstance(node, f.Flag) else algebra.margin(node)


def _replace(x: Curve, spans: Iterable[Span], value: float, snap: float) -> Curve:
    """Return a curve with another value within open spans."""
    first, last = x.times[0], x.times[-1]
    ends = np.array([end for span in spans for end in span])
    fine = x.with_breakpoints(ends[(ends > first) & (ends < last)], snap)
    times, at, right, left = fine.times, fine.at, fine.right, fine.left
    middle = (times[:-1] + times[1:]) / 2
    for start, end in spans:
        # A log that begins or ends in a silence has no value at that instant, either.
        inner = (times > start + snap) & (times < end - snap)
        at[inner] = value
        silent = (middle > start) & (middle < end)
        right[silent] = left[silent] = value
    return fine


def bounding_walk(
    samples: SampledSignals, spans: Sequence[Span], period: float
) -> Walk[RhoBounds[FloatArray]]:
    """Return the walk over samples that bounds ρ where all signals have no sample.

    Instants one ``period`` [s] apart stand for each of the silences ``spans`` [s] between two samples, and every
    margin there is any number.
    """
    own = samples.clock.times
    apart = max(period, sum(end - start for start, end in spans) / MOST_INSTANTS)
    silent = np.concatenate([np.arange(start + apart, end - apart / 2, apart) for start, end in spans])
    times = np.union1d(own, silent)
    place = np.searchsorted(times, own)
    inner = SampledSignals(Ticks(times, samples.clock.snap), {}, samples.params, samples.until)
    base = sampled_algebra(numbers_at(samples))

    def leaf(node: f.Comparison | f.Flag) -> RhoBounds[FloatArray]:
        margin = margin_of(base, node)
        lower, upper = np.full(times.size, -np.inf), np.full(times.size, np.inf)
        known = np.ones(own.size, dtype=bool)
        back, ahead = reach(node)
        if back or ahead:
            for start, end in spans:
                known &= (own <= start - ahead) | (own >= end + back)
        if signals_of(node):
            lower[place[known]] = upper[place[known]] = margin[known]
        else:
            lower[:] = upper[:] = margin[0]
        return RhoBounds(lower, upper)

    return Walk(bounded_algebra(sampled_algebra(numbers_at(inner)), leaf), samples.until)
