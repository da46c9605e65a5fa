"""Are sizes and probabilities of effects calibrated? Simulation-based calibration of the diagnosis.

python -m benchmarks.diagnose.calibration [--machines arm car quad segway] [--count 60] [--rows FOLDER] [--write]

Data: two runs of each protocol and of some tests, in the middle of the space and at both ends of each parameter. The
machines are drawn from the prior of the model (`docs/explanation/diagnosis-model.md`). Unknown: θ (K,), their sizes. In
each kind of motion the simulator runs at θ + b. b is the error of size of this kind, with the part that all share:

    b_k ~ N(0, σ_c² + ρ0² θ_k²), in common,  + N(0, ρ0² θ_k²), of each kind

Other errors of the model are not drawn: those of form, those of a group, and variants.

It prints how many truths are in the 50 % and 90 % intervals, of large and of other sizes. Then it sorts all effects of
all machines by their posterior probability of at least a quarter of typical, and prints how often this is true.
Source: Talts et al., *Validating Bayesian Inference Algorithms with Simulation-Based Calibration* (2018).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.development import simulator
from benchmarks.blind.outsiders.generate import MACHINES as OUTSIDERS
from benchmarks.blind.scoring import MUST
from benchmarks.rows import add_arguments, resumed
from s2r_spec.diagnose.data.rollouts import as_experiment
from s2r_spec.diagnose.data.space_filling import star
from s2r_spec.diagnose.estimation import estimate, size_prior
from s2r_spec.diagnose.inference.hierarchical import LAW_SHARE, SHARED
from s2r_spec.diagnose.inference.prior import SizePrior
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import library
from s2r_spec.diagnose.simulator.response import ResponseLibrary
from s2r_spec.protocols import HasProtocols
from s2r_spec.spec import load_spec

FloatArray = NDArray[np.float64]

RESULT = Path(__file__).parents[1] / "results" / "diagnosis_calibration.json"
RUNS = 2
"""Definition: of every experiment."""
INTERVALS = {"50 %": (0.25, 0.75), "90 %": (0.05, 0.95)}
"""Definition: name of an interval → its quantiles."""
BINS = (0.0, 0.05, 0.5, 0.95, 1.0)
"""Definition: ends of the bins of a probability: ruled out, two of *possible*, and nearly sure."""
FIRST_SEED = 10_000
"""Definition: seed of the first run; the library's own are below."""


@cache
def setup(machine: str) -> tuple[Bench, tuple[Experiment, ...]]:
    """Return the bench of a machine, and the experiments that it runs."""
    name = simulator(machine)
    spec = load_spec(Path(import_module(f"benchmarks.blind.{machine}.machine").SPEC))
    bench = Bench.of(spec, spec.requirements[0], name)
    tests = [as_experiment(bench, test) for test in star(bench.spec.space)]
    own = bench.backend.protocols() if isinstance(bench.backend, HasProtocols) else ()
    return bench, (*tests, *(Experiment(protocol.name) for protocol in own))


@cache
def responses(machine: str) -> ResponseLibrary:
    """Return the library of a machine."""
    bench, experiments = setup(machine)
    return library(bench.backend, experiments)


def drawn(prior: SizePrior, rng: np.random.Generator) -> FloatArray:
    """Return (K,) sizes from the prior."""
    active = np.flatnonzero(rng.uniform(size=prior.low.size) < prior.probability)
    deviation, theta = prior.deviation(tuple(active.tolist())), np.zeros(prior.low.size)
    outside = np.ones(theta.size, dtype=bool)
    while outside.any():
        theta[outside] = (deviation * rng.normal(size=theta.size))[outside]
        outside = (theta < prior.low) | (theta > prior.high)
    return theta


def row(job: tuple[str, int, int]) -> dict[str, Any]:
    """Return truths and answers of one machine."""
    machine, number, seed = job
    bench, experiments = setup(machine)
    found, rng = responses(machine), np.random.default_rng([seed, number])
    prior = size_prior(found)
    theta = drawn(prior, rng)
    scale = LAW_SHARE * np.abs(theta)
    common = np.hypot(SHARED, scale) * rng.normal(size=theta.size)
    own = {each.protocol: scale * rng.normal(size=theta.size) for each in experiments}
    first, traces = FIRST_SEED + RUNS * number, {}
    for each in experiments:
        size = np.clip(theta + common + own[each.protocol], prior.low, prior.high)
        backend = bench.with_effects(found.values(size))
        traces[each] = [each.run(backend, first + k) for k in range(RUNS)]
    answer = estimate(bench.backend, found, traces).posterior
    large = np.zeros(int(prior.effect.max()) + 1, dtype=bool)
    np.logical_or.at(large, prior.effect[prior.causes], np.abs(theta[prior.causes]) >= MUST)
    return {
        "machine": machine,
        "number": number,
        "truth": theta[prior.causes].tolist(),
        "intervals": {
            name: [answer.quantile(level)[prior.causes].tolist() for level in levels]
            for name, levels in INTERVALS.items()
        },
        "large": large.tolist(),
        "probability": answer.beyond(MUST).tolist(),
    }


def scored(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the shares of truths in their intervals, and of large effects in each bin of probability."""
    truth = np.concatenate([one["truth"] for one in rows])
    large, inside = np.abs(truth) >= MUST, {}
    for name in INTERVALS:
        low, high = (np.concatenate([one["intervals"][name][end] for one in rows]) for end in (0, 1))
        inside[name] = (low <= truth) & (truth <= high)
    probability = np.concatenate([one["probability"] for one in rows])
    true = np.concatenate([one["large"] for one in rows])
    place = np.clip(np.digitize(probability, BINS) - 1, 0, len(BINS) - 2)
    bins = []
    for number, (least, most) in enumerate(pairwise(BINS)):
        own = place == number
        mean, part = (_mean(each[own]) for each in (probability, true))
        bins.append(
            {"from": least, "to": most, "effects": int(own.sum()), "probability": mean, "are large": part}
        )
    return {
        "machines": len(rows),
        "large sizes": int(large.sum()),
        "other sizes": int((~large).sum()),
        "large, in the interval": {name: _mean(own[large]) for name, own in inside.items()},
        "others, in the interval": {name: _mean(own[~large]) for name, own in inside.items()},
        "effects by probability": bins,
    }


def _mean(values: NDArray[Any]) -> float | None:
    return float(values.mean()) if values.size else None


def shown(name: str, score: dict[str, Any]) -> None:
    print(f"\n{name}: {score['machines']} machines")
    for which in ("large", "others"):
        parts = [
            f"{100 * part:.0f} % in the {level} interval"
            for level, part in score[f"{which}, in the interval"].items()
            if part is not None
        ]
        count = score["large sizes" if which == "large" else "other sizes"]
        print(f"  {count} {which}: {', '.join(parts)}")
    for one in score["effects by probability"]:
        if one["effects"]:
            print(
                f"  P(large) from {one['from']:.2f} to {one['to']:.2f}: {one['effects']} effects, "
                f"mean {one['probability']:.3f}, {one['are large']:.3f} are large"
            )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--machines", nargs="+", choices=list(OUTSIDERS), default=list(OUTSIDERS))
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=47)
    add_arguments(parser)
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    result: dict[str, Any] = {"seed": given.seed}
    for machine in given.machines:
        responses(machine)
        jobs = {
            f"{machine}-{given.seed}-{number:03d}": (machine, number, given.seed)
            for number in range(given.count)
        }
        with ProcessPoolExecutor(given.workers) as pool:
            own = list(resumed(row, jobs, pool, given.rows))
        result[machine] = scored(own)
        shown(machine, result[machine])
        rows += own
    result["all"] = scored(rows)
    shown("all", result["all"])
    if given.write:
        RESULT.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
