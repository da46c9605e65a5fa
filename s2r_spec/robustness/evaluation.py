"""Evaluation of one requirement on one trace: settings and result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from s2r_spec.base.arrays import BoolArray, FloatArray
from s2r_spec.base.errors import TraceError, UsageError
from s2r_spec.lang import formula as f
from s2r_spec.robustness.binding import bind
from s2r_spec.robustness.deciding import descend
from s2r_spec.robustness.evaluate import Walk, Witness
from s2r_spec.robustness.first_sample import rho_at_first_sample
from s2r_spec.robustness.grid import SNAP, Grid
from s2r_spec.robustness.horizon import horizon, samples_needed, seconds_needed
from s2r_spec.robustness.narrow import narrowest, refuse_short
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.sampled import walk_samples
from s2r_spec.robustness.ticks import Clock, Ticks
from s2r_spec.robustness.ties import restore_zeros
from s2r_spec.trace.instants import instant
from s2r_spec.trace.messages import Span, silences_of

Interpolation = Literal["samples", "hold", "linear"]
End = Literal["clip", "hold", "nan", "error"]
MOST_HELD = 10_000_000
"""Budget: samples that ``end="hold"`` may add."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """ρ of one requirement along a trace, and the samples at which the trace is long enough to decide it.

    Args:
        requirement: the name of the requirement.
        unit: the unit of ρ; "" for none, "mixed" for margins that do not compare.
        times: (n,) sample times of the trace [s].
        values: (n,) ρ at each sample.
        truth: (n,) whether the requirement is true at each sample (Boolean semantics): the sign of ρ, and at
            ρ = 0 the comparisons. False where ρ is NaN.
        horizon: time after an instant that the requirement looks ahead [s]; inf for the whole rest.
        complete: (n,) whether the trace reaches the horizon of each sample, to within one median period.
        jitter: greatest distance of a sample from the regular grid, in periods; None if there is no grid.
        period: median time from one sample to the next [s]; None for a single sample.
        narrowest: least number of samples in the shortest window of positive length that lies within the trace;
            None if there is none.
        notes: one sentence for each window whose ends lie between samples.
    """

    requirement: str
    unit: str
    times: FloatArray = field(repr=False)
    values: FloatArray = field(repr=False)
    truth: BoolArray = field(repr=False)
    horizon: float
    complete: BoolArray = field(repr=False)
    jitter: float | None
    period: float | None
    narrowest: int | None = field(repr=False)
    notes: tuple[str, ...]

    @property
    def value(self) -> float:
        """ρ at the trace's first time."""
        return float(self.values[0])

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.times[-1] - self.times[0])

    @property
    def satisfied(self) -> bool:
        """Whether the requirement is true at the trace's first time."""
        return bool(self.truth[0])

    @property
    def complete_until(self) -> float | None:
        """The last sample time [s] at which the trace decides ρ; None if there is none."""
        return float(self.times[self.complete][-1]) if self.complete.any() else None

    @property
    def undefined(self) -> BoolArray:
        """(n,) whether ρ is infinite because a window lies wholly past the end."""
        return np.isinf(self.values) & ~self.complete


@dataclass(frozen=True)
class Reading:
    """Samples and parameters of a trace, with the settings for the evaluation of formulas.

    Args:
        times: (n,) increasing times [s].
        signals: name → (width, n), in the declared unit, free of NaN.
        params: name → (1, 1), in the declared unit.
        interpolation: see :meth:`s2r_spec.spec.Spec.evaluate`.
        until: see :class:`s2r_spec.robustness.evaluate.Walk`.
        clock: the regular grid of the times, or the times themselves (:func:`clock_of`).
    """

    times: FloatArray
    signals: Mapping[str, FloatArray]
    params: Mapping[str, FloatArray]
    interpolation: Interpolation
    until: Witness
    clock: Clock

    @property
    def grid(self) -> Grid | None:
        """The regular grid on which windows count samples; None if they are measured in time."""
        return self.clock if self.interpolation == "samples" and isinstance(self.clock, Grid) else None

    @cached_property
    def period(self) -> float | None:
        """Median time from one sample to the next [s]; None for a single sample."""
        if len(self.times) == 1:
            return None
        return self.clock.step if isinstance(self.clock, Grid) else float(np.median(np.diff(self.times)))

    @cached_property
    def snap(self) -> float:
        """Times closer than this are the same up to rounding [s]."""
        span = float(self.times[-1] - self.times[0])
        return 1e-12 * span + 8 * float(np.finfo(np.float64).eps) * float(np.abs(self.times).max())

    def bound(self, formula: f.Formula) -> f.Formula:
        """Return the formula with numbers for the parameters in its time bounds."""
        return bind(formula, {name: float(value.item()) for name, value in self.params.items()})

    @property
    def samples(self) -> SampledSignals:
        """The same at the samples alone."""
        return SampledSignals(self.clock, self.signals, self.params, self.until)

    def walk(self) -> Walk[Any]:
        """Return a walk over samples or curves."""
        if self.interpolation == "samples":
            return walk_samples(self.samples)
        # here, since most traces need only samples
        from s2r_spec.robustness.dense import ContinuousSignals, curve_algebra

        samples = replace(self.samples, clock=Ticks.of(self.times))
        return Walk(curve_algebra(ContinuousSignals(samples, self.interpolation, self.snap)), self.until)

    def signed(self, formula: f.Formula) -> FloatArray:
        """Return (n,): ρ at every sample, never 0: its sign is the verdict (:mod:`s2r_spec.robustness.ties`)."""
        rho = self.walk()(formula)
        if self.interpolation == "samples":
            return np.asarray(rho)
        values: FloatArray = rho.values(self.times - self.times[0], self.snap)
        return values

    def at_first_sample(self, formula: f.Formula) -> float:
        """Return ρ at the first sample, never 0."""
        if self.interpolation == "samples":
            return rho_at_first_sample(formula, self.samples)
        return float(self.signed(formula)[0])

    @cached_property
    def silences(self) -> list[Span]:
        """Spans between two samples that last more than a few periods, after the first sample [s]."""
        if self.interpolation != "samples" or not isinstance(self.clock, Ticks):
            return []
        return silences_of(self.clock.times)

    def bounds(self, formula: f.Formula) -> tuple[float, float] | None:
        """Return the bounds of ρ at the first sample where the samples are silent for a while; None if they are not."""
        if not self.silences:
            return None
        from s2r_spec.robustness.silence import bounding_walk

        bounds = bounding_walk(self.samples, self.silences, self.period or 0.0)(formula)
        return float(bounds.lower[0]), float(bounds.upper[0])

    def refuse_short(self, formula: f.Formula) -> None:
        """Raise SamplingError if conditions are evaluated at the samples, and a window is shorter than the period."""
        if self.interpolation == "samples":
            refuse_short(narrowest(formula), self.period)

    def narrowest(self, formula: f.Formula) -> int | None:
        """Return the least number of samples in the shortest window of positive length within the trace."""
        if (window := narrowest(formula)) is None:
            return None
        clock = self.clock if self.interpolation == "samples" else Ticks.of(self.times)
        return clock.fewest(window.interval, window.past)

    def needs(self, formula: f.Formula) -> float:
        """Return the time after an instant that a trace must last to decide a formula there [s]."""
        return seconds_needed(formula, self.period or 0.0, 0.0)

    def complete(self, formula: f.Formula) -> BoolArray:
        """Return (n,): whether the trace reaches the formula's horizon from each sample, to within one median period.

        A further sample would lie past the horizon. In continuous time the last sample itself must reach it.
        """
        n = self.times.size
        if self.period is None:
            return np.full(n, horizon(formula) == 0.0 and samples_needed(formula, None) == 0)
        if self.interpolation != "samples":
            return np.asarray(self.times + self.needs(formula) <= self.times[-1] + self.snap)
        at, snap = self.clock.times, max(self.clock.snap, SNAP * self.period)
        needs = seconds_needed(formula, self.period, 2 * snap)
        return np.asarray(at + needs <= at[-1] + self.period - snap)

    def complete_at_first_sample(self, formula: f.Formula) -> bool:
        """Return the first value of :meth:`complete`."""
        if self.period is None or self.interpolation != "samples" or not isinstance(self.clock, Grid):
            return bool(self.complete(formula)[0])
        snap = max(self.clock.snap, SNAP * self.period)
        needs = seconds_needed(formula, self.period, 2 * snap)
        last = float(np.float64(self.clock.count - 1) * self.clock.step)
        return needs <= last + self.period - snap

    def notes(self, formula: f.Formula) -> tuple[str, ...]:
        """Return a sentence for each end of a window that lies between two samples of the grid."""
        if self.grid is None:
            return ()
        sentences: dict[str, None] = {}
        within = (node.interval for node in f.walk(formula) if isinstance(node, f.Temporal | f.Until))
        for end, span in ((end, one.span) for one in within for end in (one.low, one.high)):
            if self.grid.between(end):
                sentences[
                    f"{end:g} s in `{' '.join(span.text.split())}` ({span.place}) lies between two samples: "
                    f"the window has the samples inside it, {self.grid.step:.6g} s apart"
                ] = None
        return tuple(sentences)

    def held(self, formula: f.Formula) -> Reading:
        """Return a reading extended by the formula's horizon; each signal holds its last sample.

        Raises:
            UsageError: the samples do not lie on a regular grid, or too many would be added.
        """
        needed, last, clock = self.needs(formula), self.times[-1], self.clock
        if self.interpolation == "samples" and not self.grid:
            raise UsageError(
                "end='hold' adds samples, but these times have no regular period; "
                "use it with interpolation='hold' or 'linear'"
            )
        if self.grid:
            count = samples_needed(formula, self.grid.period)
            if count > MOST_HELD:
                raise UsageError(
                    f"end='hold' would add {count:.0e} samples, for a requirement that looks {needed:g} s ahead; "
                    f"use it with interpolation='hold', which adds one"
                )
            clock = replace(self.grid, count=self.grid.count + count)
            more = last + np.array([clock.seconds(k) for k in range(1, clock.count - len(self.times) + 1)])
        else:
            more = np.array([last + needed] if needed > 0 else [])
        signals = {
            name: np.pad(samples, ((0, 0), (0, more.size)), mode="edge")
            for name, samples in self.signals.items()
        }
        return replace(self, times=np.concatenate((self.times, more)), signals=signals, clock=clock)

    def evaluate(self, formula: f.Formula, requirement: str, unit: str, end: End) -> Evaluation:
        """Evaluate one requirement; for ``end`` see :meth:`s2r_spec.spec.Spec.evaluate`."""
        n = self.times.size
        complete = self.complete(formula)
        if end == "error" and not complete.all():
            first = int(np.argmin(complete))
            raise TraceError(
                f"{requirement!r} at t = {instant(self.times, float(self.times[first]))} looks "
                f"{self.needs(formula):g} s ahead, past the end of the trace at "
                f"{instant(self.times, float(self.times[-1]))}"
            )
        rho = (self.held(formula) if end == "hold" else self).signed(formula)[:n]
        if end == "nan":
            rho = np.where(complete, rho, np.nan)
        return Evaluation(
            requirement=requirement,
            unit=unit,
            times=self.times,
            values=restore_zeros(rho),
            truth=rho > 0,
            horizon=horizon(formula),
            complete=complete,
            jitter=self.clock.jitter if isinstance(self.clock, Grid) else None,
            period=self.period,
            narrowest=self.narrowest(formula),
            notes=self.notes(formula),
        )

    def shortfall(self, formula: f.Formula) -> str:
        """Return the end of a sentence on a requirement that the trace does not decide: "looks 2 s ahead, but …".

        The instant in it would decide ρ if windows were cut at the end of the trace.
        """
        ahead, times = horizon(formula), self.times - self.times[0]
        length = f"the trace lasts {times[-1]:.6g} s" if times.size > 1 else "the trace has one sample"
        if 0 < ahead < math.inf:
            return f"looks {ahead:g} s ahead, but {length}"
        if ahead == 0:
            return f"looks at the next sample, but {length}"
        if times.size == 1:
            return f"looks at the whole rest of a trace, but {length}"
        walk = walk_samples(self.samples)
        walk(formula)
        reach, at = self.needs(formula), 0.0
        for step in descend(formula, walk, self.clock):
            needs, time = self.needs(step.node), float(self.times[step.sample])
            if needs > 0 and time + needs > self.times[-1]:
                reach, at = needs, time - float(self.times[0])
        return f"looks {reach:g} s past t = {at:.6g} s, but the trace ends at {float(times[-1]):.6g} s"
