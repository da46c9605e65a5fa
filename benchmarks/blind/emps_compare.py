"""The blind axis beside the simulator: the same effect, the same number, other code.

Run: python -m benchmarks.blind.emps_compare        # a minute on one core

For every effect of the catalogue at a middling size: how the voltage changes, in the generator against the
catalogue. The correlation says whether the name means the same; the slope, whether the number does; neither is 1,
because the laws differ. Then, for every kind of case at its smallest and largest size, how far ρ moves at most over
eight tests, in µm: what "material" means. Each generator run is against its own nominal, without background or noise.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.emps.axis import run
from benchmarks.blind.emps.kinds import KNOWN, NEAR, UNLIKE, Kind
from benchmarks.blind.emps.machine import Machine, Nuisance
from s2r_emps import EmpsBackend
from s2r_emps.moves import Test, move, read_test
from s2r_emps.noise import Noise

FloatArray = NDArray[np.float64]
SIDE = {"speed": 0.24, "accel": 2.0, "payload": 30.0}


def without_noise(machines: list[Machine], test: dict[str, float], ticks: int) -> dict[str, FloatArray]:
    """Return logs (machines, ticks) of all machines in one test, without nuisance but the encoder's noise."""
    asked, on = move(Test(**read_test(test)), ticks)
    n = len(machines)
    still = [Nuisance(0.0, 1.0, 0.0, 1.0, 1)] * n  # one seed: their noise is the same and cancels
    logs = run(machines, [test["payload"]] * n, np.tile(asked, (n, 1)), np.tile(on, (n, 1)), still)
    return logs | {"error": np.abs(logs["q"] - asked)}


def sized(kind: Kind, size: float) -> tuple[Machine, dict[str, float]]:
    fields, values = kind.made(size, np.random.default_rng(0))
    return replace(Machine(), **fields), values


def voltages(ticks: int) -> dict[str, tuple[float, float]]:
    """Return effect → correlation and slope of the change of the voltage, smoothed over 10 ms."""
    sizes = {name: (kind.low * kind.high) ** 0.5 for name, kind in KNOWN.items()}
    made = {name: sized(KNOWN[name], size) for name, size in sizes.items()}
    theirs = without_noise([Machine(), *(machine for machine, _ in made.values())], SIDE, ticks)["u"]
    ours = EmpsBackend(noise=Noise.off(), duration=(ticks - 1) / 1000)
    nominal = ours.rollout(SIDE, 0)["u"]
    found = {}
    for k, (name, (_, values)) in enumerate(made.items(), 1):
        change = ours.with_effects({name: values}).rollout(SIDE, 0)["u"] - nominal
        pair = [np.convolve(x, np.ones(10) / 10, "valid") for x in (theirs[k] - theirs[0], change)]
        found[name] = float(np.corrcoef(*pair)[0, 1]), float(pair[0] @ pair[1] / (pair[1] @ pair[1]))
    return found


def main() -> None:
    print("effect of the catalogue: correlation and slope of the change of u, generator against catalogue")
    for name, (correlation, slope) in voltages(2501).items():
        print(f"  {name:16s} {correlation:6.3f} {slope:6.2f}")
    kinds = [*KNOWN.values(), *UNLIKE, *NEAR]
    machines = [Machine(), *(sized(kind, size)[0] for kind in kinds for size in (kind.low, kind.high))]
    moved = np.zeros(len(machines))
    for speed, accel, payload in product((0.08, 0.22), (0.7, 1.9), (0.0, 30.0)):
        test = {"speed": speed, "accel": accel, "payload": payload}
        worst = without_noise(machines, test, 2501)["error"].max(axis=1)
        moved = np.maximum(moved, np.abs(worst - worst[0]))
    print("largest change of rho over eight tests, in um: smallest size, largest size")
    for k, kind in enumerate(kinds):
        low, high = 1e6 * moved[1 + 2 * k : 3 + 2 * k]
        print(f"  {kind.name:16s} {low:8.1f} {high:8.1f}   (sizes {kind.low:g} to {kind.high:g})")


if __name__ == "__main__":
    main()
