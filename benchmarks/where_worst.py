"""Is the worst test that a diagnosis names from 30 rollouts the worst test of the whole test space?

    python benchmarks/where_worst.py emps            # some 10 minutes of two cores
    python benchmarks/where_worst.py emps --twin     # the same of machines by other code
    python benchmarks/where_worst.py sim             # the A1: some 2 hours
    python benchmarks/where_worst.py sim --twin

The machine is the simulator with one effect of its catalogue at its typical high value, and seeds of its own; or,
with ``--twin``, one with one effect of a random size from the generator of the blind check (benchmarks/blind): other
code, and a little of everything else. Nothing here stands in for hardware. The truth is E|Δρ| on a grid of the test
space that the diagnosis does not see (216 places of the axis' three parameters, 26 of the A1's one), 12 or 4 rollouts
of either side at every place. An effect that moves no place by three times the scatter is left out. Printed for each
effect: how far the named test is from the truth's, on its widest axis as a part of that, and how large the gap there
is as a part of the largest. The second matters more: a gap that hardly changes with the payload has its worst place
anywhere along it. The same is kept of what a Gaussian process over the measured gaps alone would have named.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "backends")]

import s2r_spec as s2r  # noqa: E402
from benchmarks.machine import describe  # noqa: E402
from s2r_spec.backend import load_backend  # noqa: E402
from s2r_spec.diagnose.axes import lines  # noqa: E402
from s2r_spec.diagnose.gap.materiality import RolloutsAtTest  # noqa: E402
from s2r_spec.diagnose.gap.surface import gap_surface  # noqa: E402
from s2r_spec.diagnose.simulate import Bench  # noqa: E402
from s2r_spec.trace import Trace  # noqa: E402

FloatArray = NDArray[np.float64]
Test = dict[str, float]
Rollouts = list[tuple[Test, Trace]]
Run = Callable[[list[Test], int], list[Trace]]
"""From tests and a seed to a rollout of each."""

TESTS, AGAIN = 18, 6
"""Different tests, and how many of them run three times: 30 rollouts."""
ACROSS = {1: 26, 3: 6}
"""Number of test parameters → places of the grid along each axis."""
SPECS = {"emps": "specs/emps_tracking.stl", "sim": "specs/a1_velocity.stl"}
MOVES = 3.0
"""An effect counts if its largest gap is more than so many times what scatter alone makes."""
SHOTS = {"emps": 12, "sim": 4}
"""Rollouts of either side at every place."""
NEAR = 0.1
"""Part of an axis within which the worst test should be found."""
ENOUGH = 0.9
"""Part of the largest gap that there should be at the named test."""


@cache
def bench(sim: str) -> Bench:
    """Set the spec up on a simulator."""
    spec = s2r.load_spec(ROOT / SPECS[sim])
    return Bench.of(spec, spec.requirements[0], sim)


def names(sim: str, twin: bool) -> list[str]:
    """Return the effects that are tried."""
    if not twin:
        found = (line.effect for line in lines(load_backend(sim).effects()) if not line.base)
        return list(dict.fromkeys(found))
    if sim == "emps":
        from benchmarks.blind.emps.kinds import KNOWN as AXIS

        return sorted(AXIS)
    from benchmarks.blind.a1.effects import KNOWN as LEGS

    return sorted(LEGS)


def same(sim: str, effect: str) -> Run:
    """Return the simulator with an effect at its typical high value."""
    backend = bench(sim).backend
    line = next(one for one in lines(backend.effects()) if one.effect == effect and not one.base)
    machine = backend.with_effects({effect: {line.parameter: line.at_typical()}})

    def run(tests: list[Test], seed: int) -> list[Trace]:
        asked = [bench(sim).matched.to_backend(test) for test in tests]
        return [machine.rollout(test, seed + k) for k, test in enumerate(asked)]

    return run


def other_axis(effect: str, case: int) -> Run:
    """Return an axis of the blind check's generator."""
    from benchmarks.blind.emps import cases

    kinds = [cases.KNOWN[effect]]
    drawn = cases.machine_of(np.random.default_rng([11, case]), kinds)

    def run(tests: list[Test], seed: int) -> list[Trace]:
        rng = np.random.default_rng(seed)
        nuisances = [cases.drawn_nuisance(rng) for _ in tests]
        made = cases.realise([cases.Plan(drawn.machine, drawn.bare, tests, [], nuisances, {"effects": {}})])
        return [trace for _, trace in made[0].rollouts]

    return run


def other_robot(effect: str, case: int) -> Run:
    """Return a robot of the blind check's generator; one that falls at either end gets less of the effect."""
    from benchmarks.blind.a1 import cases

    kind = cases.KNOWN[effect]
    size = cases.log_uniform(np.random.default_rng([11, case]), kind.low, kind.high)
    runner = cases.Runner(cases.twin_of([kind], {effect: size}, case)[0])
    while any(runner.run(vd, np.random.default_rng([case, 1])).failure for vd in cases.RANGE):
        size *= 0.75
        runner = cases.Runner(cases.twin_of([kind], {effect: size}, case)[0])

    def run(tests: list[Test], seed: int) -> list[Trace]:
        return [runner.run(test["vd"], np.random.default_rng([seed, k])) for k, test in enumerate(tests)]

    return run


def machine(sim: str, twin: bool, effect: str, case: int) -> Run:
    """Return the machine with an effect."""
    if not twin:
        return same(sim, effect)
    return other_axis(effect, case) if sim == "emps" else other_robot(effect, case)


def drawn(case: int, sim: str) -> list[Test]:
    """Return the tests of 30 rollouts, evenly over the space, a third of them three times."""
    rng = np.random.default_rng(case)
    space = bench(sim).spec.space
    parts = np.stack([rng.permutation(TESTS) for _ in range(space.dim)], axis=1)
    unit = (parts + rng.uniform(size=parts.shape)) / TESTS
    tests = [space.point(p) for p in space.lower + (space.upper - space.lower) * unit]
    return tests + [tests[i] for i in rng.permutation(TESTS)[:AGAIN] for _ in range(2)]


def rhos(sim: str, tests: list[Test], traces: list[Trace]) -> FloatArray:
    """Return ρ of each."""
    return np.array([bench(sim).rho(trace, test) for test, trace in zip(tests, traces, strict=True)])


@cache
def nominal(sim: str, seed: int) -> FloatArray:
    """Return (places, shots) ρ of the simulator on the grid."""
    tests = [test for test in grid_tests(sim) for _ in range(SHOTS[sim])]
    asked = [bench(sim).matched.to_backend(test) for test in tests]
    traces = [bench(sim).backend.rollout(test, seed + k) for k, test in enumerate(asked)]
    return rhos(sim, tests, traces).reshape(-1, SHOTS[sim])


def grid_tests(sim: str) -> list[Test]:
    """Return the grid's."""
    space = bench(sim).spec.space
    return [space.point(place) for place in space.grid((ACROSS[space.dim],) * space.dim)]


def alone(sim: str, rollouts: Rollouts, case: int) -> Test:
    """Return the worst test as a process over the measured gaps names it, with no simulator improved."""
    tests = [test for test, _ in rollouts]
    real = rhos(sim, tests, [trace for _, trace in rollouts])
    asked = [bench(sim).matched.to_backend(test) for test in tests]
    own = rhos(sim, tests, [bench(sim).backend.rollout(test, 2 * 10**7 + k) for k, test in enumerate(asked)])
    places: dict[tuple[tuple[str, float], ...], list[int]] = {}
    for k, test in enumerate(tests):
        places.setdefault(tuple(sorted(test.items())), []).append(k)
    gaps = tuple(RolloutsAtTest(dict(key), real[mine], own[mine]) for key, mine in places.items())
    return dict(gap_surface(bench(sim).spec.space, gaps, seed=case).worst)


def compare(sim: str, twin: bool, effect: str, case: int) -> dict[str, Any]:
    """Name the worst test from 30 rollouts, then look for it on the grid."""
    set_up = bench(sim)
    space = set_up.spec.space
    run = machine(sim, twin, effect, case)
    asked = drawn(case, sim)
    rollouts = list(zip(asked, run(asked, 10**7), strict=True))
    found = s2r.diagnose(set_up.spec, sim, rollouts, seed=case).where.space
    named = {"diagnosis": dict(found.worst), "process": alone(sim, rollouts, case)}
    there = [test for test in (*grid_tests(sim), *named.values()) for _ in range(SHOTS[sim])]
    real = rhos(sim, there, run(there, 3 * 10**7)).reshape(-1, SHOTS[sim])
    last = [test for test in named.values() for _ in range(SHOTS[sim])]
    asked_of = [set_up.matched.to_backend(test) for test in last]
    more = rhos(sim, last, [set_up.backend.rollout(t, 5 * 10**7 + k) for k, t in enumerate(asked_of)])
    own = np.concatenate([nominal(sim, 4 * 10**7), more.reshape(-1, SHOTS[sim])]).mean(axis=1)
    gaps = np.abs(real - own[:, None]).mean(axis=1)
    true, at_named = gaps[: -len(named)], dict(zip(named, gaps[-len(named) :], strict=True))
    worst = grid_tests(sim)[int(true.argmax())]

    def away(test: Test) -> float:
        apart = np.abs(space.vector(test) - space.vector(worst)) / (space.upper - space.lower)
        return round(float(apart.max()), 3)

    return {
        "true": worst,
        "moves": bool(true.max() > MOVES * found.floor),
        "inside": bool(
            all(
                found.worst_within[n][0] - 1e-9 <= v <= found.worst_within[n][1] + 1e-9
                for n, v in worst.items()
            )
        ),
        **{
            how: {"named": test, "away": away(test), "gap_there": round(float(at_named[how] / true.max()), 3)}
            for how, test in named.items()
        },
    }


def main() -> None:
    """Ask it of every effect."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sim", choices=tuple(SPECS))
    parser.add_argument("--twin", action="store_true", help="machines of the blind check's generator")
    parser.add_argument("--effects", nargs="*", help="only these effects")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "where_worst.json")
    given = parser.parse_args()
    asked = [
        (given.sim, given.twin, effect, case)
        for case, effect in enumerate(names(given.sim, given.twin))
        if not given.effects or effect in given.effects
    ]
    rows: dict[str, Any] = {}
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for (_, _, effect, _), one in zip(asked, pool.map(compare, *zip(*asked, strict=True)), strict=True):
            rows[effect] = one
            said = ", ".join(
                f"{how} {[round(v, 3) for v in one[how]['named'].values()]} {one[how]['away']:.2f} away with "
                f"{100 * one[how]['gap_there']:.0f} % of the largest gap"
                for how in ("diagnosis", "process")
            )
            true = [round(v, 3) for v in one["true"].values()]
            print(
                f"{effect:16} true {true}: {said}{'' if one['moves'] else '; does not move rho'}", flush=True
            )
    seen = [one for one in rows.values() if one["moves"]]
    summary = {"effects": len(seen), "inside": sum(one["inside"] for one in seen)} | {
        how: {
            "near": sum(one[how]["away"] <= NEAR + 1e-9 for one in seen),
            "enough": sum(one[how]["gap_there"] >= ENOUGH for one in seen),
        }
        for how in ("diagnosis", "process")
    }
    print(json.dumps(summary))
    kept = json.loads(given.out.read_text()) if given.out.exists() else {}
    kept[given.sim + ("_twin" if given.twin else "")] = {
        "machine": describe("scipy"),
        "summary": summary,
        "effects": rows,
    }
    given.out.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
