"""A trace followed sample by sample."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from s2r_spec.errors import TraceError, UsageError, one_of, suggest
from s2r_spec.lang import formula as f
from s2r_spec.lang.declarations import Signal
from s2r_spec.robustness.evaluate import Witness
from s2r_spec.robustness.grid import SNAP, Grid
from s2r_spec.robustness.horizon import horizon, samples_needed, seconds_needed
from s2r_spec.robustness.narrow import narrowest, refuse_short
from s2r_spec.robustness.online.algebra import OnlineAlgebra
from s2r_spec.robustness.online.clock import Clock
from s2r_spec.robustness.online.points import Point, Points
from s2r_spec.robustness.online.tape import Tape
from s2r_spec.robustness.online.terms import Term
from s2r_spec.robustness.reading import HOLD, LEADING, Missing
from s2r_spec.robustness.ties import plain_number

Verdict = Literal["holds", "violated", "unknown"]


@dataclass(frozen=True)
class Followed:
    """What is followed, and how it is read.

    Args:
        formulas: requirement → its formula, time bounds that are parameters given their values.
        signals: what they read.
        params: parameter → its value, for those that they use.
        period: time from one sample to the next [s]; None if samples come at any time.
        until: see :class:`s2r_spec.robustness.evaluate.Walk`.
        nan: what a NaN sample is: an "error", or as the one before it ("hold").
        ranges: whether samples are known to lie in the declared ranges.
        sparse: whether windows may be shorter than the time between two samples.
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
    """What ρ can still become, in the unit of ρ: it ends in [lower, upper].

    ``lower == upper`` is ρ itself.

    Args:
        lower: end of the interval.
        upper: end of the interval.
        satisfied: whether the requirement is true, whatever comes; None where that is open. At ρ = 0 the
            comparisons decide it.
    """

    lower: float
    upper: float
    satisfied: bool | None

    @classmethod
    def of(cls, lower: float, upper: float) -> RobustInterval:
        """Return the interval of a robustness with a sign; see :mod:`s2r_spec.robustness.ties`."""
        satisfied = True if lower > 0 else False if upper < 0 else None
        return cls(plain_number(lower), plain_number(upper), satisfied)

    @property
    def decided(self) -> bool:
        """Whether ρ and the verdict are known."""
        return self.lower == self.upper and self.satisfied is not None

    @property
    def bounded(self) -> bool:
        """Whether anything is known of ρ."""
        return (self.lower, self.upper) != (-math.inf, math.inf)

    @property
    def verdict(self) -> Verdict:
        """Whether the requirement "holds" or is "violated" whatever comes, or that is "unknown"."""
        return "unknown" if self.satisfied is None else "holds" if self.satisfied else "violated"


class _Recorder:
    """Takes samples in, and lets everything that was built on them settle."""

    def __init__(self, what: Followed) -> None:
        self.what = what
        self.clock = Clock(what.period)
        self.tapes = {signal.name: [Tape() for _ in range(signal.dim)] for signal in what.signals}
        ranges = {s.name: s.range for s in what.signals if s.range is not None} if what.ranges else {}
        self.algebra = OnlineAlgebra(
            self.clock, self.tapes, ranges, what.params, tuple(what.formulas.values()), what.until
        )
        found = [narrowest(formula) for formula in what.formulas.values()]
        self.narrowest = min(
            (window for window in found if window is not None), key=lambda w: w.length, default=None
        )
        self._refuse_short()
        self.terms = {name: self.algebra.walk(formula) for name, formula in what.formulas.items()}
        self.broken: TraceError | None = None

    def take(self, time: float, sample: Mapping[str, Any]) -> None:
        """Take the next sample.

        Raises:
            TraceError: it cannot be used, and then nothing was changed; or the trace so far
                has no robustness, and then nothing more can be taken.
        """
        self._check_open()
        numbers = [self._read(signal, sample) for signal in self.what.signals]
        self.clock.tick(float(time))
        for signal, components in zip(self.what.signals, numbers, strict=True):
            for tape, number in zip(self.tapes[signal.name], components, strict=True):
                tape.append(number)
        self._settle()
        if self.clock.now == 0:
            self.algebra.foresee()

    def finish(self) -> None:
        """Take it that there is no other sample."""
        self._check_open()
        if self.clock.now < 0:
            raise TraceError("there is no sample; a trace has one at least")
        self.clock.finish()
        self._settle()

    def _check_open(self) -> None:
        if self.broken is not None:
            raise self.broken
        if self.clock.ended:
            raise UsageError("the trace was finished; a new one needs a new monitor")

    def _refuse_short(self) -> None:
        """Refuse windows that are shorter than the time from one sample to the next, as soon as that is known."""
        clock = self.clock
        if self.narrowest is None or self.what.sparse:
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
            raise TraceError(
                f"the sample has no channel {name!r}{suggest(name, sample)} it has {one_of(sample)}"
            )
        try:
            numbers = [float(x) for x in sample[name]] if signal.vector else [float(sample[name])]
        except (TypeError, ValueError):
            numbers = []
        if len(numbers) != signal.dim:
            declared = f"{signal.dim} numbers" if signal.vector else "one number"
            raise TraceError(
                f"channel {name!r} is {sample[name]!r}, but the spec declares {declared} a sample"
            )
        where = f"sample {self.clock.now + 1}"
        if any(x != x for x in numbers):
            if self.what.nan == "error" or self.clock.now < 0:
                way = HOLD if self.what.nan == "error" else LEADING
                raise TraceError(
                    f"channel {name!r} is NaN at {where}; a missing sample has no robustness: {way}"
                )
            last = [tape.value(self.clock.now) for tape in self.tapes[name]]
            numbers = [old if new != new else new for new, old in zip(numbers, last, strict=True)]
        if signal.boolean and numbers[0] not in (0, 1):
            raise TraceError(f"channel {name!r} is declared bool, but it is {numbers[0]:g} at {where}")
        if self.what.ranges and signal.range is not None:
            low, high = signal.range
            for x in numbers:
                if not low <= x <= high:
                    raise TraceError(
                        f"channel {name!r} is {x:g} at {where}, outside its declared range [{low:g}, {high:g}], "
                        f"which the interval relied on; widen the range, or do without (ranges=False, --no-ranges)"
                    )
        return numbers

    def complete(self, formula: f.Formula) -> bool:
        """Whether the samples so far reach as far as a formula looks at the first instant, to within a period.

        Without a period, to within the shortest time between two samples: the median would need all of them.
        """
        clock = self.clock
        if clock.now < 1:
            return horizon(formula) == 0 and samples_needed(formula, Grid(1, None)) == 0
        step = clock.step if clock.period is not None else clock.shortest
        snap = max(clock.slack, SNAP * step)
        reached = clock.now * step if clock.period is not None else clock.latest
        return reached + step - snap >= seconds_needed(formula, step, slack=2 * snap)

    def shortfall(self, formula: f.Formula) -> str:
        """Return in words how far a formula looks past the samples so far."""
        ahead, clock = horizon(formula), self.clock
        if clock.now < 1:
            return "it looks further, but the trace has one sample"
        if math.isfinite(ahead):
            return f"it looks {ahead:g} s ahead, but the trace lasts {clock.time - clock.start:.6g} s"
        needs = seconds_needed(formula, clock.step or clock.shortest)
        return f"a part of it looks {needs:g} s ahead, past the end of the trace"


class Monitor:
    """The robust interval of requirements at the first time of a trace; see :meth:`s2r_spec.spec.Spec.monitor`.

    The interval is that of Deshmukh et al., "Robust online monitoring of signal temporal
    logic", 2017: every predicate at an instant to come lies anywhere its signals can be.
    """

    def __init__(self, what: Followed) -> None:
        self._recorder = _Recorder(what)
        points = Points()
        self._points: dict[str, Point] = {
            name: points(term, 0) for name, term in self._recorder.terms.items()
        }
        self._recorder.algebra.foresee()
        self._now = {name: RobustInterval.of(-math.inf, math.inf) for name in self._points}
        self._refresh()

    @property
    def intervals(self) -> dict[str, RobustInterval]:
        """Requirement → what its ρ at the first time can still become."""
        return dict(self._now)

    @property
    def decided(self) -> bool:
        """Whether every ρ is known: no other sample changes anything."""
        return all(interval.decided for interval in self._now.values())

    def update(self, time: float, sample: Mapping[str, Any]) -> dict[str, RobustInterval]:
        """Take one more sample, and return requirement → what ρ at the first time can still become.

        Args:
            time: of the sample [s], after that of the one before.
            sample: signal → its value in the declared unit, a sequence for a vector.

        Raises:
            TraceError: the sample cannot be used (a missing channel, NaN, a time that does not
                increase, a value outside its declared range) and was not taken; or a predicate
                or a window has no value, which ends the trace.
        """
        self._recorder.take(time, sample)
        return self._refresh()

    def finish(self, *, partial: bool = False) -> dict[str, RobustInterval]:
        """End the trace here, and return requirement → ρ at the first time.

        An operator over the whole rest of the trace has seen it then. A requirement
        whose bounded windows are not complete keeps its interval, unless ``partial``
        evaluates it on what there is.
        """
        recorder = self._recorder
        open_ = set() if partial else {
            name for name, formula in recorder.what.formulas.items() if not recorder.complete(formula)
        }  # fmt: skip
        before = self.intervals
        recorder.finish()
        after = self._refresh()
        self._now = {name: before[name] if name in open_ else after[name] for name in after}
        return self.intervals

    def shortfall(self, requirement: str) -> str:
        """Return in words how far an undecided requirement looks past the samples so far."""
        return self._recorder.shortfall(self._recorder.what.formulas[requirement])

    def _refresh(self) -> dict[str, RobustInterval]:
        for name, point in self._points.items():
            point.refresh()
            self._now[name] = RobustInterval.of(point.lower, point.upper)
        return self.intervals


class RobustnessStream:
    """ρ of requirements at every sample, as late as their horizon; see :meth:`Spec.robustness_stream`."""

    def __init__(self, what: Followed) -> None:
        self._recorder = _Recorder(what)
        self._sent = dict.fromkeys(self._recorder.terms, 0)
        self._times = Tape()
        self._times.keep(lambda: min(self._sent.values()))
        for name, term in self._recorder.terms.items():
            self._follow(name, term)

    def _follow(self, name: str, term: Term) -> None:
        term.follow()
        term.keep(lambda: self._sent[name])

    def update(self, time: float, sample: Mapping[str, Any]) -> dict[str, list[tuple[float, float]]]:
        """Take one more sample, and return requirement → [(time [s], ρ), …] of the instants it settles.

        Args and errors are those of :meth:`Monitor.update`.
        """
        self._recorder.take(time, sample)
        self._times.append(time)
        return self._settled()

    def finish(self) -> dict[str, list[tuple[float, float]]]:
        """End the trace here, and return ρ at the instants that are left, windows cut at the end."""
        self._recorder.finish()
        return self._settled()

    def _settled(self) -> dict[str, list[tuple[float, float]]]:
        found = {}
        for name, term in self._recorder.terms.items():
            first, self._sent[name] = self._sent[name], term.end
            found[name] = [
                (self._times.value(k), plain_number(term.value(k))) for k in range(first, term.end)
            ]
        return found
