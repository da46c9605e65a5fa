"""Monitors that follow a trace sample by sample."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from s2r_spec.base.errors import TraceError, UsageError, one_of, suggest
from s2r_spec.lang import formula as f
from s2r_spec.lang.declarations import Signal
from s2r_spec.robustness.evaluate import Witness
from s2r_spec.robustness.grid import SNAP
from s2r_spec.robustness.horizon import horizon, samples_needed, seconds_needed
from s2r_spec.robustness.narrow import narrowest, refuse_short
from s2r_spec.robustness.online.algebra import OnlineAlgebra
from s2r_spec.robustness.online.clock import OnlineClock
from s2r_spec.robustness.online.points import Point, Points
from s2r_spec.robustness.online.tape import Tape
from s2r_spec.robustness.reading import HOLD, LEADING, Missing
from s2r_spec.robustness.ties import restore_zero

Verdict = Literal["holds", "violated", "unknown"]


@dataclass(frozen=True)
class Followed:
    """The requirements to follow, and the settings of :meth:`s2r_spec.spec.Spec.monitor`.

    Args:
        formulas: requirement → its formula, with numbers for the parameters in time bounds.
        signals: the signals that they read.
        params: parameter → value, for the parameters that they use.
    """

    formulas: Mapping[str, f.Formula]
    signals: Sequence[Signal]
    params: Mapping[str, float]
    period: float | None
    until: Witness
    nan: Missing
    ranges: bool
    sparse: bool = False


@dataclass(frozen=True)
class RobustInterval:
    """The possible values of ρ, in the unit of ρ: the final ρ lies in [lower, upper].

    ``lower == upper`` is ρ itself.

    Args:
        lower: lower bound.
        upper: upper bound.
        satisfied: whether the requirement is true for every continuation of the trace; None while this is open.
            At ρ = 0 the comparisons decide.
    """

    lower: float
    upper: float
    satisfied: bool | None

    @classmethod
    def of(cls, lower: float, upper: float) -> RobustInterval:
        """Return the interval of robustness bounds with signs; see :mod:`s2r_spec.robustness.ties`."""
        satisfied = True if lower > 0 else False if upper < 0 else None
        return cls(restore_zero(lower), restore_zero(upper), satisfied)

    @property
    def decided(self) -> bool:
        """Whether ρ and the verdict are known."""
        return self.lower == self.upper and self.satisfied is not None

    @property
    def bounded(self) -> bool:
        """Whether one of the bounds is finite or known."""
        return (self.lower, self.upper) != (-math.inf, math.inf)

    @property
    def verdict(self) -> Verdict:
        """The verdict for every continuation of the trace; "unknown" while it is open."""
        return "unknown" if self.satisfied is None else "holds" if self.satisfied else "violated"


class _Recorder:
    """Takes samples, and updates all values that depend on them."""

    def __init__(self, followed: Followed) -> None:
        self.followed = followed
        self.clock = OnlineClock(followed.period)
        self.tapes = {signal.name: [Tape() for _ in range(signal.dim)] for signal in followed.signals}
        ranges = {s.name: s.range for s in followed.signals if s.range is not None} if followed.ranges else {}
        self.algebra = OnlineAlgebra(
            self.clock, self.tapes, ranges, followed.params, tuple(followed.formulas.values()), followed.until
        )
        windows = filter(None, map(narrowest, followed.formulas.values()))
        self.narrowest = min(windows, key=lambda window: window.length, default=None)
        self._refuse_short()
        self.terms = {name: self.algebra.walk(formula) for name, formula in followed.formulas.items()}
        self.broken: TraceError | None = None

    def take(self, time: float, sample: Mapping[str, Any]) -> None:
        """Take the next sample; for errors see :meth:`Monitor.update`."""
        self._check_open()
        numbers = [self._read(signal, sample) for signal in self.followed.signals]
        self.clock.tick(float(time))
        for signal, components in zip(self.followed.signals, numbers, strict=True):
            for tape, number in zip(self.tapes[signal.name], components, strict=True):
                tape.append(number)
        self._settle()
        if self.clock.now == 0:
            self.algebra.foresee()

    def finish(self) -> None:
        """End the trace: no further sample comes."""
        self._check_open()
        if self.clock.now < 0:
            raise TraceError("there is no sample; a trace needs at least one")
        self.clock.finish()
        self._settle()

    def _check_open(self) -> None:
        if self.broken is not None:
            raise self.broken
        if self.clock.ended:
            raise UsageError("the trace was finished; a new one needs a new monitor")

    def _refuse_short(self) -> None:
        """Refuse windows shorter than the sample period, as soon as the period is known."""
        clock = self.clock
        if self.narrowest is None or self.followed.sparse:
            return
        if clock.period is not None:
            refuse_short(self.narrowest, clock.step)
        elif clock.now > 0:
            refuse_short(self.narrowest, clock.latest / clock.now, "the mean time between two samples")

    def _settle(self) -> None:
        try:
            self._refuse_short()
            for stream in self.clock.streams:
                stream.advance()
        except TraceError as error:
            self.broken = error
            raise

    def _read(self, signal: Signal, sample: Mapping[str, Any]) -> list[float]:
        name = signal.name
        if name not in sample:
            lacks = f"the sample has no channel {name!r}{suggest(name, sample)} it has {one_of(sample)}"
            raise TraceError(lacks)
        try:
            numbers = [float(x) for x in sample[name]] if signal.vector else [float(sample[name])]
        except (TypeError, ValueError):
            numbers = []
        if len(numbers) != signal.dim:
            declared = f"{signal.dim} numbers" if signal.vector else "one number"
            raise TraceError(
                f"channel {name!r} is {sample[name]!r}, but the spec declares {declared} per sample"
            )
        where = f"sample {self.clock.now + 1}"
        if any(x != x for x in numbers):
            if self.followed.nan == "error" or self.clock.now < 0:
                remedy = HOLD if self.followed.nan == "error" else LEADING
                raise TraceError(
                    f"channel {name!r} is NaN at {where}; a missing sample has no robustness: {remedy}"
                )
            last = [tape.value(self.clock.now) for tape in self.tapes[name]]
            numbers = [old if new != new else new for new, old in zip(numbers, last, strict=True)]
        if signal.boolean and numbers[0] not in (0, 1):
            raise TraceError(f"channel {name!r} is declared bool, but it is {numbers[0]:g} at {where}")
        if self.followed.ranges and signal.range is not None:
            low, high = signal.range
            for x in numbers:
                if not low <= x <= high:
                    raise TraceError(
                        f"channel {name!r} is {x:g} at {where}, outside its declared range [{low:g}, {high:g}], "
                        f"which the interval assumed; widen the range, or ignore it (ranges=False, --no-ranges)"
                    )
        return numbers

    def complete(self, formula: f.Formula) -> bool:
        """Return whether the samples so far reach a formula's horizon from the first instant, to within a period.

        Without a period, it is to within the shortest time between two samples: the median would need all of them.
        """
        clock = self.clock
        if clock.now < 1:
            return horizon(formula) == 0 and samples_needed(formula, None) == 0
        step = clock.step if clock.period is not None else clock.shortest
        snap = max(clock.slack, SNAP * step)
        reached = clock.now * step if clock.period is not None else clock.latest
        return reached + step - snap >= seconds_needed(formula, step, slack=2 * snap)

    def shortfall(self, formula: f.Formula) -> str:
        """Return in words how far the horizon of a formula is past the samples so far."""
        ahead, clock = horizon(formula), self.clock
        if clock.now < 1:
            return "it looks further, but the trace has one sample"
        if math.isfinite(ahead):
            return f"it looks {ahead:g} s ahead, but the trace lasts {clock.time - clock.start:.6g} s"
        needs = seconds_needed(formula, clock.step or clock.shortest)
        return f"a part of it looks {needs:g} s ahead, past the end of the trace"


class Monitor:
    """The robust interval of requirements at the first time of a trace; see :meth:`s2r_spec.spec.Spec.monitor`.

    The interval is defined by Deshmukh et al., "Robust online monitoring of signal temporal
    logic", 2017: every predicate at a later instant takes any value that its signals allow.
    """

    def __init__(self, followed: Followed) -> None:
        self._recorder = _Recorder(followed)
        points = Points()
        self._points: dict[str, Point] = {
            name: points(term, 0) for name, term in self._recorder.terms.items()
        }
        self._recorder.algebra.foresee()
        self._now = {name: RobustInterval.of(-math.inf, math.inf) for name in self._points}
        self._refresh()

    @property
    def intervals(self) -> dict[str, RobustInterval]:
        """Requirement → the possible values of its ρ at the first time."""
        return dict(self._now)

    @property
    def decided(self) -> bool:
        """Whether every ρ is known. Further samples then change nothing."""
        return all(interval.decided for interval in self._now.values())

    def update(self, time: float, sample: Mapping[str, Any]) -> dict[str, RobustInterval]:
        """Take one more sample, and return requirement → the possible values of ρ at the first time.

        Args:
            time: the time of the sample [s], later than the time of the sample before.
            sample: signal → its value in the declared unit, a sequence for a vector.

        Raises:
            TraceError: the sample cannot be used (a missing channel, NaN, a time that does not
                increase, a value outside its declared range) and was not taken; or a predicate
                or a window is undefined, which ends the trace.
        """
        self._recorder.take(time, sample)
        return self._refresh()

    def finish(self, *, partial: bool = False) -> dict[str, RobustInterval]:
        """End the trace here, and return requirement → ρ at the first time.

        An operator over the whole rest of the trace is then decided. A requirement with an incomplete bounded window
        keeps its interval. With ``partial`` it is evaluated with windows cut at the end.
        """
        recorder = self._recorder
        open_ = set() if partial else {
            name for name, formula in recorder.followed.formulas.items() if not recorder.complete(formula)
        }  # fmt: skip
        before = self.intervals
        recorder.finish()
        after = self._refresh()
        self._now = {name: before[name] if name in open_ else after[name] for name in after}
        return self.intervals

    def shortfall(self, requirement: str) -> str:
        """Return in words how far the horizon of an undecided requirement is past the samples so far."""
        return self._recorder.shortfall(self._recorder.followed.formulas[requirement])

    def _refresh(self) -> dict[str, RobustInterval]:
        for name, point in self._points.items():
            point.refresh()
            self._now[name] = RobustInterval.of(point.lower, point.upper)
        return self.intervals


class RobustnessStream:
    """ρ of requirements at every sample, delayed by their horizon; see :meth:`Spec.robustness_stream`."""

    def __init__(self, followed: Followed) -> None:
        self._recorder = _Recorder(followed)
        self._sent = dict.fromkeys(self._recorder.terms, 0)
        self._times = Tape()
        self._times.keep(lambda: min(self._sent.values()))
        for name, term in self._recorder.terms.items():
            term.follow()
            term.keep(partial(self._sent.__getitem__, name))

    def update(self, time: float, sample: Mapping[str, Any]) -> dict[str, list[tuple[float, float]]]:
        """Take one more sample, and return requirement → [(time [s], ρ), …] of the instants that it decides.

        For args and errors see :meth:`Monitor.update`.
        """
        self._recorder.take(time, sample)
        self._times.append(time)
        return self._settled_values()

    def finish(self) -> dict[str, list[tuple[float, float]]]:
        """End the trace here, and return ρ at the remaining instants, with windows cut at the end."""
        self._recorder.finish()
        return self._settled_values()

    def _settled_values(self) -> dict[str, list[tuple[float, float]]]:
        values = {}
        for name, term in self._recorder.terms.items():
            first, self._sent[name] = self._sent[name], term.end
            values[name] = [
                (self._times.value(k), restore_zero(term.value(k))) for k in range(first, term.end)
            ]
        return values
