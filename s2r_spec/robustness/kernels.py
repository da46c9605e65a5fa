"""Window and until operators on samples, by doubling.

Every function takes arrays of shape (…, n), time last, and returns a new array of that shape. There is no loop over
samples: a window of w samples costs log₂ w passes, each over a piece of the trace that stays in the processor's
cache. A window that reaches past the last sample is cut there. One that lies wholly past it is empty, with minimum
+inf and maximum −inf. NaN spreads to every instant whose window contains it.
"""

from __future__ import annotations

import numpy as np

from s2r_spec.base.arrays import FloatArray, IntArray
from s2r_spec.robustness.pieces import pieces

PIECE = 1 << 16
"""Budget: samples in one pass, half a megabyte, the size of a processor's second-level cache."""
RUN = 1 << 12
"""Budget: the same for an unbounded until, for which fewer samples take fewer passes."""


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
    """Return (…, n) y with y[t] = min of x[t + low … t + high], 0 ≤ low ≤ high; None is the end of the trace."""
    return _window(np.minimum, np.inf, x, low, high)


def window_max(x: FloatArray, low: int, high: int | None) -> FloatArray:
    """Return y with y[t] = max of x[t + low … t + high]; see :func:`window_min`."""
    return _window(np.maximum, -np.inf, x, low, high)


def _window(fold: np.ufunc, empty: float, x: FloatArray, low: int, high: int | None) -> FloatArray:
    n = x.shape[-1]
    if high is None or high - low >= n - 1:
        return shift(fold.accumulate(x[..., ::-1], axis=-1)[..., ::-1], low, empty)
    y, width = np.empty(x.shape), high - low + 1
    source, result = x.reshape(-1, n), y.reshape(-1, n)
    for piece in pieces(result.shape, width - 1, [np.empty] * 2, PIECE):
        block, spare = piece.room
        piece.read(source, block, low, empty)
        size, m = 1, block.size  # block[t] is the least of `size` samples from t on
        while size < width:
            # two blocks of one size cover the next one; they may overlap, since a minimum is idempotent
            step = min(size, width - size)
            size, m = size + step, m - step
            fold(block[:m], block[step : step + m], out=spare[:m])
            block, spare = spare, block
        piece.write(block, result)
    return y


def until(left: FloatArray, right: FloatArray, low: int, high: int | None) -> FloatArray:
    """Return the robustness of ``left until[low, high] right``.

    y[t] = max over t' in t + [low, high] of min(right[t'], min of left[t … t' − 1]).

    Either t' = s is the witness, or a later instant is. With the value v of the later witnesses, this gives
    max(right[s], min(left[s], v)): a clamp of v. The composition of two clamps is a clamp,
    (p, q)∘(p', q') = (min(p, p'), max(q, min(p, q'))), so the clamp of a whole window is built by doubling. It is
    exact, and works for any batch. Blocks may overlap, since a witness that counts twice needs no less of ``left``
    the second time.

    Args:
        left: (…, n) robustness of the condition that holds before the witness.
        right: (…, n) robustness of the witness.
        low: first sample at which the witness may be, 0 ≤ low.
        high: last one; None for the end of the trace.

    """
    if left.shape != right.shape:
        left, right = np.broadcast_arrays(left, right)
    if low > 0:
        rest = until(left, right, 0, None if high is None else high - low)
        return np.minimum(window_min(left, 0, low - 1), shift(rest, low, -np.inf))
    n, y = left.shape[-1], np.empty(left.shape)
    left, right, result = left.reshape(-1, n), right.reshape(-1, n), y.reshape(-1, n)
    if high is None or high >= n - 1:
        _until_the_end(left, right, result)
        return y
    for piece in pieces(result.shape, high, [np.empty] * 3, PIECE):
        p, q, spare = piece.room
        piece.read(left, p, 0, np.inf)
        piece.read(right, q, 0, -np.inf)
        _clamp(p, q, spare, high + 1)
        piece.write(q, result)
    return y


def _until_the_end(left: FloatArray, right: FloatArray, y: FloatArray) -> None:
    """Write the unbounded :func:`until` into y, (k, n) each, from the last piece to the first."""
    after = np.full(len(y), -np.inf)
    for piece in pieces(y.shape, None, [np.empty] * 3, RUN):
        p, q, spare = piece.room
        piece.read(left, p, 0, np.inf)
        piece.read(right, q, 0, -np.inf)
        # the value of all later pieces counts as one more witness
        piece.view(q)[:, piece.end - piece.start] = after[piece.rows]
        _clamp(p, q, spare, piece.end - piece.start + 1)
        piece.write(q, y)
        after[piece.rows] = y[piece.rows, piece.start]


def _clamp(p: FloatArray, q: FloatArray, spare: FloatArray, width: int) -> None:
    """Set q[t] to the q of the clamp over the ``width`` samples from t on, or over all that are left."""
    size = 1
    while size < width:
        step = min(size, width - size)
        size += step
        ahead_p, ahead_q = p[step:], q[step:]
        m = ahead_q.size
        p, q, later = p[:m], q[:m], spare[:m]
        np.minimum(p, ahead_q, out=later)
        np.maximum(q, later, out=q)
        np.minimum(p, ahead_p, out=later)
        p, spare = later, p


def range_min(x: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return y with y[k] = min of x[first[k] … last[k]], for windows of any position and length.

    A sparse table: two blocks whose length is a power of two cover a window. Of (…, n) samples and (m,) windows within
    0 … n − 1 it returns (…, m). A window with last < first is empty, its least value +inf.
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
    """Return :func:`until` with its own window of witnesses first[t] … last[t] at every sample t.

    With W the untimed until, y[t] = min(min of left before first[t], max of right in the window, W[first[t]]). The
    reason: if a witness after the window is good, left holds up to it, so any witness in the window is as good as
    its right.

    ``left`` and ``right`` are (…, n). A window lies within t … n − 1; the result is −inf where last < first.
    """
    left, right = np.broadcast_arrays(left, right)
    n = left.shape[-1]
    guard = range_min(left, np.arange(n), np.minimum(first, n) - 1)
    best = np.negative(range_min(np.negative(right), first, last))
    return np.minimum(np.minimum(guard, best), until(left, right, 0, None)[..., np.minimum(first, n - 1)])
