"""What the errors of one-step predictions have in common with the past: observables that a closed loop does not hide.

Data: samples x_n (C,) of all channels of nominal runs, at N + 1 equal times. Model, with its parameters β_j from these
runs, for every channel j:

    x_{n+1,j} − x_{n,j} = β_jᵀ φ_{j,n} + e_{j,n}

φ has a constant, and the samples of up to three channels at lags up to :data:`LAGS`: those that predict channel j best.
The observables of a trace are its own changes of β_j, in units in which they have the covariance 1 in nominal runs:

    z_j = (G_0/var(e_j))^{1/2} G^{-1} Σ_n φ_{j,n} e_{j,n},   G = Σ_n φφᵀ of the trace, G_0 that of nominal runs

A delay, a lag or a gain between a command and a motion moves them, however the controller reacts to it. They are nearly
linear in its size. The mean motion of a closed loop is not, and scatters more.

Shapes: C columns of all channels, m_j observables of column j.
Source: Ljung, *System Identification*, 2nd ed. (1999), §16.6 (errors and past inputs); Gallant & Tauchen, *Econometric
Theory* 12 (1996) 657 (a simple model's parameters as observables of a simulator).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.least_squares import solved

SAMPLES = 1000
"""Budget: most samples of a trace."""
LAGS = (0, 1, 2, 3, 4, 6, 8, 12, 16)
"""Definition: lags of the regressors, in samples."""
INPUTS = 3
"""Budget: channels in the regressors of one channel."""
NEAREST = 16
"""Budget: channels that are tried beside the first one: those that predict best alone."""
GAIN = 0.03
"""Tolerance: least part of the error that a further channel removes."""
RIDGE = 1e-9
"""Tolerance: regularisation, and the least eigenvalue of Σ φφᵀ that counts, as a part of the largest."""

NOISY = 4
"""Budget: traces with more noise, of which the mean shows what noise does."""
LEAST = 0.1
"""Tolerance: excitation, as a part of that in nominal runs, below which a direction of β is not resolved."""
BLOCKS = 20
"""Definition: parts of a trace, each longer than the noise of a run is correlated."""
WHOLE = 0.9
"""Tolerance: part of the samples from which on a trace counts as whole."""


@dataclass(frozen=True, eq=False)
class Predictor:
    """The prediction of one column.

    Attributes:
        inputs: columns in the regressors.
        weights: (p,) β.
        whitening: (m_j, p) from Σ φ e of a whole trace to the observables.
        error: variance of e in nominal runs.
    """

    inputs: tuple[int, ...]
    weights: FloatArray
    whitening: FloatArray
    error: float

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """(p,) places of its regressors among those of all columns."""
        return _places(self.inputs)

    def gram(self, excited: FloatArray) -> FloatArray:
        """Return (m_j, m_j) G in units of G_0, at least a tenth of it, from (n, m_j) regressors."""
        return np.asarray(self.error * excited.T @ excited + LEAST * np.eye(excited.shape[1]))

    def solved(self, excited: FloatArray, error: FloatArray) -> FloatArray:
        """Return (m_j,) the changes of β in units of their scatter, from (n, m_j) regressors and (n,) errors."""
        return self.equations(excited, excited.T @ error)

    def equations(self, excited: FloatArray, moments: FloatArray) -> FloatArray:
        """Return G⁻¹ b in these units, from (n, m_j) regressors and (m_j,) or (m_j, k) b."""
        return solved(self.gram(excited), moments, LEAST)


@dataclass(frozen=True, eq=False)
class Innovations:
    """The predictions of all columns, from nominal runs.

    Attributes:
        intervals: N of a whole trace.
        mean, scale: (C,) of the samples.
        predictors: column → its prediction; a column that never changes has none.
    """

    intervals: int
    mean: FloatArray
    scale: FloatArray
    predictors: dict[int, Predictor]

    @classmethod
    def of_nominal(cls, traces: Sequence[FloatArray]) -> Self:
        """Return the predictions from (n, C) samples of whole nominal runs."""
        samples = [x[_rows(len(x), min(len(x), SAMPLES + 1))] for x in traces]
        every = np.concatenate(samples)
        mean, scale = every.mean(axis=0), every.std(axis=0) + 1e-12
        pairs = [_regressors((x - mean) / scale) for x in samples if len(x) > 2 * LAGS[-1]]
        if not pairs:
            return cls(0, mean, scale, {})
        past, change = (np.concatenate(each) for each in zip(*pairs, strict=True))
        gram, moment, energy = past.T @ past, past.T @ change, (change**2).sum(axis=0)
        predictors = {}
        for j in np.flatnonzero(energy > RIDGE * len(past)).tolist():
            inputs, left = _inputs(gram, moment[:, j], energy[j])
            if inputs:
                places = _places(inputs)
                own, error = gram[np.ix_(places, places)], left / len(past)
                values, vectors = np.linalg.eigh(own * error / len(pairs))
                whole = values > RIDGE * values[-1]
                whitening = (vectors[:, whole] / np.sqrt(values[whole])).T
                predictors[j] = Predictor(inputs, _solved(own, moment[places, j]), whitening, error)
        return cls(min(len(x) for x in samples) - 1, mean, scale, predictors)

    def size(self, columns: slice) -> int:
        """Return the number of observables of some columns."""
        return sum(len(one.whitening) for j, one in self.predictors.items() if j in _range(columns))

    def of(self, x: FloatArray, times: FloatArray, duration: float) -> dict[int, FloatArray]:
        """Return column → its observables, from (n, C) samples; NaN of a trace that is short or has few samples."""
        seen = self._seen(x, times, duration)
        if seen is None:
            return {j: np.full(len(one.whitening), np.nan) for j, one in self.predictors.items()}
        return {j: (1.0 + LEAST) * one.solved(*_own(one, j, *seen)) for j, one in self.predictors.items()}

    def scatter(self, x: FloatArray, times: FloatArray, duration: float) -> dict[int, FloatArray]:
        """Return column → the variance of its observables, from how errors of :data:`BLOCKS` parts of a trace differ.

        The errors are those that the trace's own β leaves. So neither an effect nor the colour of the noise matters.
        """
        seen, found = self._seen(x, times, duration), {}
        if seen is None:
            return {}
        for j, one in self.predictors.items():
            excited, error = _own(one, j, *seen)
            if not (np.isfinite(excited).all() and np.isfinite(error).all()):
                continue
            error = error - excited @ (one.error * one.solved(excited, error))
            parts = np.array_split(np.arange(len(error)), BLOCKS)
            scores = np.array([excited[part].T @ error[part] for part in parts])
            each = one.equations(excited, scores.T)
            found[j] = np.asarray((1.0 + LEAST) ** 2 * BLOCKS / (BLOCKS - 1.0) * (each**2).sum(axis=1))
        return found

    def _seen(
        self, x: FloatArray, times: FloatArray, duration: float
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return regressors and changes of a trace, as :func:`_regressors`; None of a short one or few samples."""
        if not self.predictors:
            return None
        count = self.intervals + 1
        rows = np.searchsorted(times, np.linspace(0.0, duration, count) - 0.5 * duration / self.intervals)
        rows = np.unique(np.minimum(rows, len(times) - 1))
        if len(rows) < WHOLE * count:
            return None
        return _regressors((x[rows] - self.mean) / self.scale)

    def shift(
        self, x: FloatArray, times: FloatArray, duration: float, variance: FloatArray
    ) -> dict[int, FloatArray]:
        """Return column → by how much white noise moves its observables, (C,) of this variance in (n, C) samples."""
        rng, before = np.random.default_rng(np.random.SeedSequence(0)), self.of(x, times, duration)
        noise = np.sqrt(variance) * rng.normal(size=(NOISY, *x.shape))
        after = [self.of(x + one, times, duration) for one in noise]
        return {j: np.mean([one[j] - own for one in after], axis=0) for j, own in before.items()}

    def to_json(self) -> dict[str, Any]:
        """Return it as lists."""
        each = {
            j: (p.inputs, p.weights.tolist(), p.whitening.tolist(), p.error)
            for j, p in self.predictors.items()
        }
        return {
            "intervals": self.intervals,
            "mean": self.mean.tolist(),
            "scale": self.scale.tolist(),
            "each": each,
        }

    @classmethod
    def from_json(cls, stored: dict[str, Any]) -> Self:
        """Return it from lists."""
        predictors = {
            int(j): Predictor(tuple(inputs), np.array(weights), np.array(whitening), error)
            for j, (inputs, weights, whitening, error) in stored["each"].items()
        }
        return cls(stored["intervals"], np.array(stored["mean"]), np.array(stored["scale"]), predictors)


def _rows(have: int, count: int) -> NDArray[np.int64]:
    return np.round(np.linspace(0, have - 1, count)).astype(np.int64)


def _regressors(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (n, 1 + C lags) a constant and the past of every column, and (n, C) the next changes."""
    first, count = LAGS[-1], len(x) - 1 - LAGS[-1]
    past = np.stack([x[first - lag : first - lag + count] for lag in LAGS], axis=2)
    return np.column_stack([np.ones(count), past.reshape(count, -1)]), np.diff(x, axis=0)[first:]


def _own(one: Predictor, j: int, past: FloatArray, change: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (n, m_j) regressors in units of their scatter, and (n,) errors of nominal β, of column j."""
    own = past[:, one.places]
    return own @ one.whitening.T, change[:, j] - own @ one.weights


def _places(inputs: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate([[0], *(1 + len(LAGS) * i + np.arange(len(LAGS)) for i in inputs)]).astype(np.int64)


def _solved(gram: FloatArray, moment: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(gram + RIDGE * np.trace(gram) * np.eye(len(gram)), moment))


def _inputs(gram: FloatArray, moment: FloatArray, energy: float) -> tuple[tuple[int, ...], float]:
    """Return the columns that predict best, by forward selection, and the energy of the errors that they leave."""
    chosen: tuple[int, ...] = ()
    left, others = float(energy), [*range((len(gram) - 1) // len(LAGS))]
    for _ in range(INPUTS):
        tried = {}
        for i in others:
            places = _places((*chosen, i))
            own = moment[places]
            tried[i] = float(energy - own @ _solved(gram[np.ix_(places, places)], own))
        others = sorted(tried, key=lambda i: tried[i])[:NEAREST]
        if not others or tried[others[0]] > (1.0 - GAIN) * left:
            break
        best = others.pop(0)
        chosen, left = (*chosen, best), tried[best]
    return chosen, max(left, RIDGE * float(energy))


def of_columns(each: Mapping[int, FloatArray], columns: slice) -> FloatArray:
    """Return the observables of some columns, from column → its observables."""
    return np.concatenate([each[j] for j in _range(columns) if j in each] or [np.zeros(0)])


def _range(columns: slice) -> range:
    return range(columns.start, columns.stop)
