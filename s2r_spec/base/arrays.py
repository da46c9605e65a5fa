"""Types of arrays: numbers, indices and truth values."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]


def median(values: FloatArray) -> float:
    """Return numpy's median of (n,) numbers, n ≥ 1; numpy itself would load its masked arrays for it."""
    if np.isnan(values).any():
        return float("nan")
    middle = values.size // 2
    if values.size % 2:
        return float(np.partition(values, middle)[middle])
    low, high = np.partition(values, (middle - 1, middle))[middle - 1 : middle + 1]
    return (float(low) + float(high)) / 2
