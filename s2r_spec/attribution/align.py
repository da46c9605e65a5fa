"""Two traces of one test on common samples.

Time counts from the first sample of each trace. Both traces end where the shorter one ends, because a trace says
nothing after a fall. If sample times differ, the simulated trace is read at the times of the real one. The part of Δρ
that the cut and the reading remove is kept as ``ended``, so that the parts still add up to Δρ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.attribution.place import instant
from s2r_spec.base.arrays import FloatArray
from s2r_spec.lang import formula as f
from s2r_spec.robustness.binding import bind, names
from s2r_spec.robustness.evaluate import Walk
from s2r_spec.robustness.grid import Grid
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.reading import read_params, read_signals
from s2r_spec.robustness.sampled import numbers_at, sampled_algebra
from s2r_spec.robustness.ticks import Ticks, clock_of
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

SAME = 1e-6
"""Tolerance [s]: sample times closer than this are the same."""


class Evaluated:
    """Formulas and numbers on given signals; each is evaluated once."""

    def __init__(self, samples: SampledSignals) -> None:
        self.numbers = numbers_at(samples)
        self.walk = Walk(sampled_algebra(self.numbers), samples.until)


@dataclass(frozen=True, eq=False)
class Aligned:
    """Two traces of one test on common samples.

    Args:
        formula: the requirement, with numbers as time bounds.
        times: (n,) sample times of the real trace [s].
        clock: the sample times as the evaluation of formulas needs them.
        params: name → (1, 1) value of the test.
        simulated: signal → (width, n) samples, in the spec's units.
        real: the same of the real trace.
        flags: names of the boolean signals.
        delta: Δρ = ρ_real − ρ_sim of the whole traces; a fall has the ρ that the spec declares.
        ended: the part of Δρ that is not in the common samples: a fall, or samples after the cut.
        reason: what ended the shorter trace; "" if both end together.
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
        """Return an evaluation of formulas and numbers on signals at these times."""
        return Evaluated(SampledSignals(self.clock, signals, self.params))

    def rho(self, signals: Mapping[str, FloatArray]) -> float:
        """Return ρ of signals at these times; windows end with the last sample."""
        return float(np.broadcast_to(self.algebra(signals).walk(self.formula), self.times.shape)[0])


def align(
    spec: Spec, requirement: str, real: Trace, simulated: Trace, params: Mapping[str, float]
) -> Aligned:
    """Return two traces of one test on common samples.

    Raises:
        TraceError: a channel is missing, or does not fit the spec.
        UsageError: a parameter is missing, or a trace fell and the spec declares no ρ for that.
    """
    simulated_rho, real_rho = (
        spec.robustness(trace, params, partial=True, only=requirement)[requirement]
        for trace in (simulated, real)
    )
    numbers = read_params(spec.params, names(spec.formulas[requirement]).params, params)
    declared = [spec.signals[name] for name in spec.channels(requirement)]
    last = min(trace.duration for trace in (simulated, real))
    times = (real.times - real.times[0])[real.times - real.times[0] <= last + SAME]
    flags = frozenset(signal.name for signal in declared if signal.boolean)

    def at_times(trace: Trace) -> dict[str, FloatArray]:
        own, signals = trace.times - trace.times[0], read_signals(trace, tuple(declared), "error")
        return {name: _at(times, own, samples, name in flags) for name, samples in signals.items()}

    real_signals = at_times(real)
    pair = Aligned(
        formula=bind(spec.formulas[requirement], {name: value.item() for name, value in numbers.items()}),
        times=real.times[: times.size],
        clock=clock_of(times),
        params=numbers,
        simulated=at_times(simulated),
        real=real_signals,
        flags=flags,
        delta=real_rho - simulated_rho,
        ended=0.0,
        reason=_reason(real, simulated, last),
    )
    shown = pair.rho(pair.real) - pair.rho(pair.simulated)
    return replace(pair, ended=pair.delta - shown if np.isfinite(shown) else pair.delta)


def _at(times: FloatArray, own: FloatArray, samples: FloatArray, held: bool) -> FloatArray:
    """Return (width, n) samples at other times: on straight lines between samples, or the last sample if ``held``."""
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
            return f"the {side} rollout ended with {trace.failure!r} {instant(trace.duration)}"
    if abs(real.duration - simulated.duration) > SAME:
        side = "real" if real.duration < simulated.duration else "simulated"
        return f"the {side} trace ends {instant(last)}, before the other one"
    return ""
