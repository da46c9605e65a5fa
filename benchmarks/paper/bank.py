"""Recorded ρ of the A1 over the test space, and an experiment made of them whose truth is known.

A bank holds ρ of real rollouts (of the simulator or of a twin) at 43 speeds, with the same number of
seeds at each. It stands in for the backend where hundreds of thousands of rollouts are wanted: a draw
at test d first picks one of the bank's speeds, with the values at d of the cubic B-splines as
probabilities, and then one of the ρ recorded there. Given the bank,

- draws are independent, whatever was drawn before;
- their mean is Σ_i b_i(d) m_i, the cubic spline whose control points are the bank's means, so that its
  minimum is known exactly;
- their noise lies in an interval, so that half its length is a proven R (Hoeffding's lemma);
- a cubic spline has a square-integrable third derivative, so that it lies in the RKHS of the Matérn-5/2
  kernel and its norm there can be computed. (With linear interpolation it would lie in no RKHS of a
  kernel that s2r has: a kink is too rough.)

So everything that a certificate assumes can be checked, and coverage needs no reference of its own. ::

    OMP_NUM_THREADS=1 python -m benchmarks.paper.bank sim              # 5 minutes of one core
    OMP_NUM_THREADS=1 python -m benchmarks.paper.bank twin:lab --seeds 40
"""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import fixed_quad
from scipy.interpolate import BSpline

import s2r_spec as s2r
from benchmarks.machine import describe
from s2r_spec.runs.runner import Runner
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.seeds import rollout_seed
from s2r_spec.workers.pools import process_pool

ROOT = Path(__file__).parents[2]

FOLDER = Path(__file__).parent / "results"
SPEC = ROOT / "specs" / "a1_velocity.stl"
LOW, HIGH, PIECES = -0.2, 0.3, 40
# No search draws its rollouts from these seeds.
SEED = 30_000

FloatArray = NDArray[np.float64]

EDGES = np.linspace(LOW, HIGH, PIECES + 1)
KNOTS = np.concatenate([[LOW] * 3, EDGES, [HIGH] * 3])
# Greville's abscissae: with control points there, the spline of a straight line is that line.
SPEEDS = np.array([KNOTS[i + 1 : i + 4].mean() for i in range(PIECES + 3)])


@dataclass(frozen=True)
class Bank:
    """(43, seeds) recorded ρ."""

    backend: str
    rho: FloatArray

    @classmethod
    def read(cls, backend: str) -> Self:
        """Read a committed bank."""
        with _place(backend).open() as file:
            rows = list(csv.reader(file))[1:]
        values = np.array([[float(cell) for cell in row] for row in rows])
        if not np.allclose(values[:, 0], SPEEDS, atol=1e-12):
            raise ValueError(f"{_place(backend)} is of other speeds")
        return cls(backend, values[:, 1:])

    @cached_property
    def mean(self) -> BSpline:
        """E ρ of a draw, as a function of the test."""
        return BSpline(KNOTS, self.rho.mean(axis=1), 3)

    def draw(self, point: float, count: int, rng: np.random.Generator) -> FloatArray:
        """Return (count,) independent draws at a test."""
        weights = BSpline.design_matrix(np.array([point]), KNOTS, 3).toarray()[0]
        rows = rng.choice(len(weights), size=count, p=weights / weights.sum())
        return self.rho[rows, rng.integers(self.rho.shape[1], size=count)]

    @property
    def proxy(self) -> float:
        """A proven R: half the largest range of what can be drawn at one test, four neighbours at a time."""
        each = [self.rho[i : i + 4] for i in range(len(self.rho) - 3)]
        return max(float(rows.max() - rows.min()) / 2 for rows in each)


def minimum(spline: BSpline) -> tuple[float, float]:
    """Return a cubic spline's exact minimum over the box, and where it is."""
    points = [LOW, HIGH]
    slope = spline.derivative()
    for left, right in pairwise(EDGES):
        at = np.array([left, (left + right) / 2, right])
        # A cubic's slope on one piece is a parabola: three values give it.
        inside = np.roots(np.polyfit(at, slope(at), 2))
        real = inside[np.abs(inside.imag) < 1e-12].real
        points += [left, *real[(real >= left) & (real <= right)]]
    values = spline(np.array(points))
    return float(values.min()), float(points[int(values.argmin())])


def matern52_norm(spline: BSpline, lengthscale: float) -> float:
    """Return the norm of a cubic spline in the RKHS of Matérn-5/2 on the box, k(z, z) = 1.

    ‖f‖² = (1/q) ∫ (f''' + 3λf'' + 3λ²f' + λ³f)² + xᵀP⁻¹x with x = (f, f', f'')(low), λ = √5/ℓ, q = 16λ⁵/3
    and P the covariance of x: the kernel is the covariance of the stationary process (d/dt + λ)³f = white
    noise of intensity q, started in its stationary state. The integrand is a polynomial between knots.
    """
    rate = np.sqrt(5) / lengthscale
    q = 16 * rate**5 / 3
    first, second, third = (spline.derivative(i) for i in (1, 2, 3))

    def driven(x: FloatArray) -> FloatArray:
        whitened = third(x) + 3 * rate * second(x) + 3 * rate**2 * first(x) + rate**3 * spline(x)
        return np.asarray(whitened**2)

    energy = sum(fixed_quad(driven, left, right, n=4)[0] for left, right in pairwise(EDGES))
    state = np.array([spline(LOW), first(LOW), second(LOW)])
    covariance = np.array([[1, 0, -(rate**2) / 3], [0, rate**2 / 3, 0], [-(rate**2) / 3, 0, rate**4]])
    return float(np.sqrt(energy / q + state @ np.linalg.solve(covariance, state)))


def noise_norm(bank: Bank, lengthscale: float, draws: int = 200) -> float:
    """Return the root mean square norm that the sampling error of the bank's means has by itself."""
    rng = np.random.default_rng(0)
    error = bank.rho.std(axis=1, ddof=1) / np.sqrt(bank.rho.shape[1])
    norms = [
        matern52_norm(BSpline(KNOTS, error * rng.normal(size=len(error)), 3), lengthscale)
        for _ in range(draws)
    ]
    return float(np.sqrt(np.mean(np.square(norms))))


def _place(backend: str) -> Path:
    return FOLDER / f"bank_{backend.replace(':', '_')}.csv"


def record(backend: str, seeds: int, workers: int) -> None:
    """Run the rollouts of a bank, and write it."""
    spec = s2r.load_spec(SPEC)
    scorer = Scorer.for_spec(spec, "walking", backend)
    tasks = [
        scorer.task(q, r, {"vd": float(v)}, rollout_seed(SEED, q, r))
        for q, v in enumerate(SPEEDS)
        for r in range(seeds)
    ]
    rho, falls, seconds = np.full((len(SPEEDS), seeds), np.nan), 0, 0.0
    with Runner(process_pool(workers)) as runner:
        for done in runner.run(tasks):
            value, failure = scorer.score({"vd": float(SPEEDS[done.task.query])}, done)
            rho[done.task.query, done.task.replicate] = value
            falls += failure is not None
            seconds += done.seconds
    assert np.isfinite(rho).all()
    FOLDER.mkdir(exist_ok=True)
    with _place(backend).open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["vd", *(f"rho_{r}" for r in range(seeds))])
        writer.writerows(
            [repr(float(v)), *map(repr, row.tolist())] for v, row in zip(SPEEDS, rho, strict=True)
        )
    about = {
        "machine": describe("mujoco", "pin", "piqp"),
        "backend": backend,
        "model_hash": scorer.backend.model_hash,
        "spec_hash": spec.hash,
        "rollouts": rho.size,
        "falls": falls,
        "seconds_of_workers": round(seconds, 1),
    }
    _place(backend).with_suffix(".json").write_text(json.dumps(about, indent=2) + "\n")
    bank = Bank(backend, rho)
    print(f"{backend}: {rho.size} rollouts in {seconds:.0f} s of workers, {falls} falls")
    worst, where = minimum(bank.mean)
    print(f"least mean ρ {worst:+.5f} m/s at vd = {where:.4f}; proven R {bank.proxy:.4f} m/s")
    for lengthscale in (0.1, 0.15, 0.2, 0.4):
        print(f"norm in Matérn-5/2({lengthscale}): {matern52_norm(bank.mean, lengthscale):.3f} m/s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("backend")
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    record(options.backend, options.seeds, options.workers)


if __name__ == "__main__":
    main()
