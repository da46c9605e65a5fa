"""Takes the samples of a trace, single or in blocks, checks them, and updates the values that depend on them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import TraceError, UsageError, one_of, suggest
from s2r_spec.lang import formula as f
from s2r_spec.lang.declarations import Signal
from s2r_spec.robustness.evaluate import Witness
from s2r_spec.robustness.grid import SNAP, Grid
from s2r_spec.robustness.horizon import horizon, samples_needed, seconds_needed
from s2r_spec.robustness.narrow import narrowest, refuse_short
from s2r_spec.robustness.numbers import SampledSignals
from s2r_spec.robustness.online.algebra import OnlineAlgebra
from s2r_spec.robustness.online.blocks import Blocks, fits
from s2r_spec.robustness.online.clock import OnlineClock
from s2r_spec.robustness.online.spans import ANY, Span
from s2r_spec.robustness.online.tape import Tape
from s2r_spec.robustness.reading import HOLD, LEADING, Missing

T = TypeVar("T")
NONE: Span = (math.inf, -math.inf)
"""Definition: the span of no number."""


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


class Recorder:
    """Takes samples, and updates all values that depend on them."""

    def __init__(self, followed: Followed) -> None:
        self.followed = followed
        self.clock = OnlineClock(followed.period)
        self.tapes = {signal.name: [Tape() for _ in range(signal.dim)] for signal in followed.signals}
        ranges = {s.name: s.range for s in followed.signals if s.range is not None} if followed.ranges else {}
        # a float in these limits is a plain sample; others are read with care
        plain = {s.name: NONE if s.vector or s.boolean else ranges.get(s.name, ANY) for s in followed.signals}
        self.plain = [(s.name, plain[s.name], self.tapes[s.name][0], s) for s in followed.signals]
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
        clock = self.clock
        if self.broken is not None or clock.ended:
            self._check_open()
        try:
            for name, (low, high), tape, signal in self.plain:
                value = sample.get(name)
                if isinstance(value, float) and low <= value <= high:
                    tape.append(value)
                else:
                    self._append(signal, sample)
            clock.tick(float(time))
        except Exception:
            for tape in (tape for tapes in self.tapes.values() for tape in tapes):
                tape.end = clock.now + 1  # the sample is dropped
            raise
        self.guarded(self._advance)
        if clock.now == 0:
            self.algebra.foresee()

    def finish(self) -> None:
        """End the trace: no further sample comes."""
        self.end()
        self.guarded(self._advance)

    def end(self) -> None:
        """End the trace, and compute nothing."""
        self._check_open()
        if self.clock.now < 0:
            raise TraceError("there is no sample; a trace needs at least one")
        self.clock.finish()

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

    def _advance(self) -> None:
        if self.clock.period is None:
            self._refuse_short()
        for stream in self.clock.streams:
            stream.advance()

    def guarded(self, compute: Callable[[], T]) -> T:
        """Return what a function computes; its TraceError ends the trace."""
        try:
            return compute()
        except TraceError as error:
            self.broken = error
            raise

    def blocks(self) -> Blocks | None:
        """Return an evaluator of blocks; None if a formula needs single samples."""
        followed, period = self.followed, self.clock.period
        if period is None or followed.nan == "hold":
            return None
        if not all(fits(formula, period) for formula in followed.formulas.values()):
            return None
        params = {name: np.full((1, 1), value) for name, value in followed.params.items()}
        return Blocks(followed.formulas, period, SampledSignals(Grid(1, period), {}, params, followed.until))

    def read_block(
        self, times: ArrayLike, samples: Mapping[str, ArrayLike]
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return (m,) times and signal → (m, dim) numbers of the next samples; for errors see :meth:`take`."""
        self._check_open()
        stamps = np.array(times, dtype=np.float64, ndmin=1)
        rows = {
            signal.name: self._read_rows(signal, samples, len(stamps)) for signal in self.followed.signals
        }
        self.clock.check_all(stamps)
        return stamps, rows

    def _read_rows(self, signal: Signal, samples: Mapping[str, ArrayLike], count: int) -> FloatArray:
        """Return (m, dim) numbers of a signal; one that is wrong is read alone, for the words of its error."""
        name, first = signal.name, self.clock.now + 1
        if name not in samples:
            self._read(signal, samples, first)
        rows = np.asarray(samples[name])
        if rows.shape != ((count, signal.dim) if signal.vector else (count,)):
            raise TraceError(f"channel {name!r} has the shape {rows.shape}, and its block has {count} times")
        plain = rows.dtype.kind in "fiu" and not signal.boolean and not (rows != rows).any()
        if plain and not (self.followed.ranges and signal.range is not None):
            return rows.astype(np.float64).reshape(count, signal.dim)
        return np.array([self._read(signal, {name: row}, first + k) for k, row in enumerate(rows.tolist())])

    def _append(self, signal: Signal, sample: Mapping[str, Any]) -> None:
        numbers = self._read(signal, sample, self.clock.now + 1)
        for tape, number in zip(self.tapes[signal.name], numbers, strict=True):
            tape.append(number)

    def _read(self, signal: Signal, sample: Mapping[str, Any], k: int) -> list[float]:
        """Return the numbers of a signal in sample k."""
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
        where = f"sample {k}"
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
        return reached + step - snap >= seconds_needed(formula, step, 2 * snap)

    def shortfall(self, formula: f.Formula) -> str:
        """Return in words how far the horizon of a formula is past the samples so far."""
        ahead, clock = horizon(formula), self.clock
        if clock.now < 1:
            return "it looks further, but the trace has one sample"
        if math.isfinite(ahead):
            return f"it looks {ahead:g} s ahead, but the trace lasts {clock.time - clock.start:.6g} s"
        needs = seconds_needed(formula, clock.step or clock.shortest, 0.0)
        return f"a part of it looks {needs:g} s ahead, past the end of the trace"


def each_sample(
    times: FloatArray, rows: Mapping[str, FloatArray], signals: Sequence[Signal]
) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield the time and the sample of each instant of a block."""
    lists = {one.name: (rows[one.name] if one.vector else rows[one.name][:, 0]).tolist() for one in signals}
    for k, time in enumerate(times.tolist()):
        yield time, {name: values[k] for name, values in lists.items()}
