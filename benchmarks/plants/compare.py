"""Are the two plants as good a model of a healthy A1 as the simulator is? A comparison of nominal machines.

Run: OMP_NUM_THREADS=1 python -m benchmarks.plants.compare

For each protocol and for trots at three commands: the rms over samples and joints of the difference of a plant from the
simulator, in joint angle, in torque, in the base's height, and, for trots, in forward velocity. Trots are first averaged
over gait cycles of the last second, from FR's touch-down on; so is the noise. Beside it the same figures of the blind
generator, another model of the same robot, and of a second seed of the simulator. All machines are nominal.

Then how far feet sink on soft ground, as parts of the catalogue's ``sink``, in standing and in the trot.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.a1.protocols import Bench
from benchmarks.blind.a1.rollout import Runner
from benchmarks.blind.a1.twin import Twin
from benchmarks.plants import PLANTS, Plant
from benchmarks.plants.machine import Machine
from benchmarks.plants.rollout import PERIOD
from s2r_sim.backend import SimBackend
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Source = Callable[[str, int], Trace]
"""A protocol's name or a command of a trot [m/s], and a seed → trace."""

COMMANDS = ("-0.2", "0.1", "0.3")
PROTOCOLS = ("air_sine", "air_coast", "air_low", "squat", "sway", "squeeze", "hold")
CHANNELS = ("q", "tau", "height", "vx")
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


def main() -> None:
    of = sources()
    units = {"q": "mrad", "tau": "N m", "height": "mm", "vx": "mm/s"}
    factor = {"q": 1e3, "tau": 1.0, "height": 1e3, "vx": 1e3}
    print(f"{'':10} {'machine':10} {'s':>5}  " + "  ".join(f"{name:>6} [{units[name]}]" for name in CHANNELS), "  rms tau")
    for what in (*COMMANDS, *PROTOCOLS):
        nominal = of["simulator"](what, 1)
        for name, source in of.items():
            source(what, 2)  # compile
            began = time.process_time()
            trace = source(what, 2)
            seconds = time.process_time() - began
            channels = CHANNELS if what in COMMANDS else CHANNELS[:3]
            row = [f"{factor[one] * difference(nominal, trace, one):13.3f}" for one in channels]
            level = float(np.sqrt(np.mean(trace["tau"] ** 2)))
            print(f"{what:10} {name:10} {seconds:5.2f} {' '.join(row)}  {level:.3f} {trace.failure or ''}", flush=True)
    print(f"\nmean depth of standing feet on soft ground of sink {SINK} m, as part of it")
    soft = {"soft_ground": {"sink": SINK}}
    sim = SimBackend().with_effects(soft)
    plants = {name: Plant(author, Machine({"soft_ground.sink": SINK})) for name, author in PLANTS.items()}
    print(f"simulator  squat {sunk(sim.run('squat', {}, 1)) / SINK:.2f}  trot {sunk(sim.rollout({'vd': 0.1}, 1)) / SINK:.2f}")
    for name, plant in plants.items():
        squat, trot = plant.run("squat", np.random.default_rng(1)), plant.trot(0.1, np.random.default_rng(1))
        print(f"{name:10} squat {sunk(squat) / SINK:.2f}  trot {sunk(trot) / SINK:.2f}")


if __name__ == "__main__":
    main()
