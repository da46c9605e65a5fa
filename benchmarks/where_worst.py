"""Is the worst test that a diagnosis names from 30 rollouts the worst test of the whole test space?

    python benchmarks/where_worst.py emps            # a few minutes
    python benchmarks/where_worst.py sim             # the A1: some 20 minutes

The machine is the simulator with one effect of its catalogue at its typical high value, and seeds of its own; nothing
here stands in for hardware. The truth is E|Δρ| on a grid of the test space that the diagnosis does not see (216 places
of the axis' three parameters, 26 of the A1's one), four rollouts of either side at every place. An effect that moves no
place by three times the scatter is left out. Printed for each effect: how far the named test is from the truth's, on
its widest axis as a part of that, and how large the gap there is as a part of the largest. The second matters more:
a gap that hardly changes with the payload has its worst place anywhere along it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from machine import describe

import s2r_spec as s2r
from s2r_spec.backend import Backend
from s2r_spec.diagnose.axes import lines
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.diagnose.where.gaps import GapAt
from s2r_spec.diagnose.where.space import in_space
from s2r_spec.rollouts.match import match

TESTS, AGAIN = 18, 6
"""Different tests, and how many of them run three times: 30 rollouts."""
ACROSS = {1: 26, 3: 6}
"""Number of test parameters → places of the grid along each axis."""
SPECS = {"emps": "specs/emps_tracking.stl", "sim": "specs/a1_velocity.stl"}
MOVES = 3.0
"""An effect counts if its largest gap is more than so many times what scatter alone makes."""
SHOTS = 4
NEAR = 0.1
"""Part of an axis within which the worst test should be found."""
ENOUGH = 0.9
"""Part of the largest gap that there should be at the named test."""


def bench_of(name: str, spec_file: str) -> Bench:
    """Set a spec up on a simulator."""
    spec = s2r.load_spec(spec_file)
    requirement = spec.requirements[0]
    backend = s2r.load_backend(name).with_duration(spec.horizon(requirement))
    return Bench(backend, spec, requirement, match(spec, requirement, backend))


def rho(bench: Bench, backend: Backend, test: dict[str, float], seed: int) -> float:
    """Return ρ of one rollout."""
    return bench.rho(backend.rollout(bench.matched.to_backend(test), seed), test)


def drawn(bench: Bench, case: int) -> list[dict[str, float]]:
    """Return the tests of 30 rollouts, evenly over the space, a third of them three times."""
    rng = np.random.default_rng(case)
    space = bench.spec.space
    parts = np.stack([rng.permutation(TESTS) for _ in range(space.dim)], axis=1)
    unit = (parts + rng.uniform(size=parts.shape)) / TESTS
    tests = [space.point(p) for p in space.lower + (space.upper - space.lower) * unit]
    return tests + [tests[i] for i in rng.permutation(TESTS)[:AGAIN] for _ in range(2)]


def compare(bench: Bench, machine: Backend, case: int) -> dict[str, Any]:
    """Name the worst test from 30 rollouts, then look for it on the grid."""
    space = bench.spec.space
    runs: dict[tuple[tuple[str, float], ...], list[tuple[float, float]]] = {}
    for number, test in enumerate(drawn(bench, case)):
        pair = rho(bench, machine, test, 10**7 + number), rho(bench, bench.backend, test, 2 * 10**7 + number)
        runs.setdefault(tuple(sorted(test.items())), []).append(pair)
    gaps = tuple(
        GapAt(dict(key), *np.array(pairs).T)  # real, simulated
        for key, pairs in runs.items()
    )
    found = in_space(space, gaps, bench.spec.unit(bench.requirement), seed=case)
    grid = space.grid((ACROSS[space.dim],) * space.dim)

    def gap(place: np.ndarray[Any, Any], seed: int) -> float:
        test = space.point(place)
        real = [rho(bench, machine, test, 3 * 10**7 + seed * SHOTS + s) for s in range(SHOTS)]
        own = np.mean([rho(bench, bench.backend, test, 4 * 10**7 + seed * SHOTS + s) for s in range(SHOTS)])
        return float(np.abs(np.array(real) - own).mean())

    true = np.array([gap(place, i) for i, place in enumerate(grid)])
    named = space.vector(found.worst)
    worst = grid[true.argmax()]
    return {
        "named": dict(found.worst),
        "true": space.point(worst),
        "away": round(float((np.abs(named - worst) / (space.upper - space.lower)).max()), 3),
        "moves": bool(true.max() > MOVES * found.floor),
        "gap_there": round(gap(named, len(grid)) / float(true.max()), 3),
        "inside": bool(
            all(
                found.worst_in[n][0] - 1e-9 <= v <= found.worst_in[n][1] + 1e-9
                for n, v in space.point(worst).items()
            )
        ),
    }


def main() -> None:
    """Ask it of every effect."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sim", choices=tuple(SPECS))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "where_worst.json")
    given = parser.parse_args()
    bench = bench_of(given.sim, SPECS[given.sim])
    rows: dict[str, Any] = {}
    for case, line in enumerate(one for one in lines(bench.backend.effects()) if not one.base):
        if line.effect in rows:
            continue  # how an effect acts, not how much
        value = line.at_typical()
        machine = bench.backend.with_effects({line.effect: {line.parameter: value}})
        rows[line.effect] = one = compare(bench, machine, case)
        print(
            f"{line.effect:16} named {one['named']}, true {one['true']}: {one['away']:.2f} away, "
            f"{100 * one['gap_there']:.0f} % of the largest gap{'' if one['moves'] else '; does not move rho'}",
            flush=True,
        )
    seen = [one for one in rows.values() if one["moves"]]
    near = sum(one["away"] <= NEAR for one in seen)
    enough = sum(one["gap_there"] >= ENOUGH for one in seen)
    inside = sum(one["inside"] for one in seen)
    print(
        f"within a tenth of every axis: {near} of {len(seen)}; the gap there is {ENOUGH:.0%} of the largest or "
        f"more: {enough}; the true worst is in the box that is answered: {inside}"
    )
    summary = {"effects": len(seen), "near": near, "enough": enough, "inside": inside}
    kept = json.loads(given.out.read_text()) if given.out.exists() else {}
    kept[given.sim] = {"machine": describe("scipy"), "summary": summary, "effects": rows}
    given.out.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
