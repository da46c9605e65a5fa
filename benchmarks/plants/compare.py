"""Are the two plants as good a model of a healthy A1 as the simulator is? A comparison of nominal machines.

Run: OMP_NUM_THREADS=1 python -m benchmarks.plants.compare [--write]

For each protocol, and for trots at three commands, it prints the rms over samples and joints of the difference from the
simulator: in joint angle, torque and the base's height and, for trots, in forward velocity. Noise is reduced first:
trots are averaged over the gait cycles of the last second, and protocols over 10 ms. Beside the two plants are the
blind generator, another model of the same robot, and a second seed of the simulator. All machines are nominal. In a
trot, feet stand a little wider or narrower from seed to seed, which moves the hips' angles.

Then how far feet sink on soft ground, as parts of the catalogue's ``sink``, in standing and in the trot.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.a1.protocols import Bench
from benchmarks.blind.a1.rollout import Runner
from benchmarks.blind.a1.twin import Twin
from benchmarks.machine import describe
from benchmarks.plants import PLANTS, Plant
from benchmarks.plants.machine import Machine
from benchmarks.plants.robot import PROTOCOLS
from benchmarks.plants.rollout import PERIOD
from s2r_sim.backend import SimBackend
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Source = Callable[[str, int], Trace]
"""A protocol's name or a command of a trot [m/s], and a seed → trace."""

RESULT = Path(__file__).parents[1] / "results" / "plants.txt"
COMMANDS = ("-0.2", "0.1", "0.3")
SMOOTHING = 5
"""Definition: samples over which protocols are averaged before they are compared, 10 ms."""
SINK = 0.01
"""Definition: the ``sink`` of the soft ground [m]."""


def cycle(trace: Trace, name: str) -> FloatArray:
    """Return (PERIOD, width) a channel's mean over the gait's cycles, from FR's touch-down on."""
    samples = trace[name].reshape(len(trace), -1)
    down = np.flatnonzero(np.diff(trace["stance"][:, 0]) > 0) + 1
    down = down[(down >= 250) & (down + PERIOD <= len(trace))]
    return np.mean([samples[k : k + PERIOD] for k in down], axis=0)


def smoothed(trace: Trace, name: str) -> FloatArray:
    """Return (n, width) a channel's means over 10 ms."""
    samples = trace[name].reshape(len(trace), -1)
    whole = len(samples) // SMOOTHING * SMOOTHING
    return samples[:whole].reshape(-1, SMOOTHING, samples.shape[1]).mean(axis=1)


def difference(trace: Trace, other: Trace, name: str) -> float:
    """Return the rms difference of a channel."""
    view = cycle if "stance" in trace else smoothed
    return float(np.sqrt(np.mean((view(trace, name) - view(other, name)) ** 2)))


def sources() -> dict[str, Source]:
    """Return the nominal machines."""
    sim, runner, bench = SimBackend(), Runner(Twin()), Bench(Twin())

    def of_sim(what: str, seed: int) -> Trace:
        return sim.run(what, {}, seed) if what in PROTOCOLS else sim.rollout({"vd": float(what)}, seed)

    def of_generator(what: str, seed: int) -> Trace:
        rng = np.random.default_rng(seed)
        return bench.run(what, rng) if what in PROTOCOLS else runner.run(float(what), rng)

    def of_plant(plant: Plant) -> Source:
        def source(what: str, seed: int) -> Trace:
            rng = np.random.default_rng(seed)
            return plant.run(what, rng) if what in PROTOCOLS else plant.trot(float(what), rng)

        return source

    made = {name: of_plant(Plant(author, Machine())) for name, author in PLANTS.items()}
    return {"simulator": of_sim, **made, "generator": of_generator}


def sunk(trace: Trace) -> float:
    """Return the mean depth of the feet that touch the ground [m]."""
    depth = 0.02 - trace["foot_position"][:, 2::3]
    return float(depth[trace["contact"] > 0].mean())


def tracking() -> Iterator[str]:
    """Yield the lines of the first table."""
    of = sources()
    units = {"q": ("mrad", 1e3), "tau": ("N m", 1.0), "height": ("mm", 1e3), "vx": ("mm/s", 1e3)}
    heads = "".join(f"{f'{name} [{unit}]':>13}" for name, (unit, _) in units.items())
    yield f"{'':10} {'machine':10} {'CPU [s]':>7}{heads}{'rms tau':>9}"
    for what in (*COMMANDS, *PROTOCOLS):
        nominal = of["simulator"](what, 1)
        for name, source in of.items():
            source(what, 2)  # compile
            began = time.process_time()
            trace = source(what, 2)
            seconds = time.process_time() - began
            row = "".join(
                f"{factor * difference(nominal, trace, channel):13.3f}"
                if channel != "vx" or what in COMMANDS
                else f"{'':13}"
                for channel, (_, factor) in units.items()
            )
            level = float(np.sqrt(np.mean(trace["tau"] ** 2)))
            yield f"{what:10} {name:10} {seconds:7.2f}{row}{level:9.3f} {trace.failure or ''}".rstrip()


def sinking() -> Iterator[str]:
    """Yield the lines of the second table."""
    yield f"mean depth of standing feet on soft ground of sink {SINK} m, as part of it"
    sim = SimBackend().with_effects({"soft_ground": {"sink": SINK}})
    runs = {"simulator": (sim.run("squat", {}, 1), sim.rollout({"vd": 0.1}, 1))}
    for name, author in PLANTS.items():
        plant = Plant(author, Machine({"soft_ground.sink": SINK}))
        runs[name] = plant.run("squat", np.random.default_rng(1)), plant.trot(0.1, np.random.default_rng(1))
    for name, (squat, trot) in runs.items():
        yield f"{name:10} squat {sunk(squat) / SINK:.2f}  trot {sunk(trot) / SINK:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"write {RESULT.name}")
    write = parser.parse_args().write
    lines = [json.dumps(describe("mujoco", "numba", "numpy", "pin"))]
    for line in (*tracking(), "", *sinking()):
        print(line)
        lines.append(line)
    if write:
        RESULT.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
