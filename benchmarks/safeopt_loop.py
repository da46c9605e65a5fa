"""Seconds of a SafeOpt loop on a line of 501 points; run by `certify_safeopt.py` in a venv of its own.

SafeOpt 0.16 needs numpy below 2, and names that newer Pythons do not have any more. Arguments are
THRESHOLD:ITERATIONS; without a safety threshold (-inf) it predicts on the grid and takes the widest
interval among the possible maximisers, with one it also looks for points that could make others safe.
"""

from __future__ import annotations

import collections
import collections.abc
import json
import sys
from importlib.metadata import version
from time import thread_time

import numpy as np


def main(words: list[str]) -> None:
    for name in ("Sequence", "Iterable", "Mapping"):
        setattr(collections, name, getattr(collections.abc, name))
    for name, kind in (("float", float), ("int", int), ("bool", bool)):
        if name not in vars(np):
            setattr(np, name, kind)
    import GPy
    import safeopt

    rng = np.random.default_rng(0)

    def outcome(x: float) -> float:
        return float(0.1 * np.sin(8 * x) + 0.05 * rng.normal())

    def loop(threshold: float, count: int) -> float:
        grid = np.linspace(-0.2, 0.3, 501)[:, None]
        x = np.zeros((1, 1))
        start = thread_time()
        kernel = GPy.kern.RBF(input_dim=1, variance=1.5**2, lengthscale=0.2)
        gp = GPy.models.GPRegression(x, np.array([[outcome(0.0)]]), kernel, noise_var=0.05**2)
        search = safeopt.SafeOpt(gp, grid, fmin=threshold, beta=3.0)
        for _ in range(count):
            at = search.optimize()
            search.add_new_data_point(at, outcome(float(at[0])))
        return thread_time() - start

    loop(-np.inf, 2)  # first calls
    seconds = {}
    for word in words:
        threshold, _, count = word.partition(":")
        seconds[word] = loop(float(threshold), int(count))
    versions = {name: version(name) for name in ("safeopt", "GPy", "numpy")}
    print(json.dumps({"seconds": seconds, "versions": versions}))


if __name__ == "__main__":
    main(sys.argv[1:])
