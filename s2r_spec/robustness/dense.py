"""Robustness in continuous time: a condition is evaluated at every instant from the first to the last sample."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import reduce
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.errors import UsageError
from s2r_spec.lang import formula as f
from s2r_spec.robustness import windows
from s2r_spec.robustness.curve import Curve, add, maximum, minimum, sign, split_at_zero
from s2r_spec.robustness.evaluate import Walk, WithEdges
from s2r_spec.robustness.numbers import Numbers, SampledSignals, no_value
from s2r_spec.robustness.sampled import SampledAlgebra
from s2r_spec.robustness.ties import TIE, break_ties, rescale

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class ContinuousSignals:
    """Signals and parameters in continuous time, on which formulas are evaluated.

    Args:
        samples: the signals at their samples.
        between: value of a signal between two samples: the last sample ("hold"), or linear interpolation
            ("linear"). A boolean signal is always held.
        snap: times closer than this are the same [s].
    """

    samples: SampledSignals
    between: Literal["hold", "linear"]
    snap: float

    @property
    def times(self) -> FloatArray:
        """(n,) times after the first sample [s]."""
        return self.samples.clock.times


def snap_of(times: FloatArray) -> float:
    """Return the difference [s] below which two times are equal up to rounding."""
    span = float(times[-1] - times[0])
    return 1e-12 * span + 8 * float(np.finfo(np.float64).eps) * float(np.abs(times).max())


def walk_curves(recording: ContinuousSignals) -> Walk[Curve]:
    """Return the walk that gives the robustness of a formula as a curve.

    It raises TraceError if a predicate has no value, and UsageError for ``next`` and ``prev``, which count samples.
    """
    return Walk(DenseAlgebra(recording), recording.samples.until)


class DenseAlgebra(WithEdges[Curve]):
    """Robustness signals as curves."""

    def __init__(self, recording: ContinuousSignals) -> None:
        self.recording = recording
        self.snap = recording.snap
        self.values = PredicateCurves(recording)

    def truth(self, value: bool) -> Curve:
        """Return an infinity."""
        return Curve.constant(self.recording.times, np.inf if value else -np.inf)

    def flag(self, node: f.Flag) -> Curve:
        """Return an infinity at each instant."""
        states = np.where(self.recording.samples.signals[node.name][0] > 0, np.inf, -np.inf)
        return Curve.of(self.recording.times, states, "hold")

    def margin(self, node: f.Comparison) -> Curve:
        """Return the margin of the comparison."""
        left, right = self.values(node.left), self.values(node.right)
        if node.operator in (">", ">="):
            left, right = right, left
        difference = add(right, -left, self.snap)
        with np.errstate(invalid="ignore"):
            bad = np.isnan(difference.at)
            bad[:-1] |= ~(
                np.isfinite(difference.left - difference.right) | (difference.left == difference.right)
            )
        if bad.any():
            raise no_value(node, f"{difference.times[np.argmax(bad)]:.9g} s after the first sample")
        fine = split_at_zero(difference, self.snap)
        at, right_limit, left_limit = fine.at, fine.right, fine.left
        if node.operator in ("==", "!="):
            sign = -1.0 if node.operator == "==" else 1.0
            at, right_limit, left_limit = (sign * np.abs(part) for part in (at, right_limit, left_limit))
        return Curve(
            fine.times,
            break_ties(at, node.operator),
            _signed_limit(right_limit, left_limit, node.operator),
            _signed_limit(left_limit, right_limit, node.operator),
        )

    def negative(self, x: Curve) -> Curve:
        """Return −x."""
        return -x

    def scale(self, x: Curve, factor: float) -> Curve:
        """Return factor · x."""
        return Curve(x.times, *(rescale(part, factor) for part in (x.at, x.right, x.left)))

    def least(self, x: Curve, y: Curve) -> Curve:
        """Return the smaller of both, with crossings."""
        return minimum(x, y, self.snap)

    def always(self, x: Curve, interval: f.Interval, past: bool) -> Curve:
        """Return the infimum over the window."""
        if past:
            return windows.infimum(x.backward(), interval, self.snap).backward()
        return windows.infimum(x, interval, self.snap)

    def until(self, left: Curve, right: Curve, interval: f.Interval, past: bool) -> Curve:
        """Return the robustness of the best witness."""
        if past:
            return windows.until(left.backward(), right.backward(), interval, self.snap).backward()
        return windows.until(left, right, interval, self.snap)

    def step(self, x: Curve, node: f.AdjacentSample) -> Curve:
        """Refuse: there is no next instant."""
        raise UsageError(
            f"`{node.span.text}` ({node.span.place}) counts samples: "
            f"`{node.operator}` needs interpolation='samples'"
        )

    def edge(self, now: Curve, before: Curve, earlier: float = np.inf) -> Curve:
        """Return min(now, −before just before); ``earlier`` is the value before the first instant."""
        return windows.edge(now, before, earlier, self.snap)


def _signed_limit(limit: FloatArray, other: FloatArray, operator: f.CompareOp) -> FloatArray:
    """Return (m,) limits with a sign: a limit of 0 gets the sign of its piece, from the ``other`` limit."""
    zero = limit == 0.0
    if not zero.any():
        return limit
    return np.where(zero & (other != 0.0), np.copysign(TIE, other), break_ties(limit, operator))


@dataclass
class PredicateCurves:
    """The numbers that a predicate compares, as curves.

    Sums, differences, multiples, minima, maxima, absolute values and signs of straight lines are exact, with their
    crossings. Other functions (products, quotients, powers, roots, norms, functions of the past) are computed at the
    samples and interpolated linearly.
    """

    recording: ContinuousSignals
    sampled: Numbers = field(init=False)
    done: dict[int, Curve] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.sampled = SampledAlgebra(self.recording.samples).numbers

    def __call__(self, node: f.Value) -> Curve:
        """Return the value of a node with one component; NaN where it is undefined."""
        if id(node) not in self.done:
            self.done[id(node)] = self._value(node)
        return self.done[id(node)]

    def _value(self, node: f.Value) -> Curve:
        recording, snap = self.recording, self.recording.snap
        if recording.between == "hold":
            return self._join(node)  # functions of held signals are held
        match node:
            case f.Convert():
                return self(node.operand).map(node.conversion.each)
            case f.Arithmetic(operator="+"):
                return add(self(node.left), self(node.right), snap)
            case f.Arithmetic(operator="-"):
                return add(self(node.left), -self(node.right), snap)
            case f.Arithmetic(operator="*" | "/") if self._steady(node.right):
                factor = float(self.sampled(node.right).item())
                with np.errstate(all="ignore"):
                    factor = factor if node.operator == "*" else float(np.divide(1.0, factor))
                    return self(node.left).map(lambda part: factor * part)
            case f.Arithmetic(operator="*") if self._steady(node.left):
                factor = float(self.sampled(node.left).item())
                return self(node.right).map(lambda part: factor * part)
            case f.Elementary(function="minus"):
                return -self(node.operand)
            case f.Elementary(function="abs") | f.Norm(operands=(f.Value(width=1),)):
                operand = node.operand if isinstance(node, f.Elementary) else node.operands[0]
                return maximum(self(operand), -self(operand), snap)
            case f.Elementary(function="sign"):
                return sign(self(node.operand), snap)
            case f.Extremum():
                fold = minimum if node.function == "min" else maximum
                return reduce(lambda x, y: fold(x, y, snap), map(self, node.operands))
            case f.Overshoot():
                direction = float(self.sampled.direction(node).item())
                return add(self(node.signal), -self(node.reference), snap).map(lambda part: direction * part)
            case _:
                return self._join(node)

    def _steady(self, node: f.Value) -> bool:
        return bool(self.sampled(node).shape[-1] == 1 < self.recording.times.size)

    def _join(self, node: f.Value) -> Curve:
        """Return the curve through the values at the samples."""
        times = self.recording.times
        samples = np.broadcast_to(self.sampled(node)[0], times.shape)
        return Curve.of(times, samples, self.recording.between)
