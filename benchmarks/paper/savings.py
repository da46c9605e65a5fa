"""How many rollouts of the real machine does the simulator save?

The machine is the twin of the lab (a twin, not hardware); the question is its worst expected ρ, as an
interval that holds with probability ≥ 1 − 2e-6. Four ways to it, by rollouts of the real machine:

- both steps: search 1 on the simulator, whose rollouts cost nothing here, and search 2 on the signed gap;
- directly: search 1 on the machine itself;
- an even grid of tests, the same number of rollouts at each, Hoeffding's inequality and a union bound;
- as many strata as pay best, with tests drawn at random in each, and the same inequality.

Every way knows the same noise R, and a norm bound that is true: the machine is made of a bank of recorded
rollouts (``bank.py``), so that the norms of ρ and of the gap are known, and each way is given the smallest
of {0.75, 1.5, 3, 6} that is at least the norm of what it samples. This is where the simulator saves anything:
what it gets right cancels in the gap, which is then smoother than ρ. With the same B for both the gap costs
*more* rollouts than ρ, since a difference is noisier than its parts; that line is drawn, too. For the last
two ways the best number of tests is chosen for them in hindsight. ::

    OMP_NUM_THREADS=1 python -m benchmarks.paper.savings          # about 5 minutes of one core
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

import s2r_spec as s2r
from benchmarks.machine import describe
from benchmarks.paper.bank import HIGH, KNOTS, LOW, SPEC, Bank, matern52_norm, minimum
from s2r_spec.certify.result.compose import compose
from s2r_spec.certify.search.pairing import SIMULATED_PER_REAL
from s2r_spec.certify.search.search import Query, Search

RESULTS = Path(__file__).parent / "results" / "savings.json"
REAL = "twin:lab"
R, DELTA, LENGTHSCALE = 0.01, 1e-6, 0.15
BOUNDS = (0.75, 1.5, 3.0, 6.0)
# The searches go on until their interval is this wide; it decides how finely they divide the box.
FINEST, MOST = 0.02, 1500
SIMULATORS = 0.005
# tol_s of the spec: |vx − vd| has no smaller value than 0. Downwards ρ is taken to end at what a fall is worth.
MOST_RHO = 0.045
WIDTHS = (0.08, 0.06, 0.05, 0.04, 0.03)
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int_]
Curve = list[tuple[int, float]]
Draw = Callable[[Query, np.random.Generator], FloatArray]


def smallest_true(norm: float) -> float:
    return next(bound for bound in BOUNDS if bound >= norm)


def search_with(B: float, noise: float, epsilon: float, seed: int, delta: float) -> Search:
    return Search(
        {"vd": (LOW, HIGH)},
        kernel=s2r.Kernel("matern52", LENGTHSCALE),
        B=B,
        R=noise,
        delta=delta,
        epsilon=epsilon,
        seed=seed,
    )


def answer(search: Search, draw: Draw, stream: int, seed: int) -> None:
    """Run one batch; every query has a generator of its own."""
    for query in search.ask():
        search.tell(query, draw(query, np.random.default_rng([seed, stream, query.index])))


def directly(real: Bank, B: float, seed: int) -> Curve:
    """Return (rollouts, width) after every batch of a search on the machine itself, at δ = 2e-6."""
    search = search_with(B, R, FINEST, seed, 2 * DELTA)
    curve: Curve = []
    while not search.done and (not curve or curve[-1][0] < MOST):
        answer(search, lambda query, rng: -real.draw(query.point["vd"], query.replicates, rng), 1, seed)
        found = search.certificate()
        curve.append((found.rollouts, found.epsilon))
    return curve


def simulated(sim: Bank, B: float, seed: int) -> Search:
    """Return search 1, run until the simulator is known far better than the gap will be."""
    search = search_with(B, R, SIMULATORS, seed, DELTA)
    while not search.done:
        answer(search, lambda query, rng: -sim.draw(query.point["vd"], query.replicates, rng), 2, seed)
    return search


def both_steps(first: Search, sim: Bank, real: Bank, B: float, seed: int) -> Curve:
    """Return (real rollouts, width of the composed interval) after every batch of search 2."""

    def draw(query: Query, rng: np.random.Generator) -> FloatArray:
        test, count = query.point["vd"], query.replicates
        machine = real.draw(test, count, rng)
        beside = np.mean([sim.draw(test, count, rng) for _ in range(SIMULATED_PER_REAL)], axis=0)
        return np.asarray(beside - machine)

    second = search_with(B, R * np.sqrt(1 + 1 / SIMULATED_PER_REAL), FINEST, seed, DELTA)
    curve: Curve = []
    while not second.done and (not curve or curve[-1][0] < MOST):
        answer(second, draw, 3, seed)
        whole = compose(first, second)
        curve.append((second.certificate().rollouts, whole.upper - whole.lower))
    return curve


def hoeffding(noise: float, tests: IntArray, rollouts: int) -> FloatArray:
    """Return the half-width at so many tests, all at once, with the rollouts shared equally among them."""
    return noise * np.sqrt(2 * np.log(2 * tests / (2 * DELTA)) / (rollouts // tests))


def on_a_grid(B: float, noise: float, rollouts: Sequence[int]) -> Curve:
    """Return (rollouts, width) for the best even grid: Hoeffding at every test, interpolation between."""
    kernel = s2r.Kernel("matern52", LENGTHSCALE)
    curve: Curve = []
    for count in rollouts:
        tests = some_up_to(count, 2)
        between = B * kernel.hidden((HIGH - LOW) / (tests[:, None] - 1))[:, 0]
        curve.append((count, float((2 * hoeffding(noise, tests, count) + between).min())))
    return curve


def at_random(B: float, noise: float, rollouts: Sequence[int]) -> Curve:
    """Return (rollouts, width) for tests drawn at random in the best number of strata.

    In a stratum of width w no two values are further apart than B‖φ(x) − φ(x + w)‖, so that the mean of its
    outcomes is within that, and Hoeffding's half-width, of the value anywhere in it.
    """
    kernel = s2r.Kernel("matern52", LENGTHSCALE)
    curve: Curve = []
    for count in rollouts:
        strata = some_up_to(count, 1)
        near = kernel.gram(np.zeros((1, 1)), (HIGH - LOW) / strata[:, None])[0]
        apart = B * np.sqrt(2 - 2 * near)
        curve.append((count, float((2 * (hoeffding(noise, strata, count) + apart)).min())))
    return curve


def some_up_to(most: int, least: int) -> IntArray:
    """Return whole numbers, evenly apart on a logarithmic scale."""
    return np.unique(np.geomspace(least, most, 300).astype(int))


def needed(curve: Curve, width: float) -> int | None:
    """Return the fewest rollouts after which the interval is no wider."""
    return next((n for n, found in curve if found <= width), None)


def median_curve(curves: Sequence[Curve]) -> Curve:
    """Return the median width by rollouts, on the first curve's rollouts, over runs of the same batches."""
    common = min(len(curve) for curve in curves)
    return [(curves[0][i][0], float(np.median([curve[i][1] for curve in curves]))) for i in range(common)]


def plot(curves: dict[str, Curve], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.add_subplot(
        xlabel="rollouts of the real machine",
        ylabel="width of the interval for its worst E ρ [m/s]",
        xscale="log",
        yscale="log",
        ylim=(0.015, 1.2),
    )
    styles = ("o-", "s-", "s:", "-", "--", "-.")
    for (name, curve), style in zip(curves.items(), styles, strict=True):
        axes.plot(*zip(*curve, strict=True), style, ms=3, lw=1.2, label=name)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    sim, real = Bank.read("sim"), Bank.read(REAL)
    gap = BSpline(KNOTS, real.mean.c - sim.mean.c, 3)
    norms = {
        "simulator": matern52_norm(sim.mean, LENGTHSCALE),
        "machine": matern52_norm(real.mean, LENGTHSCALE),
        "gap": matern52_norm(gap, LENGTHSCALE),
    }
    B = {name: smallest_true(norm) for name, norm in norms.items()}
    truth, where = minimum(real.mean)
    print(f"truth: worst E ρ {truth:+.4f} m/s at vd = {where:.4f}")
    for name, norm in norms.items():
        print(f"norm of the {name}'s mean in Matérn-5/2({LENGTHSCALE}): {norm:.3f} m/s, so B = {B[name]:g}")
    seeds = range(options.seeds)
    fall = s2r.load_spec(SPEC).certify["walking"].fall
    assert fall is not None
    by_range = (MOST_RHO - fall) / 2
    counts = sorted({round(n) for n in np.geomspace(8, 3e6, 60)})
    firsts = [simulated(sim, B["simulator"], seed) for seed in seeds]
    few = [first.certificate().rollouts for first in firsts]
    print(f"search 1: {int(np.median(few))} rollouts of the simulator")
    curves: dict[str, Curve] = {
        f"both steps, B = {B['gap']:g} for the gap": median_curve(
            [both_steps(first, sim, real, B["gap"], seed) for first, seed in zip(firsts, seeds, strict=True)]
        ),
        f"directly, B = {B['machine']:g} for ρ": median_curve(
            [directly(real, B["machine"], seed) for seed in seeds]
        ),
        f"both steps, B = {B['machine']:g} for the gap, too": median_curve(
            [
                both_steps(first, sim, real, B["machine"], seed)
                for first, seed in zip(firsts, seeds, strict=True)
            ]
        ),
        "even grid, Hoeffding": on_a_grid(B["machine"], R, counts[:40]),
        "random tests, Hoeffding": at_random(B["machine"], R, counts[:48]),
        "even grid, Hoeffding by the range of ρ": on_a_grid(B["machine"], by_range, counts),
    }
    table: list[dict[str, Any]] = []
    for width in WIDTHS:
        row = {"width": width} | {name: needed(curve, width) for name, curve in curves.items()}
        table.append(row)
        print(
            f"no wider than {width:g} m/s: " + "; ".join(f"{k} {v}" for k, v in row.items() if k != "width")
        )
    plot(curves, options.output.with_suffix(".svg"))
    record = {
        "machine": describe("numpy", "scipy", "torch", "gpytorch"),
        "real": REAL,
        "settings": {"R": R, "delta": 2 * DELTA, "lengthscale": LENGTHSCALE, "R_by_range": by_range},
        "truth": {"minimum": truth, "at": where},
        "norms": norms,
        "bounds": B,
        "simulated_rollouts": int(np.median(few)),
        "seeds": options.seeds,
        "needed": table,
        "curves": curves,
    }
    options.output.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
