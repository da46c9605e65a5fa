"""Sums of exponentials, without scipy at import: ``import s2r_spec`` stays light."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def logsumexp(values: ArrayLike, axis: int | None = None) -> Any:
    """Return log Σ exp(values) along an axis, or over all of them."""
    array = np.asarray(values, dtype=np.float64)
    peak = np.max(array, axis=axis, keepdims=True)
    peak = np.where(np.isfinite(peak), peak, 0.0)
    with np.errstate(divide="ignore"):
        total = np.log(np.exp(array - peak).sum(axis=axis, keepdims=True)) + peak
    return float(total.reshape(())) if axis is None else np.squeeze(total, axis=axis)
