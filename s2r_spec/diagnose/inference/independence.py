"""How many independent numbers the scatter of runs has, in a group of observables and in all of them.

Data: R nominal runs of each experiment, with different seeds. Unknown: N_g, the effective number of independent errors
of every kind of group, and N, that of all groups of an experiment. Where a chaotic gait comes a little late, all its
channels differ at once, so that N is far below Σ N_g. Model: the difference of two runs has errors of covariance C.
Two differences without a common run have a squared cosine of tr C²/(tr C)² = 1/N on average. Estimator:

    1/N_g = mean squared cosine over such pairs of differences, in all experiments of one kind of motion
    1/N   = the same of all groups joined, each with the weight N_g and its mean square as unit

A likelihood of groups as if they were independent counts the same errors Σ N_g/N times. So group g has N_g N/Σ N_g.

Units: dimensionless. Shapes: n observables and G groups of an experiment.
Source: Satterthwaite, *Biometrics Bulletin* 2 (1946) 110 (N); Pauli, Racugno & Ventura, *Statistica Sinica* 21 (2011)
149 (a composite likelihood to the power N/Σ N_g).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.observation import Observation

TINY = 1e-24
"""Tolerance: a squared length below it is that of no difference."""


def independent_numbers(observations: Sequence[Observation]) -> list[FloatArray]:
    """Return (G,) N_g N/Σ N_g of the groups of each observation; N_g of practice machines where runs do not scatter."""
    apart = [_differences(one) for one in observations]
    numbers = _by_kind(observations, apart)
    sizes = [
        np.array([numbers.get((one.response.experiment.protocol, name), n) for name, n in _known(one)])
        for one in observations
    ]
    joined: dict[str, list[float]] = {}
    for one, (rows, disjoint), size in zip(observations, apart, sizes, strict=True):
        scaled = np.zeros_like(rows)
        for (_, places), n in zip(one.parts, size.tolist(), strict=True):
            own = rows[:, places]
            scaled[:, places] = own * np.sqrt(n / max(float((own**2).sum()), TINY))
        if (square := squared_cosine(scaled, disjoint)) is not None:
            joined.setdefault(one.response.experiment.protocol, []).append(square * float(size.sum()))
    return [
        size / max(float(np.mean(joined.get(one.response.experiment.protocol, [1.0]))), 1.0)
        for one, size in zip(observations, sizes, strict=True)
    ]


def squared_cosine(rows: FloatArray, disjoint: NDArray[np.bool_]) -> float | None:
    """Return the mean squared cosine of (P, n) differences, over pairs of a (P, P) mask; None without any."""
    length = np.sqrt((rows**2).sum(axis=1))
    known = disjoint & np.outer(length**2 > TINY, length**2 > TINY)
    if not known.any():
        return None
    direction = rows / np.maximum(length, np.sqrt(TINY))[:, None]
    return float(((direction @ direction.T) ** 2)[known].mean())


def _differences(one: Observation) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (P, n) differences of all pairs of nominal runs, in units of scatter, and which two have no common run."""
    runs = one.response.runs[:, one.kept]
    scatter = one.response.scatter[one.kept]
    rows = np.divide(runs, scatter, out=np.zeros_like(runs), where=scatter**2 > TINY)
    rows = rows[np.isfinite(rows).all(axis=1)]
    pairs = list(combinations(range(len(rows)), 2))
    differences = np.array([rows[i] - rows[j] for i, j in pairs]).reshape(len(pairs), rows.shape[1])
    disjoint = np.array([[not {*a} & {*b} for b in pairs] for a in pairs], dtype=bool)
    return differences, disjoint.reshape(len(pairs), len(pairs))


def _known(one: Observation) -> list[tuple[tuple[str, str], float]]:
    """Return kind and N_g by practice machines of every group."""
    return [(name, n) for (name, _), n in zip(one.parts, one.effective.tolist(), strict=True)]


def _by_kind(
    observations: Sequence[Observation], apart: Sequence[tuple[FloatArray, NDArray[np.bool_]]]
) -> Mapping[tuple[str, tuple[str, str]], float]:
    """Return N_g by protocol and kind of group, at least 1 and at most the numbers of a group."""
    squares: dict[tuple[str, tuple[str, str]], list[float]] = {}
    for one, (rows, disjoint) in zip(observations, apart, strict=True):
        for name, places in one.parts:
            if (square := squared_cosine(rows[:, places], disjoint)) is not None:
                key = one.response.experiment.protocol, name
                squares.setdefault(key, []).append(max(square, 1.0 / places.size))
    return {key: 1.0 / min(float(np.mean(own)), 1.0) for key, own in squares.items()}
