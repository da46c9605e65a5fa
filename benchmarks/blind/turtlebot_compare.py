"""The blind turtlebot beside the simulator: the same effect, the same number, other code.

Run: python -m benchmarks.blind.turtlebot_compare        # half a minute on one core

For every effect of the catalogue at a middling size: how the motion changes, in the generator against the catalogue,
without noise. The correlation says whether the name means the same; the slope, whether the number does. Neither is 1,
because the laws differ. Beside them is the change of ρ in mm in both. Then, for every cause at its smallest and largest
size: the largest change of ρ over eight tests in mm, and the rms change of the path in mm. These say what "material"
means.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.outsiders.cases import Cause, stratified
from benchmarks.blind.turtlebot import machine
from s2r_spec.spec import load_spec
from s2r_spec.trace import Trace
from s2r_turtlebot import Constants
from s2r_turtlebot.effects import TurtlebotWithEffects

CHANNELS = {"x": 1.0, "y": 1.0, "heading": 0.2, "v": 1.0, "w": 0.2}
"""Definition: weights with which channels in their own units count."""
LAWS = {"jitter": 0.2, "first_stage": 0.7, "out_of_round": 0.2, "rounding": 12.0, "place": 0.0, "since": 2.0}
"""Definition: numbers of a middling machine without noise."""

Tests = Sequence[Mapping[str, float]]
FloatArray = NDArray[np.float64]


def spread(count: int) -> list[dict[str, float]]:
    """Return tests spread over the test space."""
    return stratified(load_spec(machine.SPEC), np.random.default_rng(0), count)


def theirs(values: Mapping[str, float], at: Tests) -> list[Trace]:
    """Return the generator's runs, without noise but where the robot is put."""
    return [machine.drive(LAWS | values, test, seed) for seed, test in enumerate(at)]


def ours(values: Mapping[str, Mapping[str, float]], at: Tests) -> list[Trace]:
    """Return the simulator's runs without slip."""
    quiet = replace(TurtlebotWithEffects(), constants=replace(Constants(), slip=0.0))
    return [quiet.with_effects(values).rollout(test, 0) for test in at]


def motion(runs: Sequence[Trace]) -> FloatArray:
    """Return all channels of all runs, weighted, in one row."""
    return np.concatenate([weight * run[name] for run in runs for name, weight in CHANNELS.items()])


def path(runs: Sequence[Trace]) -> FloatArray:
    """Return the positions [m] of all runs in one row."""
    return np.concatenate([run[name] for run in runs for name in ("x", "y")])


def rho(runs: Sequence[Trace], at: Tests) -> FloatArray:
    """Return ρ [m] of every run."""
    spec = load_spec(machine.SPEC)
    return np.array(
        [spec.robustness(run, dict(test))["delivers"] for run, test in zip(runs, at, strict=True)]
    )


def compared(cause: Cause, size: float, at: Tests) -> tuple[float, float, float, float]:
    """Return correlation and slope of the change of the motion, and the mean change of ρ [m] in both."""
    value = cause.made(size)
    pairs = [
        (theirs({cause.name: value}, at), theirs({}, at)),
        (ours({cause.name: {cause.parameter: value}}, at), ours({}, at)),
    ]
    one, other = (motion(with_it) - motion(without) for with_it, without in pairs)
    moved = [float(np.mean(rho(with_it, at) - rho(without, at))) for with_it, without in pairs]
    correlation = float(one @ other / np.sqrt((one @ one) * (other @ other)))
    return correlation, float(one @ other / (other @ other)), *moved


def main() -> None:
    at = spread(8)
    bare = theirs({}, at)
    print("effect of the catalogue: correlation and slope of the change of the motion, and Δρ [mm] in both")
    for cause in machine.KNOWN:
        for sign in (1, -1) if cause.signed else (1,):
            size = sign * (cause.sizes[0] * cause.sizes[1]) ** 0.5
            correlation, slope, here, there = compared(cause, size, at)
            numbers = f"{correlation:6.3f} {slope:6.2f} {1e3 * here:7.1f} {1e3 * there:7.1f}"
            print(f"  {cause.name:16s} {cause.made(size):7.3f} {numbers}")
    print("largest Δρ [mm] over eight tests and rms Δ of the path [mm], at the smallest and the largest size")
    for cause in (*machine.KNOWN, *machine.UNKNOWN):
        row = []
        for size in cause.sizes:
            runs = theirs({cause.name: cause.made(size)}, at)
            row += [np.abs(rho(runs, at) - rho(bare, at)).max(), np.std(path(runs) - path(bare))]
        numbers = " ".join(f"{1e3 * number:8.1f}" for number in row)
        print(
            f"  {cause.name:20s} {numbers}   ({cause.made(cause.sizes[0]):.3g} to {cause.made(cause.sizes[1]):.3g})"
        )


if __name__ == "__main__":
    main()
