"""Robustness in continuous time: a condition is evaluated at every instant from the first to the last sample."""

from __future__ import annotations

import operator
from dataclasses import dataclass, field
from functools import reduce
from typing import Literal

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.lang import formula as f
from s2r_spec.robustness import windows
from s2r_spec.robustness.curve import Curve, add, maximum, minimum, sign, split_at_zero
from s2r_spec.robustness.evaluate import Algebra
from s2r_spec.robustness.numbers import Numbers, SampledSignals, no_value
from s2r_spec.robustness.sampled import numbers_at
from s2r_spec.robustness.ties import TIE, break_ties, rescale


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


def curve_algebra(recording: ContinuousSignals) -> Algebra[Curve]:
    """Return the operations on robustness signals as curves.

    They raise TraceError if a predicate has no value, and UsageError for ``next`` and ``prev``, which count samples.
    """
    times, snap, values = recording.times, recording.snap, PredicateCurves(recording)

    def flag(node: f.Flag) -> Curve:
        states = np.where(recording.samples.signals[node.name][0] > 0, np.inf, -np.inf)
        return Curve.of(times, states, "hold")

    def always(x: Curve, interval: f.Interval, past: bool) -> Curve:
        if past:
            return windows.infimum(x.backward(), interval, snap).backward()
        return windows.infimum(x, interval, snap)

    def until(left: Curve, right: Curve, interval: f.Interval, past: bool) -> Curve:
        if past:
            return windows.until(left.backward(), right.backward(), interval, snap).backward()
        return windows.until(left, right, interval, snap)

    def step(x: Curve, node: f.AdjacentSample) -> Curve:
        raise UsageError(
            f"`{node.span.text}` ({node.span.place}) counts samples: "
            f"`{node.operator}` needs interpolation='samples'"
        )

    return Algebra(
        truth=lambda value: Curve.constant(times, np.inf if value else -np.inf),
        flag=flag,
        margin=lambda node: margin_curve(node, values),
        negative=operator.neg,
        scale=lambda x, factor: Curve(x.times, *(rescale(part, factor) for part in (x.at, x.right, x.left))),
        least=lambda x, y: minimum(x, y, snap),
        greatest=lambda x, y: maximum(x, y, snap),
        always=always,
        eventually=lambda x, interval, past: -always(-x, interval, past),
        until=until,
        step=step,
        edge=lambda now, before, earlier: windows.edge(now, before, earlier, snap),
    )


def margin_curve(node: f.Comparison, values: PredicateCurves) -> Curve:
    """Return the margin of a comparison, never 0; see :mod:`s2r_spec.robustness.ties`.

    Raises:
        TraceError: it is undefined at some instant.
    """
    snap, left, right = values.recording.snap, values(node.left), values(node.right)
    if node.operator in (">", ">="):
        left, right = right, left
    difference = add(right, -left, snap)
    with np.errstate(invalid="ignore"):
        bad = np.isnan(difference.at)
        bad[:-1] |= ~(np.isfinite(difference.left - difference.right) | (difference.left == difference.right))
    if bad.any():
        raise no_value(node, f"{difference.times[np.argmax(bad)]:.9g} s after the first sample")
    fine = split_at_zero(difference, snap)
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
        self.sampled = numbers_at(self.recording.samples)

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
