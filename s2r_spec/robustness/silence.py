"""Times at which a signal has no valid value, and bounds on ρ there.

Data: for each signal, open intervals (a, b) of time without a valid value: a periodic signal has no message for more
than :data:`s2r_spec.trace.messages.SILENT` periods, has had none yet, or has ended. Model: the margin of a predicate
that reads the signal there is any number, −inf to +inf (:mod:`s2r_spec.robustness.bounds`). A predicate with functions
of the past reads the signal also later, and one with a condition on the future also earlier.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.lang import formula as f
from s2r_spec.robustness.bounds import BoundedAlgebra, RhoBounds
from s2r_spec.robustness.curve import Curve
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.held import HeldAlgebra, signals_of
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.sampled import SampledAlgebra
from s2r_spec.robustness.ticks import Ticks
from s2r_spec.trace.messages import SILENT, period_of_messages

FloatArray = NDArray[np.float64]
Span = tuple[float, float]

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
        variants: one algebra, or several that read the several values with one stamp.
        silences: signal → spans without a valid value, after the start [s].
        unseen: signals without a message before the start, in a log that began before.
        open_steps: whether what is known at samples alone may have any value, instead of an error.
    """

    variants: Sequence[HeldAlgebra]
    silences: Mapping[str, Sequence[Span]]
    unseen: frozenset[str] = frozenset()
    open_steps: bool = False

    def walk(self) -> Walk[RhoBounds[Curve]]:
        """Return the walk that gives bounds on the robustness of a formula."""
        first = self.variants[0]
        algebra = _OpenSteps if self.open_steps else BoundedAlgebra
        return Walk(algebra(first, self._leaf), first.courses.until)

    def _leaf(self, node: f.Comparison | f.Flag) -> RhoBounds[Curve]:
        first = self.variants[0]
        if self.open_steps and first.courses.needs_samples(node):
            return RhoBounds(first.truth(False), first.truth(True))
        lower = upper = self._margin(first, node)
        for other in self.variants[1:]:
            margin = self._margin(other, node)
            lower, upper = first.least(lower, margin), first.greatest(upper, margin)
        unseen = not self.unseen.isdisjoint(signals_of(node))
        if spans := read_spans(node, self.silences):
            lower = _replace(lower, spans, -math.inf, first.snap)
            upper = _replace(upper, spans, math.inf, first.snap)
        return RhoBounds(lower, upper, unseen)

    @staticmethod
    def _margin(algebra: HeldAlgebra, node: f.Comparison | f.Flag) -> Curve:
        return algebra.flag(node) if isinstance(node, f.Flag) else algebra.margin(node)


class _OpenSteps(BoundedAlgebra[Curve]):
    """Bounds where the next and the previous sample may have any value."""

    def step(self, x: RhoBounds[Curve], node: f.AdjacentSample) -> RhoBounds[Curve]:
        """Return any value."""
        return RhoBounds(self.inner.truth(False), self.inner.truth(True))


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


def silences_of(times: FloatArray) -> list[Span]:
    """Return the spans without a sample in (n,) increasing times of a periodic signal [s]."""
    period = period_of_messages(times)
    if math.isnan(period):
        return []
    before = np.flatnonzero(np.diff(times) > SILENT * period)
    return [(float(times[i]), float(times[i + 1])) for i in before]


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
    inner = SampledAlgebra(
        SampledSignals(Ticks(times, samples.clock.snap), {}, samples.params, samples.until)
    )
    base = SampledAlgebra(samples)

    def leaf(node: f.Comparison | f.Flag) -> RhoBounds[FloatArray]:
        margin = base.flag(node) if isinstance(node, f.Flag) else base.margin(node)
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

    return Walk(BoundedAlgebra(inner, leaf), samples.until)
