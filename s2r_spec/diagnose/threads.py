"""One thread for linear algebra while a diagnosis runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep linear algebra to one thread; without threadpoolctl, which comes with scikit-learn, do nothing.

    How a sum is shared out to threads changes its last bits, and training of networks makes of these what can be seen
    in a probability: the answer would hang on how many cores there are. And arrays are small here: threads wait for
    each other for longer than they work.
    """
    if find_spec("threadpoolctl") is None:
        yield
        return
    import scipy.linalg  # noqa: F401  # only libraries that are loaded by then are limited
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        yield
