"""Which part of the machine, and when: effects that are known, and none, on the axis and on the A1.

    python benchmarks/body.py [--nulls 100] [--a1-nulls 20] [--out benchmarks/results/body.json]

The machine is the simulator itself, with one effect of its catalogue at its typical high value, at twelve tests with
seeds of its own; nothing here stands in for hardware. Printed is the part that shows it most, by which residual and
when; then a push of 50 ms that nobody told the model of; then how often a machine that is its simulator raises an
alarm at all, at a false-discovery rate of 5 % in each case.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from machine import describe

import s2r_spec as s2r
from s2r_spec.backend import Backend
from s2r_spec.diagnose.axes import lines
from s2r_spec.diagnose.gap.where import Pairs, body_of
from s2r_spec.diagnose.residuals.shifts import Body
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.rollouts.compatibility import check_compatibility
from s2r_spec.rollouts.seeds import Stream, rollout_seed

ROLLOUTS = 12
FIRST_SEED = 10**7
PUSH = {"push": 10.0, "push_time": 0.8}
"""[N*s], [s]; 50 ms long, to the left."""


def bench_of(name: str, spec_file: str) -> Bench:
    spec = s2r.load_spec(spec_file)
    requirement = spec.requirements[0]
    backend = s2r.load_backend(name).with_duration(spec.horizon(requirement))
    return Bench(backend, spec, requirement, check_compatibility(spec, requirement, backend))


def compare(bench: Bench, machine: Backend, case: int, more: Mapping[str, float]) -> Body:
    rng = np.random.default_rng(case)
    space = bench.spec.space
    tests = [
        space.point(space.lower + rng.random(space.dim) * (space.upper - space.lower))
        for _ in range(ROLLOUTS)
    ]
    real, simulated = [], []
    for i, test in enumerate(tests):
        trace = machine.rollout(bench.matched.to_backend(test) | dict(more), FIRST_SEED + 1000 * case + i)
        real.append((trace, 0.0))
        simulated.append((bench.run({}, test, rollout_seed(case, i, 0, Stream.CHECK)), 0.0))
    found, why = body_of(bench, Pairs(tests, real, simulated), case)
    if found is None:
        raise SystemExit(why)
    return found


def row(name: str, found: Body) -> dict[str, Any]:
    first = found.shifted[0] if found.shifted else None
    entry = {
        "cause": name,
        "parts": [part.name for part in found.shifted],
        "first": None if first is None else first.name,
        "shift": None if first is None else asdict(first.shifts[0]),
    }
    words = "nothing"
    if first is not None:
        s = first.shifts[0]
        size = f"{s.channel} ({s.kind}) {s.mean:+.3g} {s.unit}".rstrip()
        words = f"{first.name:14} {size}, {s.begin:.2f} to {s.end:.2f} s, {s.sigma:.0f} σ"
    print(f"  {name:32} {len(found.shifted):2} parts, first {words}", flush=True)
    return entry


def effects(bench: Bench) -> list[dict[str, Any]]:
    """Each parameter of each effect by itself; one that needs another to do anything (a phase, say) is left out."""
    rows = []
    middle = bench.matched.to_backend(
        bench.spec.space.point((bench.spec.space.lower + bench.spec.space.upper) / 2)
    )
    nominal = bench.backend.rollout(middle, 0)
    for line in lines(bench.backend.effects()):
        value = line.at_typical()
        machine = bench.with_effects(line.at(value))
        changed = machine.rollout(middle, 0)
        if any(not np.array_equal(changed[name], nominal[name]) for name in nominal.channels):
            name = f"{line.name} = {value:.3g} {line.unit}".rstrip()
            rows.append(row(name, compare(bench, machine, 1, {})))
    return rows


def nulls(bench: Bench, count: int) -> dict[str, float]:
    from scipy.stats import beta

    alarms = sum(bool(compare(bench, bench.backend, 100 + case, {}).shifted) for case in range(count))
    upper = float(beta.ppf(0.95, alarms + 1, count - alarms)) if alarms < count else 1.0
    print(f"  nothing changed: {alarms} alarms in {count} cases (95 %: at most {upper:.3f})", flush=True)
    return {"cases": count, "alarms": alarms, "rate_at_most_95": round(upper, 4)}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--nulls", type=int, default=100)
    parser.add_argument("--a1-nulls", type=int, default=20)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    results: dict[str, Any] = {"machine": describe("numpy", "scipy", "mujoco"), "rollouts": ROLLOUTS}
    for name, spec_file, count in (
        ("emps", "specs/emps_tracking.stl", chosen.nulls),
        ("sim", "specs/a1_velocity.stl", chosen.a1_nulls),
    ):
        bench = bench_of(name, spec_file)
        print(name, flush=True)
        results[name] = {"effects": effects(bench)}
        if name == "sim":
            results[name]["push"] = row("a push of 10 N*s from 0.8 s", compare(bench, bench.backend, 2, PUSH))
        results[name]["nulls"] = nulls(bench, count)
    if chosen.out is not None:
        chosen.out.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
