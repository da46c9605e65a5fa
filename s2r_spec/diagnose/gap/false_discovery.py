"""Control of the false-discovery rate under any dependence: Benjamini and Yekutieli (2001)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def adjusted(p: FloatArray) -> FloatArray:
    """Return adjusted p-values q (n,): the tests with q ≤ α have a false-discovery rate of at most α.

    q_(i) = min over j ≥ i of p_(j) n c / j, with c = Σ_{k ≤ n} 1/k for any dependence.
    """
    n = p.size
    if n == 0:
        return p
    order = np.argsort(p)
    rank = np.arange(1, n + 1)
    scaled = p[order] * n * (1.0 / rank).sum() / rank
    found = np.empty(n)
    found[order] = np.minimum(np.minimum.accumulate(scaled[::-1])[::-1], 1.0)
    return found
