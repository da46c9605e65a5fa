"""What does a step of the search cost, beside a GPyTorch loop that takes the same steps?

Nothing is fitted on either side. A posterior on a grid is compared with that of an ExactGP
on the same rollouts; a whole step (choose four tests, take in their outcomes, bound the box
for 33 dual scales and four norms) is given beside it. ::

    OMP_NUM_THREADS=1 python benchmarks/certify_speed.py          # about 2 minutes
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from time import thread_time

import numpy as np
from machine import describe

from s2r_spec.certify.kernels import Kernel
from s2r_spec.certify.posterior import GPyTorch, Spectral
from s2r_spec.certify.samples import Samples
from s2r_spec.certify.search import Search

RESULTS = Path(__file__).parent / "results" / "certify_speed.json"
KERNEL = Kernel("rbf", 0.2)


def our_step(dim: int, rollouts: int, points: int) -> tuple[float, int]:
    """Return the median seconds of one whole step (ask, tell, tighten) near n rollouts, and the distinct tests."""
    space = {f"x{i}": (-0.2, 0.3) for i in range(dim)}
    search = Search(
        space, kernel=KERNEL, B=1.5, R=0.05, delta=0.1, epsilon=1e-4, seed=0, batch=points / rollouts
    )
    rng = np.random.default_rng(0)
    steps: list[float] = []
    while search.certificate().rollouts < rollouts:
        start = thread_time()
        for query in search.ask():
            x = np.array(list(query.point.values()))
            search.tell(query, 0.1 * np.sin(8 * x.sum()) + 0.05 * rng.normal(size=query.replicates))
        steps.append(thread_time() - start)
    return float(np.median(steps[-5:])), search.certificate().points


def posteriors(dim: int, rollouts: int, distinct: int, grid: int) -> tuple[float, float, float]:
    """Return the median seconds of one posterior on a grid, ours and GPyTorch's, and how far they are apart.

    The same rollouts: merged into their distinct tests for us, which loses
    nothing, one by one for GPyTorch, as a loop around an ExactGP has them.
    """
    rng = np.random.default_rng(0)
    table = np.concatenate([rng.uniform(-0.2, 0.3, (distinct, dim)), rng.uniform(-0.2, 0.3, (grid, dim))])
    which, outcomes = np.arange(rollouts) % distinct, rng.normal(size=rollouts)
    merged = Samples(
        np.arange(distinct), np.bincount(which).astype(float), np.bincount(which, weights=outcomes)
    )
    scale = np.array([450.0])
    spectral = Spectral(KERNEL)
    spectral.condition(table, merged)  # its covariances are computed once, when a test is first used

    def ours() -> np.ndarray:
        data = spectral.condition(table, merged)
        data.evidence(scale)
        return data.moments(scale, table).mean[0]

    each = np.concatenate([table[which], table[distinct:]])
    single = Samples(np.arange(rollouts), np.ones(rollouts), outcomes)

    def theirs() -> np.ndarray:
        data = GPyTorch(KERNEL).condition(each, single)
        data.evidence(scale)
        return data.moments(scale, table).mean[0]

    difference = float(np.abs(ours() - theirs()).max())
    return _median_time(ours, 20), _median_time(theirs, 3), difference


def _median_time(call: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = thread_time()
        call()
        times.append(thread_time() - start)
    return float(np.median(times))


def loops(iterations: int) -> dict[str, float]:
    """Return seconds for so many one-rollout iterations in 1-D: ours, and a BoTorch UCB loop that fits nothing.

    BoTorch is no dependency of s2r; without it only ours is measured. Its
    loop bounds nothing: it predicts, and chooses the next test.
    """
    rng = np.random.default_rng(0)

    def outcome(x: float) -> float:
        return float(0.1 * np.sin(8 * x) + 0.05 * rng.normal())

    start = thread_time()
    search = Search(
        {"x": (-0.2, 0.3)}, kernel=KERNEL, B=1.5, R=0.05, delta=0.1, epsilon=1e-6, spread=1, batch=1e-9
    )
    done = 0
    while done < iterations:
        for query in search.ask():
            search.tell(query, [outcome(query.point["x"]) for _ in range(query.replicates)])
            done += 1
    times = {"s2r": thread_time() - start}
    try:
        import torch
        from botorch.acquisition import UpperConfidenceBound
        from botorch.models import SingleTaskGP
        from botorch.optim import optimize_acqf
    except ImportError:
        return times
    bounds = torch.tensor([[-0.2], [0.3]], dtype=torch.float64)
    x = torch.zeros((1, 1), dtype=torch.float64)
    y = torch.tensor([[outcome(0.0)]], dtype=torch.float64)
    start = thread_time()
    for _ in range(iterations):
        model = SingleTaskGP(x, y, torch.full_like(y, 0.05**2), outcome_transform=None)
        at, _ = optimize_acqf(
            UpperConfidenceBound(model, beta=9.0), bounds, q=1, num_restarts=2, raw_samples=64
        )
        x, y = torch.cat([x, at]), torch.cat([y, torch.tensor([[outcome(at.item())]], dtype=torch.float64)])
    times["botorch"] = thread_time() - start
    return times


def plot(growth: list[dict[str, float]], path: Path) -> None:
    """Draw how a step's cost grows with the rollouts, one line for each number of test parameters."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.add_subplot(xlabel="rollouts", ylabel="one step [ms]", xscale="log", yscale="log")
    for dim in sorted({int(row["dim"]) for row in growth}):
        part = [row for row in growth if row["dim"] == dim]
        axes.plot([row["rollouts"] for row in part], [row["step_ms"] for row in part], "o-", label=f"{dim}-D")
    axes.legend(title="test space")
    axes.grid(alpha=0.3)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Run all, print the table, write the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    rows = []
    for dim, grid in ((1, 501), (3, 9261)):
        for rollouts in (100, 500, 1000, 2000):
            step, distinct = our_step(dim, rollouts, 50)
            mine, theirs, difference = posteriors(dim, rollouts, distinct, grid)
            row = {
                "dim": dim,
                "rollouts": rollouts,
                "distinct_tests": distinct,
                "posterior_ms": 1e3 * mine,
                "gpytorch_posterior_ms": 1e3 * theirs,
                "ratio": theirs / mine,
                "largest_difference": difference,
                "whole_step_ms": 1e3 * step,
            }
            rows.append(row)
            print(
                f"{dim}-D, {rollouts:4d} rollouts at {distinct:3d} tests: "
                f"posterior on {grid} points {1e3 * mine:.2f} ms, "
                f"GPyTorch {1e3 * theirs:.0f} ms ({theirs / mine:.0f} ×, apart {difference:.0e}); "
                f"whole step with 38 scales and 4 new tests {1e3 * step:.1f} ms",
                flush=True,
            )
    growth = [
        {"dim": dim, "rollouts": rollouts, "step_ms": 1e3 * our_step(dim, rollouts, 50)[0]}
        for dim in (1, 2, 3, 4)
        for rollouts in (50, 100, 200, 400, 800)
    ]
    plot(growth, options.output.with_suffix(".svg"))
    loops(2)  # imports and first calls
    whole = {str(iterations): loops(iterations) for iterations in (100, 300)}
    for count, times in whole.items():
        ratio = (
            f", BoTorch {times['botorch']:.2f} s ({times['botorch'] / times['s2r']:.0f} ×)"
            if len(times) > 1
            else ""
        )
        print(f"{count} iterations in 1-D, bounds and all: {times['s2r']:.2f} s{ratio}")
    record = {
        "machine": describe("numpy", "torch", "gpytorch"),
        "rows": rows,
        "growth": growth,
        "loops": whole,
    }
    options.output.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
