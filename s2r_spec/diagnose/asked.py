"""How large effects are, by what the equations of motion ask for.

What a closed loop does hangs on all of the machine at once: where its every number is a little off, a fit to it gets
sizes that are too small, for a little of everything else takes a part. The coordinates that the equations ask for
(:mod:`s2r_spec.diagnose.equations`) are each of one effect, and much the same at every test; the bank says how they go
with the effects' values. Their means over the rollouts say how large an effect is that was named by all of the data.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.bank import Bank
from s2r_spec.diagnose.evidence import ALLOWED, FORM, LARGE
from s2r_spec.diagnose.models import seen_from

FloatArray = NDArray[np.float64]

STEP = 0.1
"""Of a coordinate, to either side, for a slope."""
ROUNDS = 12
"""Of Newton's method, each but the first by half of its step."""
UNKNOWN = 3.0
"""Standard deviation of a coordinate of which nothing else is known."""
LOOKS = 2
"""At the simulator, for what effects do together."""


@dataclass(frozen=True)
class Curve:
    """What one line of the catalogue does to the mean coordinates: (g,) its own, rising, and (g, p) theirs."""

    line: Line
    at: FloatArray
    change: FloatArray

    def __call__(self, x: float) -> FloatArray:
        """Return (p,) change at a coordinate of the line, no further than its ends."""
        x = float(np.clip(x, self.at[0], self.at[-1]))
        return np.array([np.interp(x, self.at, column) for column in self.change.T])

    def secant(self, asked_for: float | None) -> FloatArray:
        """Return (p,) change per unit of the line's coordinate, between nominal and what is asked for.

        Of a line that has no coordinate of its own that is where it is large, on the longer side of its range.
        """
        low, high = float(self.at[0]), float(self.at[-1])
        x = seen_from((LARGE if high >= -low else -LARGE) if asked_for is None else asked_for, low, high)
        return np.asarray(self(x) / x)

    def slope(self, x: float) -> FloatArray:
        """Return (p,) change per unit of the line's coordinate."""
        low, high = np.clip((x - STEP, x + STEP), self.at[0], self.at[-1])
        # Of a line every value of which fell, only the nominal one is known.
        found: FloatArray = (self(high) - self(low)) / max(high - low, 1e-9)
        return found


@dataclass(frozen=True)
class Asked:
    """The bank, as far as the equations see it.

    Attributes:
        names: (p,) which parameter each coordinate is of, effect and parameter with a dot.
        nominal: (p,) of the nominal simulator.
        curves: one a line of the bank, but for those that only say how another acts.
        turns: these: what they add to their effect where it is typically large.
        numerics: (variants, p) change when the same physics is computed otherwise.
    """

    names: tuple[str, ...]
    nominal: FloatArray
    curves: tuple[Curve, ...]
    numerics: FloatArray
    turns: tuple[Curve, ...] = ()

    @classmethod
    def of(cls, bank: Bank) -> Asked:
        """Pool the bank's tests: at each there is one rollout of a value."""
        columns = asked_columns(bank)
        curves: dict[str, Curve] = {}
        turns = []
        for line, change in zip(bank.lines, bank.changes, strict=True):
            values = np.array([line.coordinate(value) for value in line.values])
            seen = pooled(change[..., columns], bank.weights)
            if line.base:
                # What it does hangs on how much there is of its effect: no curve of its own.
                seen = seen - sum(
                    _at_base(curves[f"{line.effect}.{name}"], value) for name, value in line.base.items()
                )
                turns.append(Curve(line, *_straight(values, seen)))
            else:
                curves[line.name] = Curve(line, *_straight(values, seen))
        names = bank.features.names()
        return cls(
            tuple(names[k - 1].block for k in columns),
            pooled(_mean(bank.nominal[..., columns]), bank.weights),
            tuple(curves.values()),
            np.nan_to_num(pooled(bank.variants[..., columns], bank.weights)),
            tuple(turns),
        )

    def spread(self, seen: FloatArray, effects: Sequence[str], error: float) -> FloatArray:
        """Return (p, p) covariance of (p,) mean coordinates with these effects as causes, and of all others a little.

        Args:
            seen: they, less nominal.
            effects: names of the causes.
            error: standard deviation of what no effect explains of a coordinate; a part of it, FORM, comes to it.
        """
        little = [ALLOWED * curve.slope(0.0) for curve in self.curves if curve.line.effect not in effects]
        rows = np.array([*little, *self.numerics]).reshape(-1, len(seen))
        found: FloatArray = rows.T @ rows + np.diag(error**2 + (FORM * seen) ** 2 + self.across(seen))
        return found

    def across(self, seen: FloatArray) -> FloatArray:
        """Return (p,) variance of what effects, each as large as its own coordinate says, make of the others'.

        On a machine of another code that is off by as much as it is, and may be of the other sign. Believed, it makes
        an effect much smaller than its own coordinate says.
        """
        found = np.zeros(len(seen))
        for curve in self.curves:
            if curve.line.name in self.names:
                own = self.names.index(curve.line.name)
                there = curve.secant(seen[own]) * seen[own]
                found += np.where(np.arange(len(seen)) == own, 0.0, there) ** 2
        return found

    def fitted(
        self, seen: FloatArray, effects: Sequence[str], error: float, before: FloatArray, variance: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return how large effects are: coordinates (n,) of their lines, and covariance (n, n).

        Where the effects leave more than they should of all coordinates together, each is believed so much less. Where
        all other data have a size that the equations do not, those are believed less: a law a little off moves a whole
        closed loop, and a little of everything takes its part of what a cause does.

        Args:
            seen: (p,) mean coordinates, less nominal.
            effects: names of the causes; the lines are :meth:`lines` of them.
            error: see :meth:`spread`.
            before: (n,) coordinates, as all other data have them.
            variance: (n,) of these.
        """
        mine = self.lines(effects)
        weigh: FloatArray = np.asarray(np.linalg.inv(self.spread(seen, effects, error)), dtype=np.float64)
        unknown = np.maximum(variance, UNKNOWN**2)
        x, left, slopes = self.nearest(seen, mine, weigh, before, unknown)
        weigh = weigh / max(float(left @ weigh @ left) / len(seen), 1.0)
        alone = np.diag(np.linalg.inv(slopes @ weigh @ slopes.T + np.diag(1.0 / unknown)))
        variance = np.maximum(variance, (x - before) ** 2 - alone)
        x, _, slopes = self.nearest(seen, mine, weigh, before, variance)
        inner = slopes @ weigh @ slopes.T + np.diag(1.0 / variance)
        return x, np.asarray(np.linalg.inv(inner), dtype=np.float64)

    def lines(self, effects: Sequence[str]) -> list[Curve]:
        """Return the curves of these effects, in the bank's order."""
        return [curve for curve in self.curves if curve.line.effect in effects]

    def nearest(
        self,
        seen: FloatArray,
        mine: Sequence[Curve],
        weigh: FloatArray,
        before: FloatArray,
        variance: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (n,) the likeliest coordinates, (p,) what they leave of what was seen, and (n, p) slopes there."""
        lower = np.array([curve.at[0] for curve in mine])
        upper = np.array([curve.at[-1] for curve in mine])
        known = np.diag(1.0 / variance)
        x = np.clip(before, lower, upper)
        for again in range(ROUNDS):
            there, slopes = self._at(x, mine)
            inner = slopes @ weigh @ slopes.T + known
            aim = np.linalg.solve(inner, slopes @ weigh @ (seen - there + x @ slopes) + known @ before)
            x = np.clip((x + aim) / 2.0 if again else aim, lower, upper)
        there, slopes = self._at(x, mine)
        return x, seen - there, slopes

    def _at(self, x: FloatArray, mine: Sequence[Curve]) -> tuple[FloatArray, FloatArray]:
        """Return (p,) what these lines do there together, and (n, p) slopes."""
        p = len(self.names)
        each = np.array([curve(c) for curve, c in zip(mine, x, strict=True)]).reshape(-1, p)
        slopes = np.array([curve.slope(c) for curve, c in zip(mine, x, strict=True)]).reshape(-1, p)
        return each.sum(axis=0), slopes


@dataclass(frozen=True)
class Heard:
    """What the equations ask for at one machine.

    Attributes:
        asked: the bank.
        columns: (p,) where the coordinates are in a row.
        seen: (p,) mean coordinates over its rollouts, less those of the nominal simulator at the same tests.
        error: standard deviation of what no effect explains of one.
    """

    asked: Asked
    columns: NDArray[np.intp]
    seen: FloatArray
    error: float

    @classmethod
    def of(
        cls, bank: Bank, rows: FloatArray, nominal: FloatArray, error: float, weights: FloatArray
    ) -> Heard | None:
        """Pool n rollouts; None where nothing is asked, or not of one of them.

        Args:
            bank: of the simulator.
            rows: (n, 1 + p) of the machine.
            nominal: (n, 1 + p) of the simulator at the same tests.
            error: of a coordinate.
            weights: (n, q, q) of the q coordinates at these tests.
        """
        columns = asked_columns(bank)
        apart = (rows - nominal)[:, columns]
        if not columns.size or not np.isfinite(apart).all(axis=1).any():
            return None
        return cls(Asked.of(bank), columns, pooled(apart, weights), error)

    @property
    def effects(self) -> frozenset[str]:
        """Return the effects of which a coordinate says something: it moves by more than its error."""
        place = {name: k for k, name in enumerate(self.asked.names)}
        return frozenset(
            curve.line.effect
            for curve in self.asked.curves
            if (name := f"{curve.line.effect}.{curve.line.parameter}") in place
            and np.abs(curve.change[:, place[name]]).max() > self.error
        )

    def sized(
        self,
        effects: Sequence[str],
        before: FloatArray,
        variance: FloatArray,
        simulated: Callable[[FloatArray], FloatArray],
        weights: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return how large effects are: coordinates (n,) of their lines, and covariance (n, n).

        The bank has one effect at a time. What several do together is put right by the simulator itself, where the
        data have them and again where the equations move them to.

        Args:
            effects: names of the causes.
            before: (n,) coordinates, as all other data have them.
            variance: (n,) of these.
            simulated: from (n,) coordinates to (rollouts, 1 + p) change of the simulator's rows from nominal.
            weights: (rollouts, q, q) of the coordinates that the equations ask for in these.
        """
        mine = self.asked.lines(effects)
        x, covariance = before, np.diag(variance)
        for _ in range(LOOKS):
            there = pooled(simulated(x)[:, self.columns], weights)
            alone = np.sum([curve(c) for curve, c in zip(mine, x, strict=True)], axis=0)
            # Where these effects make every rollout fall, only the bank knows what they do.
            together = np.nan_to_num(there - alone)
            x, covariance = self.asked.fitted(self.seen - together, effects, self.error, before, variance)
        return x, covariance


def _at_base(curve: Curve, value: float) -> FloatArray:
    """Return (p,) what the line that holds another off nominal does by itself."""
    return curve(curve.line.coordinate(value))


def asked_columns(bank: Bank) -> NDArray[np.intp]:
    """Return the columns of the bank's rows that the equations of motion ask for; the first column is ρ."""
    names = bank.features.names()
    return np.array([1 + k for k, f in enumerate(names) if f.statistic == "equation"], dtype=np.intp)


def _straight(at: FloatArray, change: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (g + 1,) coordinates, rising, with nominal among them, and (g + 1, p) changes.

    Of a value at which every rollout fell, that is what the next one towards nominal makes of it, by proportion: the
    equations ask for about as much as there is.
    """
    there = np.asarray(np.isfinite(change).all(axis=1))
    filled = np.where(there[:, None], change, 0.0)
    for k in np.flatnonzero(~there):
        nearer = np.flatnonzero(there & (at * at[k] > 0) & (np.abs(at) < abs(at[k])))
        if len(nearer):
            last = nearer[np.abs(at[nearer]).argmax()]
            filled[k] = change[last] * at[k] / at[last]
    whole = np.append(at, 0.0)
    order = np.argsort(whole)
    return np.asarray(whole[order]), np.vstack([filled, np.zeros(change.shape[1])])[order]


def pooled(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return (..., q) one estimate from (..., m, q) of m tests, by (m, q, q) weights; of those that are finite.

    Ridge regressions of one rollout each, each weighed by what its rollout says: that is the regression of all of
    them at once. Mass and motor gain are the same in one test; a payload that differs between tests tells them apart.
    """
    there = np.asarray(np.isfinite(values).all(axis=-1))
    total = np.einsum("mij,...mj->...i", weights, np.where(there[..., np.newaxis], values, 0.0))
    whole = np.einsum("...m,mij->...ij", there.astype(np.float64), weights)
    some = np.asarray(there.any(axis=-1))
    whole = np.where(some[..., np.newaxis, np.newaxis], whole, np.eye(values.shape[-1]))
    found = np.linalg.solve(whole, total[..., np.newaxis])[..., 0]
    return np.asarray(np.where(some[..., np.newaxis], found, np.nan))


def _mean(values: FloatArray) -> FloatArray:
    """Return (..., p) means of (..., m, p), of those that are finite."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # where every rollout fell there is none
        return np.asarray(np.nanmean(values, axis=-2))
