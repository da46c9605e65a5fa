"""Does a certificate pass with the line that `s2r pilot` proposes?

For three shipped specs and several seeds: a pilot, then a new `s2r check` with the proposed line. The rollouts of the
two share no seed. Beside them, functions drawn from known kernels with known noise: how often is the certificate
refused, is it right, and does R cover the noise and B the norm? ::

    OMP_NUM_THREADS=1 python -m benchmarks.certify.pilot             # 10 minutes of two cores
    OMP_NUM_THREADS=1 python -m benchmarks.certify.pilot --write     # and keep the result
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

import s2r_spec as s2r
from benchmarks.machine import describe
from benchmarks.paper.bank import SPEEDS, Bank
from s2r_spec.certify.bound.certificate import Certificate
from s2r_spec.certify.bound.kernels import FAMILIES, Kernel
from s2r_spec.certify.pilot.design import REPLICATES, design
from s2r_spec.certify.pilot.proposal import Evidence, Outcomes, propose
from s2r_spec.certify.pilot.run import pilot
from s2r_spec.certify.pilot.surface import Means
from s2r_spec.lang.certify_line import with_certify_line
from s2r_spec.space import Space
from s2r_spec.spec import CertifySettings
from s2r_spec.workers.pools import in_this_process

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results" / "certify_pilot.json"
CASES = {
    "turtlebot": ("specs/turtlebot.stl", range(10), ("decided", "epsilon")),
    "emps": ("specs/emps_tracking.stl", range(5), ("decided", "epsilon")),
    "sim": ("specs/a1_velocity.stl", range(5), ("decided",)),
}
"""Backend → specification, seeds and stopping rules."""
MOST = 2000
"""Budget: most rollouts of a check."""
LENGTHSCALES, FUNCTIONS, NOISE = (0.15, 0.3, 0.6), 20, 0.02
"""Lengthscales and number of random functions of each family, over [0, 1], and their noise's deviation."""


def run(job: tuple[str, int, str]) -> dict[str, Any]:
    """Run a pilot and a check of a shipped spec."""
    backend, seed, stop = job
    path = ROOT / CASES[backend][0]
    with tempfile.TemporaryDirectory() as folder:
        found = pilot(path, backend, Path(folder) / "pilot", seed=seed, executor=in_this_process)
        text, _ = with_certify_line(path.read_text(), path.name, found.requirement, found.line)
        result = s2r.check(
            s2r.parse_spec(text, path.name),
            backend,
            Path(folder) / "run",
            requirement=found.requirement,
            seed=seed,
            stop=stop,
            budget=MOST,
            executor=in_this_process,
        )
    settings = found.proposal.settings
    assert settings.kernel is not None
    dense = _dense(Kernel(settings.kernel.name, settings.kernel.lengthscales)) if backend == "sim" else None
    return (
        {
            "case": f"{backend}, stop {stop}",
            "seed": seed,
            "line": " ".join(found.line.split()),
            "pilot_rollouts": found.rollouts,
            "expected": found.proposal.expected,
            "notes": found.proposal.warnings,
            "verdict": result.verdict.value,
            "reason": result.reason,
            "interval": [round(result.lower, 4), round(result.upper, 4)],
        }
        | ({"B_over_norm": round(settings.B / dense, 2)} if dense else {})
        | _of(result.certificate)
    )


def _dense(kernel: Kernel) -> float:
    """Return the norm that the 2580 rollouts of the A1 in ``benchmarks/paper`` show."""
    rho = Bank.read("sim").rho
    std = float(np.sqrt(rho.var(axis=1, ddof=1).mean()))
    counts = np.full(len(rho), float(rho.shape[1]))
    return Means(SPEEDS[:, None], rho.mean(axis=1), counts, std).norm(kernel)


def draw(job: tuple[str, float, int]) -> dict[str, Any]:
    """Run a pilot and a search of a random function of norm 1 and level 0.5."""
    family, lengthscale, seed = job
    rng = np.random.default_rng([seed, round(100 * lengthscale), *family.encode()])
    space, kernel = Space.of({"x": (0.0, 1.0)}), Kernel(family, lengthscale)
    centres, weights = rng.uniform(size=(12, 1)), rng.normal(size=12)
    weights *= 0.3 / np.sqrt(weights @ kernel.gram(centres, centres) @ weights)

    def mean(points: np.ndarray) -> np.ndarray:
        return np.asarray(0.5 + kernel.gram(points, centres) @ weights)

    tests = design(space, None)
    groups = tuple(value + NOISE * rng.normal(size=REPLICATES) for value in mean(tests.points))
    seen = Evidence(space, tests.points, tests.spacing, {"ρ": Outcomes(groups)}, None, "")
    line = propose(seen, CertifySettings(), -2.0).settings
    assert line.kernel is not None
    search = s2r.Search(
        space,
        kernel=Kernel(line.kernel.name, line.kernel.lengthscales),
        B=line.B,
        R=line.R,
        delta=line.delta,
        epsilon=line.epsilon,
        seed=seed,
        budget=MOST,
        stop="epsilon",
    )
    while not search.done:
        for query in search.ask():
            value = mean(space.vector(query.point)[None])[0]
            search.tell(query, -value + NOISE * rng.normal(size=query.replicates))
    dense = np.linspace(0, 1, 241)[:, None]
    # The norm of the function itself in the proposed kernel, from its exact values.
    exact = Means(dense, mean(dense), np.full(len(dense), 1.0), 1e-3).norm(search.kernel)
    truth = float(mean(np.linspace(0, 1, 2001)[:, None]).min())
    certificate = search.certificate()
    inside = -certificate.upper <= truth <= -certificate.lower
    return {
        "case": f"{family}({lengthscale:g})",
        "seed": seed,
        "kernel": line.kernel.name,
        "lengthscale": line.kernel.lengthscales[0],
        "R_over_noise": round(line.R / NOISE, 2),
        "B_over_norm": round(line.B / exact, 2),
        "pilot_rollouts": len(groups) * REPLICATES,
        "verdict": "right" if inside else "wrong",
    } | _of(certificate)


def _of(certificate: Certificate) -> dict[str, Any]:
    return {
        "label": certificate.label.name,
        "rollouts": certificate.rollouts,
        "B": round(certificate.ladder[0].B, 6),
        "twice_B_low_over_B": round(2 * certificate.B_low / certificate.ladder[0].B, 2),
    }


def summary(case: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return one line for all rows of a case."""
    return {
        "case": case,
        "runs": len(rows),
        "refused": sum(row["label"] == "REFUSED" for row in rows),
        "verdicts": {
            word: sum(row["verdict"] == word for row in rows)
            for word in sorted({row["verdict"] for row in rows})
        },
        "pilot_rollouts": int(np.median([row["pilot_rollouts"] for row in rows])),
        "median_rollouts": int(np.median([row["rollouts"] for row in rows])),
        "largest_twice_B_low_over_B": max(row["twice_B_low_over_B"] for row in rows),
    } | {
        f"least_{name}": min(row[name] for row in rows)
        for name in ("R_over_noise", "B_over_norm")
        if name in rows[0]
    }


def document(record: dict[str, list[dict[str, Any]]]) -> str:
    """Return a record as JSON with a line for each row."""
    parts = [
        f"{json.dumps(name)}: [\n" + ",\n".join(json.dumps(row, ensure_ascii=False) for row in rows) + "\n]"
        for name, rows in record.items()
    ]
    return "{\n" + ",\n".join(parts) + "\n}\n"


def main() -> None:
    """Run all, print a line for each run and each case."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--case", choices=[*CASES, "functions"], nargs="*", default=[*CASES, "functions"])
    parser.add_argument("--write", action="store_true", help="keep the result in the folder of results")
    options = parser.parse_args()
    shipped = [
        (name, seed, stop)
        for name, (_, seeds, stops) in CASES.items()
        if name in options.case
        for seed in seeds
        for stop in stops
    ]
    drawn = [
        (family, lengthscale, seed)
        for family in FAMILIES
        for lengthscale in LENGTHSCALES
        for seed in range(FUNCTIONS)
        if "functions" in options.case
    ]
    rows: dict[str, list[dict[str, Any]]] = {}
    with ProcessPoolExecutor(options.workers) as pool:
        for row in chain(pool.map(run, shipped), pool.map(draw, drawn)):
            rows.setdefault(row["case"], []).append(row)
            if "line" in row:
                print(row, flush=True)
    table = [summary(case, found) for case, found in rows.items()]
    for line in table:
        print(line)
    if options.write:
        runs = [row for found in rows.values() for row in found if "line" in row]
        RESULTS.write_text(document({"machine": [describe("numpy", "torch")], "cases": table, "runs": runs}))


if __name__ == "__main__":
    main()
