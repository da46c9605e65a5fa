"""Window and until operators on samples, by doubling.

Every function takes arrays of shape (…, n), last axis time, any batch axes
before it, and returns a new array of that shape; no input is changed. There
is no loop over samples: a window of w samples costs log₂ w passes. A window
that reaches past the last sample is cut there; one that lies wholly past it
is empty, with least value +inf and greatest −inf. NaN spreads to every
instant whose window contains it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]


def shift(x: FloatArray, steps: int, fill: float) -> FloatArray:
    """Return y with y[t] = x[t + steps]; ``fill`` where there is no such sample. steps may be negative."""
    n = x.shape[-1]
    y = np.full_like(x, fill)
    if 0 <= steps < n:
        y[..., : n - steps] = x[..., steps:]
    elif -n < steps < 0:
        y[..., -steps:] = x[..., : n + steps]
    return y


def window_min(x: FloatArray, low: int, high: int | None) -> FloatArray:
    """Return y with y[t] = min of x[t + low … t + high].

    Args:
        x: (…, n) samples.
        low: first sample of the window, 0 ≤ low.
        high: last one, low ≤ high; None for the end of the trace.

    Returns:
        (…, n).
    """
    n = x.shape[-1]
    if high is None or high - low >= n - 1:
        y = np.minimum.accumulate(x[..., ::-1], axis=-1)[..., ::-1]
        return shift(y, low, np.inf)
    y = x.copy()
    width, size = high - low + 1, 1  # y[t] is the least of `size` samples from t on
    while size < width:
        # two blocks of one size cover the next one; they may overlap, a minimum does not mind
        step = min(size, width - size)
        y[..., : n - step] = np.minimum(y[..., : n - step], y[..., step:])
        size += step
    return shift(y, low, np.inf) if low else y


def window_max(x: FloatArray, low: int, high: int | None) -> FloatArray:
    """Return y with y[t] = max of x[t + low … t + high]; see :func:`window_min`."""
    return np.negative(window_min(np.negative(x), low, high))


def until(left: FloatArray, right: FloatArray, low: int, high: int | None) -> FloatArray:
    """Return the robustness of ``left until[low, high] right``.

    y[t] = max over t' in t + [low, high] of min(right[t'], min of left[t … t' − 1]).

    The condition that t' = s is the witness, or a later instant is, turns the
    value v of later witnesses into max(right[s], min(left[s], v)): a clamp. Two
    clamps in a row are a clamp, (p, q)∘(p', q') = (min(p, p'), max(q, min(p, q'))),
    so that of a whole window is built by doubling, exactly and for any batch.

    Args:
        left: (…, n) robustness of the condition that holds before the witness.
        right: (…, n) robustness of the witness.
        low: first sample at which the witness may be, 0 ≤ low.
        high: last one; None for the end of the trace.

    Returns:
        (…, n).
    """
    left, right = np.broadcast_arrays(left, right)
    n = left.shape[-1]
    if low > 0:
        rest = until(left, right, 0, None if high is None else high - low)
        return np.minimum(window_min(left, 0, low - 1), shift(rest, low, -np.inf))
    count = n if high is None else min(high + 1, n)
    block_p, block_q = left.copy(), right.copy()  # clamps of `size` samples from t on
    p, q = np.full_like(block_p, np.inf), np.full_like(block_q, -np.inf)  # clamp of `done` samples: none yet
    size, done = 1, 0
    while count:
        if count & 1:
            _compose(p, q, block_p, block_q, done)
            done += size
        count >>= 1
        if count:
            _compose(block_p, block_q, block_p.copy(), block_q.copy(), size)
            size *= 2
    return q


def _compose(p: FloatArray, q: FloatArray, next_p: FloatArray, next_q: FloatArray, step: int) -> None:
    """Let the clamp at t be followed by the next one at t + step, in place; past the end there is none."""
    n = p.shape[-1]
    if step >= n:
        return
    head, tail = (..., slice(0, n - step)), (..., slice(step, None))
    q[head] = np.maximum(q[head], np.minimum(p[head], next_q[tail]))
    p[head] = np.minimum(p[head], next_p[tail])


def range_min(x: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return y with y[k] = min of x[first[k] … last[k]], for windows of any place and length.

    A sparse table: two blocks of a power of two cover a window.

    Args:
        x: (…, n) samples.
        first: (m,) first sample of each window, 0 ≤ first.
        last: (m,) last one, < n; a window with last < first is empty, its least value +inf.

    Returns:
        (…, m).
    """
    lengths = np.maximum(last - first + 1, 0)
    y = np.full((*x.shape[:-1], first.size), np.inf)
    block, size = x, 1  # block[t] is the least of `size` samples from t on
    while True:
        here = np.flatnonzero((lengths >= size) & (lengths < 2 * size))
        if here.size:
            y[..., here] = np.minimum(block[..., first[here]], block[..., last[here] - size + 1])
        if 2 * size > lengths.max(initial=0):
            return y
        block = np.minimum(block[..., : block.shape[-1] - size], block[..., size:])
        size *= 2


def range_until(left: FloatArray, right: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return :func:`until` for a window of witnesses first[t] … last[t] of its own at every sample t.

    With W the untimed until, y[t] = min(least left before first[t], greatest
    right in the window, W[first[t]]): if a witness after the window is good,
    left holds up to it, and any witness in the window is as good as its right.

    Args:
        left: (…, n) robustness of the condition that holds before the witness.
        right: (…, n) robustness of the witness.
        first: (n,) first sample of each window, t ≤ first[t].
        last: (n,) last one, < n; −inf where last < first.

    Returns:
        (…, n).
    """
    left, right = np.broadcast_arrays(left, right)
    n = left.shape[-1]
    guard = range_min(left, np.arange(n), np.minimum(first, n) - 1)
    best = np.negative(range_min(np.negative(right), first, last))
    return np.minimum(np.minimum(guard, best), until(left, right, 0, None)[..., np.minimum(first, n - 1)])
