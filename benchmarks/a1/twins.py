"""The four twins against the nominal simulator: ρ of both and the gap between them over the test space.

Run: OMP_NUM_THREADS=1 python -m benchmarks.a1.twins [seeds]

The gap at a speed is mean ρ(nominal) − mean ρ(twin) over the seeds. A fall counts as ρ = −0.5.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks.a1.trot import rho
from benchmarks.machine import processor
from s2r_sim import SimBackend, TwinBackend
from s2r_sim.twins import PLACES

SPEEDS = (-0.2, -0.1, 0.0, 0.1, 0.2, 0.3)
WORST = {"lab": 0.3, "grass": 0.3, "sand": 0.3, "ramp": -0.2}


def table(backend: SimBackend, seeds: int) -> np.ndarray:
    """Return (speeds, seeds) ρ."""
    return np.array([[rho(backend.rollout({"vd": vd}, seed), vd) for seed in range(seeds)] for vd in SPEEDS])


def line(name: str, values: np.ndarray) -> str:
    return f"{name:14}" + "".join(f"{value:9.4f}" for value in values)


def main(seeds: int) -> bool:
    print(f"{'vd [m/s]':14}" + "".join(f"{vd:9.1f}" for vd in SPEEDS))
    nominal = table(SimBackend(), seeds)
    print(line("rho nominal", nominal.mean(axis=1)))
    met = True
    for place in PLACES:
        twin = table(TwinBackend(place), seeds)
        gap = nominal.mean(axis=1) - twin.mean(axis=1)
        error = np.sqrt((nominal.var(axis=1, ddof=1) + twin.var(axis=1, ddof=1)) / seeds)
        worst = int(np.argmax(gap))
        print(line(f"\nrho {place}", twin.mean(axis=1)))
        print(line("gap", gap))
        print(line("std error", error))
        print(f"largest gap {gap[worst]:.4f} at vd = {SPEEDS[worst]:+.1f}; falls: {np.sum(twin == -0.5)}")
        met &= bool(SPEEDS[worst] == WORST[place] and 0.08 <= gap[worst] <= 0.14)
    return met


if __name__ == "__main__":
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    print(f"{processor()}, model {SimBackend().model_hash[:16]}, {seeds} seeds")
    print("wanted: lab, grass, sand worst at +0.3 and ramp at -0.2, every largest gap in [0.08, 0.14]\n")
    met = main(seeds)
    print("\nall met" if met else "\nNOT all met")
    sys.exit(0 if met else 1)
