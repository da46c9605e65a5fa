"""Does the joint estimate name nothing in healthy machines by other authors, and one large effect in ill ones?

python -m benchmarks.plants.diagnose [--seeds 20] [--workers 2] [--rows FOLDER] [--write]

Every machine runs two trots at three commands and every protocol twice. The estimate is `s2r_spec.diagnose.estimation`.
It prints, for each plant, how many healthy machines get no name, in how many machines with one effect this effect is
named alone, and how many of its 90 % intervals hold the truth. Labels are read after the estimates are made.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.diagnose.protocol_fit import EXPERIMENTS, SIM, is_named, responses
from benchmarks.plants import PLANTS
from benchmarks.plants.cases import KINDS, Kind, plant
from benchmarks.rows import add_arguments, resumed
from s2r_spec.diagnose.estimation import estimate
from s2r_spec.diagnose.simulator.library import library

RESULT = Path(__file__).parents[1] / "results" / "plants_diagnose.json"
RUNS = 2


def answer(job: tuple[str, Kind, int]) -> dict[str, Any]:
    """Return the answer for one machine, and beside it the truth, which the estimate has not seen."""
    name, kind, seed = job
    machine, label = plant(name, kind, seed)
    traces = {}
    for place, experiment in enumerate(EXPERIMENTS):
        streams = [np.random.default_rng([seed, place, k, *name.encode()]) for k in range(RUNS)]
        command = dict(experiment.params).get("vd", 0.0)
        traces[experiment] = [
            machine.run(experiment.protocol, rng) if experiment.protocol else machine.trot(command, rng)
            for rng in streams
        ]
    found = estimate(SIM, responses(), traces)
    parameters = responses().parameters
    effects = list(dict.fromkeys(p.effect for p in parameters))
    probabilities = dict(zip(effects, found.posterior.beyond().tolist(), strict=True))
    low, middle, high = (found.posterior.quantile(level) for level in (0.05, 0.5, 0.95))
    sizes = {
        p.name: [round(float(x), 3) for x in (low[k], middle[k], high[k])] for k, p in enumerate(parameters)
    }
    truth = f"{label.effect}.{label.parameter}" if label.effect else None
    return {
        "plant": name,
        "kind": kind,
        "seed": seed,
        "named": [effect for effect, own in zip(effects, is_named(found.posterior), strict=True) if own],
        "probability": {e: round(p, 3) for e, p in probabilities.items() if p >= 0.05},
        "sizes": sizes,
        "falls": [str(e) for e, runs in traces.items() if any(run.failure for run in runs)],
        "truth": truth,
        "size": label.size,
    }


def score(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the counts of one plant and kind."""
    if rows[0]["kind"] == "null":
        return {"machines": len(rows), "nothing named": sum(not row["named"] for row in rows)}
    named = [row["truth"].split(".")[0] in row["named"] for row in rows]
    alone = [row["named"] == [row["truth"].split(".")[0]] for row in rows]
    inside = [row["sizes"][row["truth"]][0] <= row["size"] <= row["sizes"][row["truth"]][2] for row in rows]
    return {
        "machines": len(rows),
        "effect named": sum(named),
        "named alone": sum(alone),
        "in the interval": sum(inside),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    add_arguments(parser)
    given = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"
    library(SIM, EXPERIMENTS, partial(ProcessPoolExecutor, given.workers))
    jobs = {
        f"{name}-{kind}-{seed:02d}": (name, kind, seed)
        for seed in range(given.seeds)
        for name in PLANTS
        for kind in KINDS
    }
    found = []
    with ProcessPoolExecutor(given.workers) as pool:
        for row in resumed(answer, jobs, pool, given.rows):
            found.append(row)
            truth = (
                f"{row['truth']} {row['size']:+.2f}, estimate {row['sizes'][row['truth']]}"
                if row["truth"]
                else "-"
            )
            print(
                row["plant"],
                row["seed"],
                truth,
                "named",
                row["named"],
                row["probability"],
                row["falls"],
                flush=True,
            )
    scores = {}
    for name in PLANTS:
        for kind in KINDS:
            scores[f"{name}, {kind}"] = score([r for r in found if r["plant"] == name and r["kind"] == kind])
            print(f"{name}, {kind}:", scores[f"{name}, {kind}"])
    if given.write:
        RESULT.write_text(json.dumps({"scores": scores, "machines": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
