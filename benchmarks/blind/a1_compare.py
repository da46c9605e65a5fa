"""The blind generator beside the simulator: the same effect, the same numbers, other code.

Run: OMP_NUM_THREADS=1 python -m benchmarks.blind.a1_compare [effect ...]

For every effect of the catalogue, at the values shown: the gap mean ρ(nominal) − mean ρ(with it) at three speeds,
made by the catalogue (c) and by the generator (g), each against its own nominal and without background; then
how alike their changes of the trace are: the cosine between the two vectors of changed features, the part of the
catalogue's change that the generator makes (by projection), and the catalogue's three strongest changes, each beside
the generator's. Features are scaled by how much the catalogue's effects move them.

Below it what the generator's other effects do to ρ at their smallest and largest, and the gap between the simulator
and robots that have nothing but background: what a diagnosis must not take for an effect.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks.a1.effects import MAGNITUDES, NAMES, features
from benchmarks.a1.trot import rho
from benchmarks.blind.a1.cases import twin_of
from benchmarks.blind.a1.effects import KNOWN, UNKNOWN
from benchmarks.blind.a1.rollout import Runner
from benchmarks.blind.a1.twin import Twin
from benchmarks.machine import processor
from s2r_sim import SimBackend
from s2r_spec.trace import Trace

SPEEDS = (-0.2, 0.0, 0.3)
SEEDS = 3
NOMINAL_SEEDS = 10
ROBOTS = 10
LARGE = {"torque_speed_line": 2, "shear_creep": 2}
"""Which of the magnitudes of ``a1/effects.py`` is shown, if not the middle one: these hardly show at that."""
NOTHING = [np.nan] * len(NAMES)
ZEROS = dict.fromkeys(("x", "y", "z", "hip", "thigh", "calf", "roll", "pitch", "forward", "left"), 0.0)
Found = tuple[np.ndarray, np.ndarray, int]


def gathered(traces: list[list[Trace]]) -> Found:
    """Return (speeds,) mean ρ, (speeds, features) means and the number of falls."""
    found = [np.mean([rho(trace, vd) for trace in row]) for vd, row in zip(SPEEDS, traces, strict=True)]
    falls = sum(trace.failure is not None for row in traces for trace in row)
    seen = [
        np.mean(
            [list(features(trace).values()) for trace in row if not trace.failure] or [NOTHING],
            axis=0,
        )
        for row in traces
    ]
    return np.array(found), np.array(seen), falls


def simulated(name: str, values: dict[str, float], seeds: int) -> Found:
    backend = SimBackend().with_effects({name: values} if name else {})
    return gathered([[backend.rollout({"vd": vd}, seed) for seed in range(seeds)] for vd in SPEEDS])


def generated(name: str, values: dict[str, float], seeds: int) -> Found:
    twin = Twin()
    if name:
        KNOWN[name].apply(twin, np.random.default_rng(5), ZEROS | values)
    runner = Runner(twin)
    return gathered([[runner.run(vd, np.random.default_rng(seed)) for seed in range(seeds)] for vd in SPEEDS])


def unknowns(nominal: np.ndarray) -> None:
    print(
        "\neffects that the catalogue does not have, generator alone: gap at the smallest and the largest size"
    )
    for kind in UNKNOWN.values():
        for size in (kind.low, kind.high):
            twin, effects = twin_of([kind], {kind.name: size}, seed=1, background=0.0)
            runner = Runner(twin)
            rows = [[runner.run(vd, np.random.default_rng(seed)) for seed in range(2)] for vd in SPEEDS]
            found, _, falls = gathered(rows)
            print(
                f"{kind.name:18} {words(effects[kind.name]):46} {numbers(nominal - found, falls)}", flush=True
            )


def robots(simulator: np.ndarray) -> None:
    print(f"\n{ROBOTS} robots with nothing but background: simulator − robot, mean ρ of 2 runs")
    gaps = []
    for seed in range(ROBOTS):
        runner = Runner(twin_of([], {}, seed)[0])
        rows = [[runner.run(vd, np.random.default_rng([seed, k])) for k in range(2)] for vd in SPEEDS]
        found, _, falls = gathered(rows)
        gaps.append(simulator - found)
        print(f"  {numbers(gaps[-1], falls)}", flush=True)
    print(f"  mean |gap| {np.abs(gaps).mean():.4f}, largest {np.abs(gaps).max():.4f} m/s")


def words(values: dict[str, float]) -> str:
    return " ".join(f"{key}={value:g}" for key, value in values.items())


def numbers(gap: np.ndarray, falls: int) -> str:
    return " ".join(f"{value:7.3f}" for value in gap) + (f" {falls} fell" if falls else "")


def main(names: list[str]) -> None:
    sim, gen = simulated("", {}, NOMINAL_SEEDS), generated("", {}, NOMINAL_SEEDS)
    print("nominal, mean ρ at " + ", ".join(f"{vd:+.1f}" for vd in SPEEDS))
    print(f"  simulator {sim[0].round(4)}\n  generator {gen[0].round(4)}")
    print("nominal features, generator − simulator, largest over the speeds:")
    away = gen[1] - sim[1]
    for k, feature in enumerate(NAMES):
        most = np.abs(away[:, k]).argmax()
        print(f"  {feature:14} {away[most, k]:+10.5f}  (simulator {sim[1][most, k]:+.5f})")
    rows = []
    for name, magnitudes in MAGNITUDES.items():
        if names and name not in names:
            continue
        values = dict(magnitudes[LARGE.get(name, 1)])
        rows.append((name, values, simulated(name, values, SEEDS), generated(name, values, SEEDS)))
        print(".", end="", file=sys.stderr, flush=True)
    moved = np.array([np.nan_to_num(row[2][1] - sim[1]) for row in rows])
    scale = np.sqrt(np.mean(moved**2, axis=(0, 1))) + 1e-12
    print(f"\n{'effect':18} {'values':22}   {'-0.2':>7} {'0.0':>7} {'+0.3':>7}  alike  part")
    for name, values, (rho_c, seen_c, falls_c), (rho_g, seen_g, falls_g) in rows:
        c, g = (seen_c - sim[1]) / scale, (seen_g - gen[1]) / scale
        norm = np.linalg.norm(c) * np.linalg.norm(g)
        alike, part = np.sum(c * g) / norm, np.sum(c * g) / np.sum(c * c)
        print(f"{name:18} {words(values):22} c {numbers(sim[0] - rho_c, falls_c)}  {alike:5.2f} {part:5.2f}")
        fastest = np.abs(c).argmax(axis=0)
        strongest = np.argsort(-np.abs(c).max(axis=0))[:3]
        signs = ", ".join(
            f"{NAMES[k]} {c[fastest[k], k] * scale[k]:+.4f} / {g[fastest[k], k] * scale[k]:+.4f}"
            for k in strongest
        )
        print(f"{'':18} {'':22} g {numbers(gen[0] - rho_g, falls_g)}  {signs}", flush=True)
    if not names:
        unknowns(gen[0])
        robots(sim[0])


if __name__ == "__main__":
    print(
        f"{processor()}, model {SimBackend().model_hash[:16]}, {SEEDS} seeds a speed, {NOMINAL_SEEDS} for the nominal"
    )
    main(sys.argv[1:])
