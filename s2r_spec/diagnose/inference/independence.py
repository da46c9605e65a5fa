"""How many independent numbers the scatter of runs has, in a group of observables and in all of them.

Data: R nominal runs of each experiment, with different seeds. Unknown: N_g, the effective number of independent errors
of every kind of group, and N, that of all groups of an experiment. Where a chaotic gait comes a little late, all its
channels differ at once, so that N is far below Σ N_g. Model: x_i, the difference of two runs, has errors of covariance
C. Of two differences without a common run, E (x_i·x_j)² = 2² tr C² and E |x_i|²|x_j|² = 2² (tr C)². Estimator:

    N_g = Σ |x_i|²|x_j|² / Σ (x_i·x_j)²     sums over such pairs, in all experiments of one kind of motion
    N   = the same of all groups joined, each with the weight N_g and its mean square as unit

N_g is at most that of practice machines (:mod:`.additivity`), whose errors of form are smoother than scatter. A
likelihood of groups as if they were independent counts the same errors Σ N_g/N times. So each group has the number
M_g = N_g N/Σ N_g.

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
    """Return (G,) M_g of the groups of each observation; N_g of practice machines where runs do not scatter."""
    apart = [_differences(one) for one in observations]
    numbers = _by_kind(observations, apart)
    sizes = [
        np.array(
            [min(numbers.get((one.response.experiment.protocol, name), n), n) for name, n in _known(one)]
        )
        for one in observations
    ]
    lengths: dict[str, float] = {}
    products: dict[str, float] = {}
    for one, (rows, disjoint), size in zip(observations, apart, sizes, strict=True):
        scaled, total, protocol = np.zeros_like(rows), 0.0, one.response.experiment.protocol
        for (_, places), n in zip(one.parts, size.tolist(), strict=True):
            square = float((rows[:, places] ** 2).sum())
            if square > TINY:
                scaled[:, places], total = rows[:, places] * np.sqrt(n / square), total + n
        if total:
            own = squares(scaled, disjoint)
            lengths[protocol] = lengths.get(protocol, 0.0) + own[0] / total
            products[protocol] = products.get(protocol, 0.0) + own[1]
    times = {protocol: max(products[protocol] / own, 1.0) for protocol, own in lengths.items() if own > TINY}
    return [
        size / times.get(one.response.experiment.protocol, 1.0)
        for one, size in zip(observations, sizes, strict=True)
    ]


def squares(rows: FloatArray, disjoint: NDArray[np.bool_]) -> tuple[float, float]:
    """Return Σ |x_i|²|x_j|² and Σ (x_i·x_j)² of (P, n) differences, over the pairs of a (P, P) mask."""
    products = rows @ rows.T
    lengths = np.diag(products)
    return float(np.outer(lengths, lengths)[disjoint].sum()), float((products**2)[disjoint].sum())


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
    """Return N_g by protocol and kind of group, at least 1."""
    sums: dict[tuple[str, tuple[str, str]], FloatArray] = {}
    for one, (rows, disjoint) in zip(observations, apart, strict=True):
        for name, places in one.parts:
            key = one.response.experiment.protocol, name
            sums[key] = sums.get(key, np.zeros(2)) + squares(rows[:, places], disjoint)
    return {key: max(float(own[0] / own[1]), 1.0) for key, own in sums.items() if own[1] > TINY}
