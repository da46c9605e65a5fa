"""Threads of linear algebra."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep linear algebra to one thread; without threadpoolctl, do nothing.

    The number of threads changes the last bits of a sum, and then the answer depends on the number of cores. Arrays are
    small here, so threads wait for each other for longer than they work.
    """
    if find_spec("threadpoolctl") is None:
        yield
        return
    import scipy.linalg  # noqa: F401  # only libraries that are loaded by then are limited
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        yield
