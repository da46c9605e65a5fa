"""Two traces of one test, made comparable: the same samples on both sides, and what that leaves out.

The rule: time counts from each trace's first sample. Both are cut where the shorter
one ends, because after a fall a trace says nothing. Where sample times differ, the
simulated trace is read at the real one's. What ρ loses by the cut and by the
reading is kept as numbers of their own, so that nothing of Δρ is lost.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.lang import formula as f
from s2r_spec.robustness.binding import bound, names
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.reading import read_params, read_signals
from s2r_spec.robustness.sampled import SampledAlgebra, Samples
from s2r_spec.robustness.ticks import Ticks, clock_of
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

SAME = 1e-6
"""[s] Sample times closer than this are the same."""


class Evaluated:
    """Formulas and numbers on some signals: each is evaluated once."""

    def __init__(self, samples: Samples) -> None:
        self.samples = samples
        algebra = SampledAlgebra(samples)
        self.numbers = algebra.numbers
        self.walk = Walk(algebra, samples.until)


@dataclass(frozen=True, eq=False)
class Aligned:
    """Two traces of one test on common samples, as a formula reads them.

    Args:
        formula: the requirement, time bounds with their values.
        times: (n,) of the real trace [s].
        clock: of these times.
        params: name → (1, 1).
        simulated: signal → (width, n), in the spec's units.
        real: likewise.
        flags: the signals that are booleans.
        delta: Δρ = ρ_real − ρ_sim of the whole traces; a fall has the ρ that the spec declares.
        ended: the part of Δρ that the samples kept do not show: what came after the cut, or the fall.
        reason: what ended the shorter trace; "" if nothing was cut off.
    """

    formula: f.Formula
    times: FloatArray
    clock: Grid | Ticks
    params: Mapping[str, FloatArray]
    simulated: Mapping[str, FloatArray]
    real: Mapping[str, FloatArray]
    flags: frozenset[str]
    delta: float
    ended: float
    reason: str

    def algebra(self, signals: Mapping[str, FloatArray]) -> Evaluated:
        """Return what evaluates formulas and numbers on some signals of these times."""
        return Evaluated(Samples(self.clock, signals, self.params))

    def rho(self, signals: Mapping[str, FloatArray]) -> float:
        """Return ρ of signals on these times, windows cut at the end."""
        return float(np.broadcast_to(self.algebra(signals).walk(self.formula), self.times.shape)[0])


def align(
    spec: Spec, requirement: str, real: Trace, simulated: Trace, params: Mapping[str, float]
) -> Aligned:
    """Return two traces of one test on common samples.

    Raises:
        TraceError: a channel is missing, or does not fit the spec.
        UsageError: a parameter is missing, or a trace fell and the spec declares no ρ for that.
    """
    whole = [
        spec.robustness(trace, params, partial=True, only=requirement)[requirement]
        for trace in (simulated, real)
    ]
    numbers = read_params(spec.params, names(spec.formulas[requirement]).params, params)
    declared = [spec.signals[name] for name in spec.channels(requirement)]
    last = min(trace.duration for trace in (simulated, real))
    times = (real.times - real.times[0])[real.times - real.times[0] <= last + SAME]
    flags = frozenset(signal.name for signal in declared if signal.boolean)
    own, other = (
        {
            name: _at(times, trace.times - trace.times[0], samples, name in flags)
            for name, samples in read_signals(declared, trace).items()
        }
        for trace in (real, simulated)
    )
    formula = bound(
        spec.formulas[requirement], {name: float(value.item()) for name, value in numbers.items()}
    )
    aligned = Aligned(
        formula,
        real.times[: times.size],
        clock_of(times),
        numbers,
        other,
        own,
        flags,
        whole[1] - whole[0],
        0.0,
        "",
    )
    shown = aligned.rho(own) - aligned.rho(other)
    ended = aligned.delta - shown if np.isfinite(shown) else aligned.delta
    return Aligned(**(vars(aligned) | {"ended": ended, "reason": _reason(real, simulated, last)}))


def _at(times: FloatArray, own: FloatArray, samples: FloatArray, held: bool) -> FloatArray:
    """Return (width, n) samples at other times: straight lines between them, or the last one."""
    if own.size >= times.size and np.abs(own[: times.size] - times).max() <= SAME:
        return samples[:, : times.size]
    if held:
        return samples[:, np.maximum(np.searchsorted(own, times + SAME, "right") - 1, 0)]
    return np.array([np.interp(times, own, row) for row in samples])


def _reason(real: Trace, simulated: Trace, last: float) -> str:
    """Return what ended the shorter trace, in words."""
    both = (("real", real), ("simulated", simulated))
    for side, trace in sorted(both, key=lambda each: each[1].duration):
        if trace.failure is not None:
            return f"the {side} rollout ended with {trace.failure!r} at {trace.duration:g} s"
    if abs(real.duration - simulated.duration) > SAME:
        side = "real" if real.duration < simulated.duration else "simulated"
        return f"the {side} trace ends at {last:g} s, before the other one"
    return ""
