"""How well a sum of responses predicts a machine: its relative errors, and how many of them are independent.

Data: runs y_j (m,) of practice machines j = 1 … M. Their sizes θ_j and variants φ_j are known
(:mod:`..simulator.response`). Unknown, for every group g: the relative error ρ_g of a sum of responses in its own
direction, κ_g in all others, and the effective number N_g of independent errors. Model, with the sum of responses S_j
at θ_j and the scatter of a run ε:

    y_j − nominal − Bφ_j = (1 + c_j) S_j + e_j + ε,   c_j ~ N(0, ρ_g²),   e_j ~ N(0, κ_g² mean S_j² C),   tr C = n_g

Estimator: c_j is the least-squares slope of the rest on S_j, and |e_j|² what it leaves beyond ε. ρ_g is the median
|c_j| over the machines that move the group, divided by that of a standard normal. κ_g² is the median |e_j|²/|S_j|².
Medians, because a machine that slides or falls has no sum of responses. Both are shrunk towards a prior scale with ν
degrees of freedom (Gelman et al., *Bayesian Data Analysis*, 3rd ed., §2.6). The mean square of n_g correlated errors
varies as that of N_g = n_g²/tr C² independent ones, and two errors of the shape C have a squared cosine of tr C²/n_g²
on average. So 1/N_g is the mean squared cosine over all pairs of machines, whatever the size of an error.

Units: ρ_g, κ_g, N_g dimensionless. Shapes: G groups of n_g observables.
Source: Satterthwaite, *Biometrics Bulletin* 2 (1946) 110.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.hierarchical import DEGREES, LAW_SHARE

MEDIAN = 0.6745
"""Definition: median of |x| of a standard normal x."""
CLEAR = 4.0
"""Tolerance: a machine counts for c_j where the variance of c_j by scatter is below a quarter."""


def relative_errors(
    sums: FloatArray, rest: FloatArray, scatter: FloatArray, parts: Sequence[NDArray[np.int64]]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (G,) ρ_g, (G,) κ_g and (G,) N_g.

    Args:
        sums: (M, n) S_j.
        rest: (M, n) y_j − nominal − Bφ_j − S_j.
        scatter: (M, n) standard deviation of a run of each machine.
        parts: places of every group among the n.
    """
    coherent, other, size = np.empty(len(parts)), np.empty(len(parts)), np.empty(len(parts))
    for g, part in enumerate(parts):
        s, e = sums[:, part] / scatter[:, part], rest[:, part] / scatter[:, part]
        whole = np.isfinite(e).all(axis=1)
        s, e = s[whole], e[whole]
        signal = (s**2).mean(axis=1)
        slope = (s * e).mean(axis=1) / np.maximum(signal, 1e-12)
        errors = e - slope[:, None] * s
        left = (errors**2).mean(axis=1)
        size[g] = effective_number(errors)
        clear = signal * size[g] > CLEAR * np.maximum(left, 1.0)
        coherent[g] = _shrunk((_median(np.abs(slope[clear])) / MEDIAN) ** 2, int(clear.sum()))
        moved = signal > 1.0
        other[g] = _shrunk(_median(np.maximum(left[moved] - 1.0, 0.0) / signal[moved]), int(moved.sum()))
    return np.sqrt(coherent), np.sqrt(other), size


def effective_number(errors: FloatArray) -> float:
    """Return N from (M, n) errors of M machines: the inverse of the mean squared cosine between two of them."""
    length = np.sqrt((errors**2).sum(axis=1))
    direction = errors[length > 0.0] / length[length > 0.0, None]
    machines, n = direction.shape
    if machines < 2:
        return float(n)
    cosine = direction @ direction.T
    squares = ((cosine**2).sum() - machines) / (machines * (machines - 1))
    return float(np.clip(1.0 / squares, 1.0, n))


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else 0.0


def _shrunk(variance: float, number: int) -> float:
    return (DEGREES * LAW_SHARE**2 + number * variance) / (DEGREES + number)
