"""Recordings beside what the controller computes: the error of any mistake and any machine, and its misfit.

See :mod:`.law` for the model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from s2r_spec.backend import HasControlLaw, HasEffects
from s2r_spec.backend.effects import catalogue_of
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.quality.comparison import CLEAR, FLOOR
from s2r_spec.diagnose.quality.law_family import Columns, Form, Group
from s2r_spec.diagnose.simulator.axes import EffectAxis, effect_axes
from s2r_spec.diagnose.simulator.bench import Bench, Test, TestRun
from s2r_spec.space import Key, key_of
from s2r_spec.trace import Trace

RESOLUTION = CLEAR * FLOOR
"""Tolerance: part of a channel's range below which a law holds: what is left of the least error that breaks it."""
ITERATIONS = 8
"""Budget: evaluations of a least-squares fit, those for derivatives not counted."""

LITTLE, FARTHEST = 0.1, 1e3
"""Tolerance: units of a size that are a small step, and the most that one step may give."""

Misfit = dict[str, float]
"""Commanded channel → m."""


@dataclass(frozen=True)
class Mistake:
    """A form, the channels that have it, and its size."""

    form: Form
    group: Group
    size: float

    def simplicity(self, theta: Sequence[float]) -> tuple[int, int, bool]:
        """Return what comes first of mistakes that do as well: few sizes, also of the machine, and few channels."""
        sizes = int(self.form.unit > 0.0) + sum(round(abs(size)) for size in theta)
        return sizes, len(self.group), self.size < 0.0


@dataclass(frozen=True, eq=False)
class Parity:
    """Recordings, at tests that may be others than their own, and the law.

    Attributes:
        reach: channel → its usual range.
        machine: the machine's sizes θ.
    """

    bench: Bench
    runs: Sequence[TestRun]
    reach: Mapping[str, float]
    axes: tuple[EffectAxis, ...] = ()
    theta: tuple[float, ...] = ()
    follow: Mapping[str, frozenset[str]] = field(default_factory=dict)
    """Channel → commanded channels that the law computes from it."""
    _kept: dict[tuple[int, Key, tuple[float, ...]], Columns] = field(default_factory=dict)

    @classmethod
    def of(cls, bench: Bench, runs: Sequence[TestRun]) -> Parity:
        """Return the recordings with their ranges, and the effects that bear on the law."""
        names = [one.name for one in bench.backend.channels if one.width == 1]
        there = [name for name in names if all(name in trace for _, trace in runs)]
        reach = {name: float(np.median([np.ptp(trace[name]) for _, trace in runs])) for name in there}
        parity = cls(bench, runs, {name: value for name, value in reach.items() if value > 0.0})
        usual = parity.law(*runs[0])
        axes = []
        for axis in effect_axes(catalogue_of(bench.backend)):
            other = replace(parity, axes=(axis,), theta=(axis.coordinate(axis.at_typical()),)).law(*runs[0])
            if any(not np.array_equal(usual[name], other[name], equal_nan=True) for name in usual):
                axes.append(axis)
        test, trace = runs[0]
        follow = {}
        for moved in parity.reach:
            changed = parity.law(test, trace.with_channels(partial(parity._moved, moved)))
            follow[moved] = frozenset(
                n for n in usual if not np.array_equal(usual[n], changed[n], equal_nan=True)
            )
        return replace(parity, axes=tuple(axes), theta=(0.0,) * len(axes), follow=follow)

    def _moved(self, which: str, name: str, values: FloatArray) -> FloatArray:
        return values + self.reach[which] if name == which else values

    @property
    def sources(self) -> list[Group]:
        """Groups that may share a clock: what the law reads, and each channel with all that follows from it."""
        groups = [{name for name, far in self.follow.items() if far}]
        for name in self.follow:
            group = {name}
            for _ in self.follow:
                group |= {far for near in group for far in self.follow.get(near, ())}
            groups.append(group)
        ordered = [tuple(name for name in self.reach if name in each) for each in groups]
        return [each for each in ordered if 1 < len(each) < len(self.reach)]

    def law(self, test: Test, trace: Trace) -> Columns:
        """Return what the law gives for a recording."""
        values: dict[str, dict[str, float]] = {}
        for axis, size in zip(self.axes, self.theta, strict=True):
            if size:
                values.setdefault(axis.effect, {})[axis.parameter] = axis.value(size)
        backend = self.bench.backend
        backend = backend.with_effects(values) if values and isinstance(backend, HasEffects) else backend
        assert isinstance(backend, HasControlLaw)
        return dict(backend.commands(trace, self.bench.matched.to_backend(dict(test))).channels)

    def _own_law(self, test: Test, trace: Trace) -> Columns:
        """Return what the law gives for a recording as it is, computed once."""
        key = id(trace), key_of(test), self.theta
        if key not in self._kept:
            self._kept[key] = self.law(test, trace)
        return self._kept[key]

    def errors(self, mistake: Mistake | None = None) -> list[Columns]:
        """Return e of every recording, in usual ranges or its own, if larger; NaN where nothing is known."""
        out = []
        for test, trace in self.runs:
            recorded = {name: trace[name] for name in self.reach}
            undone, lost = trace, np.zeros(len(trace), bool)
            if mistake is not None:
                form, group = mistake.form, mistake.group
                was = form.change(recorded, trace, group, form.undone(mistake.size))
                for name, values in was.items():
                    lost |= ~np.isfinite(values)
                    was[name] = _filled(values)
                undone = trace.with_channels(was.get)
            if mistake is not None and any(self.follow[name] for name in mistake.group):
                law = self.law(test, undone)
            else:
                law = self._own_law(test, trace)
            law = {name: np.where(lost, np.nan, values) for name, values in law.items()}
            known = {name: law.get(name, np.full(len(trace), np.nan)) for name in recorded}
            if mistake is not None:
                known |= mistake.form.change(known, trace, mistake.group, mistake.size)
            ranges = {name: max(reach, float(np.ptp(recorded[name]))) for name, reach in self.reach.items()}
            error = {name: (recorded[name] - known[name]) / ranges[name] for name in recorded}
            out.append({name: values for name, values in error.items() if np.isfinite(values).any()})
        return out

    def vector(self, mistake: Mistake | None, weights: Misfit) -> FloatArray:
        """Return e of all recordings and channels, one after the other, over ``weights``; 0 where nothing is known."""
        parts = [
            np.nan_to_num(each.get(name, np.ones(len(trace)))) / weights[name]
            for each, (_, trace) in zip(self.errors(mistake), self.runs, strict=True)
            for name in self.reach
            if name in weights
        ]
        return np.concatenate(parts)

    def step(self, form: Form, group: Group) -> Mistake:
        """Return the mistake whose size one step of least squares gives, from none on."""
        little = form.at(LITTLE)
        weights = misfit(self.errors())
        none, some = self.vector(None, weights), self.vector(Mistake(form, group, little), weights)
        slope = some - none
        best = -LITTLE * float(none @ slope) / max(float(slope @ slope), 1e-300)
        return Mistake(form, group, form.at(float(np.clip(best, -FARTHEST, FARTHEST)) or LITTLE))

    def fit(self, mistake: Mistake | None = None, machine: bool = True) -> tuple[Parity, Mistake | None]:
        """Return the least-squares size of a mistake, and θ if ``machine``."""
        from scipy.optimize import least_squares

        form = mistake.form if mistake is not None and mistake.form.unit else None
        axes = self.axes if machine else ()
        if form is None and not axes:
            return self, mistake
        weights = misfit(self.errors(mistake))

        def moved(x: FloatArray) -> tuple[Parity, Mistake | None]:
            numbers = x.tolist()
            other = (
                replace(mistake, size=form.at(numbers.pop(0))) if mistake is not None and form else mistake
            )
            return replace(self, theta=tuple(numbers)) if axes else self, other

        def left(x: FloatArray) -> FloatArray:
            parity, other = moved(x)
            return parity.vector(other, weights)

        first = [] if mistake is None or form is None else [form.coordinate(mistake.size)]
        ends = [(-np.inf, np.inf) for _ in first] + [axis.ends for axis in axes]
        x = np.array([*first, *(self.theta if axes else ())])
        done = least_squares(left, x, bounds=np.array(ends).T, diff_step=1e-3, max_nfev=ITERATIONS)
        return moved(done.x)


def _filled(values: FloatArray) -> FloatArray:
    """Return values whose gaps keep the nearest; a law may remember."""
    known = np.flatnonzero(np.isfinite(values))
    return np.asarray(np.interp(np.arange(len(values)), known, values[known])) if known.size else values


def alike(errors: Sequence[Columns], others: Sequence[Columns]) -> list[Columns]:
    """Return errors at the samples at which others are known, too; where one is read between samples, ends are not."""
    return [
        {
            name: values if name not in other else np.where(np.isfinite(other[name]), values, np.nan)
            for name, values in each.items()
        }
        for each, other in zip(errors, others, strict=True)
    ]


def closeness(errors: Sequence[Columns]) -> float:
    """Return minus the sum of the logarithms of the rms errors."""
    names = dict.fromkeys(name for each in errors for name in each)
    squares = [np.nanmean([np.nanmean(each[name] ** 2) for each in errors if name in each]) for name in names]
    return -float(np.log(np.array(squares) + RESOLUTION**4).sum())


def misfit(errors: Sequence[Columns], sign: float = 1.0) -> Misfit:
    """Return m of every channel with an error, at most (``sign`` = 1) or at least (−1)."""
    out = {}
    for name in dict.fromkeys(name for each in errors for name in each):
        every = [each[name] for each in errors if name in each]
        pairs = np.concatenate([values[1:] * values[:-1] for values in every])
        pairs, squares = pairs[np.isfinite(pairs)], np.concatenate(every) ** 2
        squares = squares[np.isfinite(squares)]
        if pairs.size:
            noise = 2.0 * squares.mean() / np.sqrt(squares.size)
            out[name] = float(np.sqrt(max(pairs.mean() + sign * noise, RESOLUTION**2)))
    return out
