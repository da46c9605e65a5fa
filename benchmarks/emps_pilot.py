"""The pilot behind R and B of specs/emps_tracking.stl: 9 × 5 × 3 tests, 20 rollouts each, on seeds of its own.

Run: python benchmarks/emps_pilot.py        # a minute on one core
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import s2r_spec as s2r
from s2r_spec.certify.confidence import smallest_norm
from s2r_spec.certify.kernels import Kernel

ROOT = Path(__file__).parents[1]

ROLLOUTS = 20
FIRST_SEED = 10**6
LENGTHSCALES = (0.19, 1.5, 30.0)
"""m/s, m/s^2, kg: the widths of the test space."""


def main() -> None:
    spec, axis = s2r.load_spec(ROOT / "specs" / "emps_tracking.stl"), s2r.load_backend("emps")
    points = spec.space.grid((9, 5, 3))
    rho = np.empty((len(points), ROLLOUTS))
    for i, vector in enumerate(points):
        test = spec.space.point(vector)
        for j in range(ROLLOUTS):
            trace = axis.rollout(test, FIRST_SEED + i * ROLLOUTS + j)
            rho[i, j] = spec.robustness(trace, test)["tracks"]
    mean, std = rho.mean(axis=1), rho.std(axis=1, ddof=1)
    print(f"mean rho from {1e3 * mean.min():.4f} mm at {spec.space.point(points[mean.argmin()])} "
          f"to {1e3 * mean.max():.4f} mm")  # fmt: skip
    print(f"standard deviation of one rollout: median {1e6 * np.median(std):.2f} um, largest {1e6 * std.max():.2f} um")
    gram = Kernel("matern52", LENGTHSCALES).gram(points, points)
    norm = smallest_norm(gram, ROLLOUTS / std**2, mean, radius=len(points))
    print(f"least norm in the RKHS of matern52{LENGTHSCALES}: {1e3 * norm:.3f} mm")


if __name__ == "__main__":
    main()
