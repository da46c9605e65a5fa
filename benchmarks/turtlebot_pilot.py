"""The pilot behind R and B of specs/turtlebot.stl: 13 × 25 tests, 200 rollouts each, on seeds of its own.

    python -m benchmarks.turtlebot_pilot        # two minutes on one core

A certificate's own rollouts never choose its R or B; those of this file are
never used for a certificate.
"""

import numpy as np

import s2r_spec as s2r
from s2r_spec.certify.bound.confidence import smallest_norm
from s2r_spec.certify.bound.kernels import Kernel

ROLLOUTS = 200
FIRST_SEED = 10**6


def main() -> None:
    spec, robot = s2r.load_spec("specs/turtlebot.stl"), s2r.load_backend("turtlebot")
    points = spec.space.grid((25, 13))
    rho = np.empty((len(points), ROLLOUTS))
    for i, vector in enumerate(points):
        test = spec.space.point(vector)
        for j in range(ROLLOUTS):
            trace = robot.rollout(test, FIRST_SEED + i * ROLLOUTS + j)
            rho[i, j] = spec.robustness(trace, test)["delivers"]
    mean, std = rho.mean(axis=1), rho.std(axis=1, ddof=1)
    residual = rho - mean[:, None]
    print(
        f"mean ρ from {mean.min():.4f} m at {spec.space.point(points[mean.argmin()])} to {mean.max():.4f} m"
    )
    print(f"standard deviation of one rollout: median {np.median(std):.4f} m, largest {std.max():.4f} m")
    print(f"largest deviation of {rho.size} rollouts {np.abs(residual).max():.4f} m, "
          f"kurtosis {((residual / std[:, None]) ** 4).mean():.2f} (3 for a Gaussian)")  # fmt: skip
    # The smoothest function that fits the means as well as their noise allows: a squared misfit of 1 a test.
    for scale in (0.2, 0.3, 0.4):
        gram = Kernel("matern52", scale).gram(points, points)
        norm = smallest_norm(gram, ROLLOUTS / std**2, mean, radius=len(points))
        print(f"least norm in the RKHS of matern52({scale} {{m}}): {norm:.2f} m")


if __name__ == "__main__":
    main()
