"""How far are 120 certificates of one system apart, and do they contain the truth?

The paper's Fig. 3: 20 runs for each of six norm bounds B, at the paper's R = 0.05 m/s, δ = 1e-6,
ε = 0.02 m/s, on the A1 velocity spec. The paper gives the spread of its 120 ρ̂ᵉ, 0.009, as evidence that
the procedure works; a spread says that runs agree, not that they are right, so coverage of the true
minimum is given beside it.

120 runs of the simulator would take about a million rollouts. The runs draw from a bank of recorded ones
instead (``bank.py``): given the bank they are independent, their mean is known exactly as a function of
the test, and so are its minimum, its norm and a proven R. The statement is about that system, made of the
A1's own ρ; complete runs on the simulator itself stand beside it. ::

    OMP_NUM_THREADS=1 python -m benchmarks.paper.repeatability            # 5 minutes of one core
    OMP_NUM_THREADS=1 python -m benchmarks.paper.repeatability --real     # and the complete runs, 4 more
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import s2r_spec as s2r
from benchmarks.certify.random_functions import binomial_interval
from benchmarks.machine import describe
from benchmarks.paper.bank import HIGH, LOW, SPEC, Bank, matern52_norm, minimum, noise_norm
from s2r_spec.certify.check import check_with
from s2r_spec.certify.from_spec import search_for
from s2r_spec.certify.options import RunOptions
from s2r_spec.certify.search.search import Search
from s2r_spec.runs.scorer import Scorer
from s2r_spec.workers.pools import process_pool

RESULTS = Path(__file__).parent / "results" / "repeatability.json"
BOUNDS = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0)
R, DELTA, EPSILON, LENGTHSCALE = 0.05, 1e-6, 0.02, 0.15
PAPERS_SPREAD = 0.009


@dataclass(frozen=True)
class Run:
    """What one run certified; ``lower`` is the paper's ρ̂ᵉ."""

    kernel: str
    B: float
    seed: int
    lower: float
    upper: float
    worst: float
    rollouts: int
    label: str
    B_low: float
    log_e_value: float


@cache
def bank() -> Bank:
    return Bank.read("sim")


def search_with(kernel: str, B: float, R: float, seed: int) -> Search:
    return Search(
        {"vd": (LOW, HIGH)},
        kernel=s2r.Kernel(kernel, LENGTHSCALE),
        B=B,
        R=R,
        delta=DELTA,
        epsilon=EPSILON,
        seed=seed,
        unit="m/s",
    )


def run(setting: tuple[str, float, float, int]) -> Run:
    """Run one search on draws from the bank. Every query of every run has a generator of its own."""
    kernel, B, R, seed = setting
    search = search_with(*setting)
    while not search.done:
        for query in search.ask():
            rng = np.random.default_rng([seed, query.index, round(1e6 * B), round(1e6 * R), kernel == "rbf"])
            search.tell(query, -bank().draw(query.point["vd"], query.replicates, rng))
    found = search.certificate()
    return Run(
        kernel,
        B,
        seed,
        -found.upper,
        -found.lower,
        found.worst["vd"],
        found.rollouts,
        found.label.name,
        found.B_low,
        found.log_e_value,
    )


def summary(runs: list[Run], truth: float) -> dict[str, Any]:
    """Return spread and coverage of some runs."""
    lower = np.array([each.lower for each in runs])
    wrong = sum(not each.lower <= truth <= each.upper for each in runs)
    loose = sum(truth - each.lower > EPSILON for each in runs)
    return {
        "runs": len(runs),
        "median_rollouts": int(np.median([each.rollouts for each in runs])),
        "spread": float(lower.max() - lower.min()),
        "lowest": float(lower.min()),
        "highest": float(lower.max()),
        "wrong": wrong,
        "wrong_95": binomial_interval(wrong, len(runs)),
        "further_than_epsilon": loose,
        "labels": dict(Counter(each.label for each in runs)),
        "largest_B_low": max(each.B_low for each in runs),
    }


def sentence(name: str, row: dict[str, Any]) -> str:
    return (
        f"{name:22} {row['runs']:3d} runs of {row['median_rollouts']:6d} rollouts: ρ̂ᵉ in [{row['lowest']:+.4f}, "
        f"{row['highest']:+.4f}], spread {row['spread']:.4f} (paper {PAPERS_SPREAD}); wrong {row['wrong']} "
        f"(95 %: {row['wrong_95'][0]:.3f} to {row['wrong_95'][1]:.3f}), "
        f"further than ε {row['further_than_epsilon']}; {row['labels']}"
    )


def complete(name: str, search: Search, workers: int) -> dict[str, Any]:
    """Run one certificate on the simulator itself."""
    spec = s2r.load_spec(SPEC)
    with tempfile.TemporaryDirectory() as folder:
        result = check_with(
            search,
            spec,
            "walking",
            Scorer.for_spec(spec, "walking", "sim"),
            Path(folder) / "run",
            RunOptions(seed=search.settings.seed, executor=process_pool(workers)),
        )
    return {
        "name": name,
        "settings": {key: result.certificate.settings[key] for key in ("kernel", "B", "R", "seed")},
        "lower": result.lower,
        "upper": result.upper,
        "rollouts": result.certificate.rollouts,
        "label": result.certificate.label.value,
        "worst": result.worst.params["vd"],
        "seconds": round(result.seconds, 1),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="runs for each B")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--real", action="store_true", help="also repeat the complete runs")
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    truth, where = minimum(bank().mean)
    norm = matern52_norm(bank().mean, LENGTHSCALE)
    print(
        f"truth: least mean ρ {truth:+.5f} m/s at vd = {where:.4f}; norm {norm:.3f} m/s in "
        f"Matérn-5/2({LENGTHSCALE}); noise R ≤ {bank().proxy:.4f} m/s, proven; {bank().rho.size} recorded rollouts"
    )
    chance = noise_norm(bank(), LENGTHSCALE)
    print(
        f"so B ≥ {norm:.3f} is true and B below is false; the scatter of {bank().rho.shape[1]} seeds alone, around "
        f"a mean of zero, would have norm {chance:.3f}"
    )
    kept = json.loads(options.output.read_text()) if options.output.exists() else {}
    tables: dict[str, Any] = {}
    with ProcessPoolExecutor(options.workers) as pool:
        for kernel in ("matern52", "rbf"):
            settings = [(kernel, B, R, seed) for B in BOUNDS for seed in range(options.runs)]
            runs = list(pool.map(run, settings))
            rows = []
            for B in BOUNDS:
                row = {"B": B} | summary([each for each in runs if each.B == B], truth)
                rows.append(row)
                print(sentence(f"{kernel} B = {B:g}", row), flush=True)
            whole = summary(runs, truth)
            print(sentence(f"{kernel}, all", whole), flush=True)
            tables[kernel] = {"by_B": rows, "all": whole, "runs": [asdict(each) for each in runs]}
        settings = [("matern52", norm, bank().proxy, seed) for seed in range(5 * options.runs)]
        runs = list(pool.map(run, settings))
        proven = {"B": norm, "R": bank().proxy} | summary(runs, truth)
        print(sentence("norm and R as they are", proven), flush=True)
    finished = kept.get("complete_runs", [])
    if options.real:
        spec = s2r.load_spec(SPEC)
        finished = [
            complete(f"s2r check with seed {seed}", s2r_search(spec, seed), options.workers)
            for seed in (1, 2)
        ]
    for each in finished:
        print(
            f"{each['name']}, on the simulator: [{each['lower']:+.4f}, {each['upper']:+.4f}] after "
            f"{each['rollouts']} rollouts, {'contains' if each['lower'] <= truth <= each['upper'] else 'MISSES'} "
            f"the bank's {truth:+.4f}; {each['label']}"
        )
    record = {
        "machine": describe("numpy", "scipy", "torch", "gpytorch"),
        "settings": {"R": R, "delta": DELTA, "epsilon": EPSILON, "lengthscale": LENGTHSCALE},
        "truth": {
            "minimum": truth,
            "at": where,
            "matern52_norm": norm,
            "norm_of_scatter_alone": chance,
            "proven_R": bank().proxy,
            "recorded_rollouts": bank().rho.size,
        },
        "papers_spread": PAPERS_SPREAD,
        "tables": tables,
        "proven": proven,
        "complete_runs": finished,
    }
    options.output.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
    return int(any(table["all"]["wrong"] for table in tables.values()) or proven["wrong"] > 0)


def s2r_search(spec: s2r.Spec, seed: int) -> Search:
    return search_for(spec, "walking", RunOptions(seed=seed))


if __name__ == "__main__":
    sys.exit(main())
