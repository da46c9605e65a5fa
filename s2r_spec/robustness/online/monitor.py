"""Monitors that follow a trace sample by sample."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from numpy.typing import ArrayLike

from s2r_spec.robustness.online.blocks import Blocks, Decided
from s2r_spec.robustness.online.points import Point, Points
from s2r_spec.robustness.online.recorder import Followed, Recorder, each_sample
from s2r_spec.robustness.online.spans import ANY
from s2r_spec.robustness.online.terms import Term
from s2r_spec.robustness.ties import restore_zero

Verdict = Literal["holds", "violated", "unknown"]


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


class Monitor:
    """The robust interval of requirements at the first time of a trace; see :meth:`s2r_spec.spec.Spec.monitor`.

    The interval is defined by Deshmukh et al., "Robust online monitoring of signal temporal
    logic", 2017: every predicate at a later instant takes any value that its signals allow.
    """

    def __init__(self, followed: Followed) -> None:
        self._recorder = Recorder(followed)
        points = Points()
        self._points: dict[str, Point] = {
            name: points(term, 0) for name, term in self._recorder.terms.items()
        }
        self._recorder.algebra.foresee()
        self._ends = dict.fromkeys(self._points, ANY)
        self._now = {name: RobustInterval.of(*ANY) for name in self._points}
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

    def extend(self, times: ArrayLike, samples: Mapping[str, ArrayLike]) -> dict[str, RobustInterval]:
        """Take a block of samples, as many calls of :meth:`update` would; no interval in between is computed.

        Args:
            times: (m,) times of the samples [s].
            samples: signal → (m,) values in the declared unit, (m, dim) for a vector.

        Raises:
            TraceError: see :meth:`update`; a block with a sample that cannot be used is not taken at all.
        """
        for time, sample in each_sample(
            *self._recorder.read_block(times, samples), self._recorder.followed.signals
        ):
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
            self._recorder.guarded(point.refresh)
            if (ends := (point.lower, point.upper)) != self._ends[name]:
                self._ends[name], self._now[name] = ends, RobustInterval.of(*ends)
        return self.intervals


class RobustnessStream:
    """ρ of requirements at every sample, delayed by their horizon; see :meth:`Spec.robustness_stream`."""

    def __init__(self, followed: Followed) -> None:
        self._recorder = Recorder(followed)
        self._sent = dict.fromkeys(self._recorder.terms, 0)
        self._blocks: Blocks | None = None
        # with the times of the instants whose ρ was not returned
        self._followed: list[tuple[str, Term, deque[float]]] = []
        for name, term in self._recorder.terms.items():
            self._followed.append((name, term, deque()))
            term.follow()
            term.keep(partial(self._sent.__getitem__, name))

    def update(self, time: float, sample: Mapping[str, Any]) -> Decided:
        """Take one more sample, and return requirement → [(time [s], ρ), …] of the instants that it decides.

        For args and errors see :meth:`Monitor.update`.
        """
        if self._blocks is not None:
            return self.extend([time], {name: [value] for name, value in sample.items()})
        self._recorder.take(time, sample)
        return self._settled_values(self._recorder.clock.time)

    def extend(self, times: ArrayLike, samples: Mapping[str, ArrayLike]) -> Decided:
        """Take a block of samples, and return what as many calls of :meth:`update` would return together.

        With a period, and without functions of the past, a stream that begins with a block computes whole arrays. It is
        fastest with blocks as long as the requirement's windows. For args and errors see :meth:`Monitor.extend`.
        """
        recorder = self._recorder
        stamps, rows = recorder.read_block(times, samples)
        if self._blocks is None and recorder.clock.now < 0:
            self._blocks = recorder.blocks()
        if self._blocks is None:
            values: Decided = {name: [] for name in self._sent}
            for time, sample in each_sample(stamps, rows, recorder.followed.signals):
                for name, decided in self.update(time, sample).items():
                    values[name] += decided
            return values
        recorder.clock.skip(stamps)
        return recorder.guarded(
            partial(self._blocks.take, stamps, {name: one.T for name, one in rows.items()})
        )

    def finish(self) -> Decided:
        """End the trace here, and return ρ at the remaining instants, with windows cut at the end."""
        if self._blocks is not None:
            self._recorder.end()
            return self._recorder.guarded(self._blocks.finish)
        self._recorder.finish()
        return self._settled_values()

    def _settled_values(self, *new: float) -> Decided:
        """Return ρ at the instants that were decided since the last call, after samples at new times."""
        values: Decided = {}
        for name, term, times in self._followed:
            times.extend(new)
            found = values[name] = []
            k, end = self._sent[name], term.decided.end
            while k < end:
                found.append((times.popleft(), restore_zero(term.value(k))))
                k += 1
            self._sent[name] = end
        return values
