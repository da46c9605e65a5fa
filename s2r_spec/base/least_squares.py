"""Equations of regularised least squares, also where data hardly move in some directions.

    A x = b,    A = λ 1 + JᵀJ

The condition of A is at most tr A/λ. Up to :data:`CONDITION`, x follows by elimination. Beyond it, rounding makes the
small eigenvalues of A worthless, and elimination can fail. Then x has no part in directions whose eigenvalues rounding
hides: of all x that fit as well, it has the least norm.

Source: Golub & Van Loan, *Matrix Computations*, 4th ed. (2013), §5.5 (minimum norm).
"""

from __future__ import annotations

import numpy as np

from s2r_spec.base.arrays import FloatArray

CONDITION = 1e12
"""Tolerance: condition up to which equations are solved by elimination; x then has four right digits."""


def solved(matrix: FloatArray, right: FloatArray, least: float = 1.0) -> FloatArray:
    """Return x of (k, k) A and (k,) or (k, m) b; ``least`` is λ. NaN where either is not finite."""
    size = np.trace(matrix)
    if not size > CONDITION * least:
        return np.asarray(np.linalg.solve(matrix, right))
    if not (np.isfinite(size) and np.isfinite(right).all()):
        return np.full(right.shape, np.nan)
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def root(matrix: FloatArray, least: float = 1.0) -> FloatArray:
    """Return (k, k) L of (k, k) A = LLᵀ; ``least`` is λ. Eigenvalues that rounding hides are as large as rounding.

    L is triangular only up to :data:`CONDITION`.

    Raises:
        LinAlgError: the diagonal of A has a NaN, for which :func:`solved` returns NaN.
    """
    if np.trace(matrix) <= CONDITION * least:
        return np.asarray(np.linalg.cholesky(matrix))
    values, vectors = np.linalg.eigh(matrix)
    hidden = len(matrix) * np.finfo(float).eps * values[-1]
    return np.asarray(vectors * np.sqrt(np.maximum(values, hidden)))
