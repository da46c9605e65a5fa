"""What one rollout of the A1 costs: thread CPU time, split by part of the control tick, and memory.

Run: OMP_NUM_THREADS=1 python -m benchmarks.a1.speed

The split comes from clocks wrapped around the functions named in ``PARTS``; a
part's time excludes that of the parts it calls. The clocks themselves cost
about 1 µs a part, which is why the total is measured without them. Memory is
that of a fresh worker, as `s2r check` starts it, and not of this process, which
builds both forms of the QP; where Numba has nothing on disk yet, the first
workers compile, and take more.
"""

from __future__ import annotations

import importlib
import platform
import sys
from collections import defaultdict
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import wraps
from statistics import median
from time import thread_time
from typing import Any

from benchmarks import worker
from benchmarks.machine import processor
from s2r_sim import SimBackend
from s2r_sim.controller.gains import RATE
from s2r_sim.settings import Settings

REPEATS = 7
MUJOCO = "2 steps of MuJoCo alone"

PARTS = (
    ("rigid-body dynamics (Pinocchio)", "s2r_sim.controller.dynamics", "RigidBody.update"),
    ("foot tasks", "s2r_sim.controller.trot", "foot_task"),
    ("base task", "s2r_sim.controller.trot", "base_task"),
    ("joint space", "s2r_sim.controller.trot", "in_joint_space"),
    ("QP", "s2r_sim.controller.stance_qp", "StanceQP.solve"),
    ("PIQP, where a limit matters", "s2r_sim.controller.qp", "Solver.solve"),
    ("rest of the controller", "s2r_sim.controller.trot", "Controller.tick"),
    (MUJOCO, "mujoco", "mj_step"),
    ("motors", "s2r_sim.plant.plant", "Plant.step"),
    ("true state", "s2r_sim.plant.plant", "Plant.truth"),
    ("sensors", "s2r_sim.plant.sensors", "Sensors.read"),
    ("velocity estimate", "s2r_sim.plant.sensors", "Sensors.estimates"),
    ("channels of the trace", "s2r_sim.plant.recorder", "Recorder.channels"),
    ("random numbers", "s2r_sim.rollout", "draw"),
    ("loop and warm-state restore", "s2r_sim.backend", "SimBackend.rollout"),
)
"""Name, module and function of each part."""


class Clock:
    """Exclusive CPU time by name of part."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = defaultdict(float)
        self._inside = [0.0]

    def around(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def timed(*args: Any, **kwargs: Any) -> Any:
            self._inside.append(0.0)
            start = thread_time()
            try:
                return function(*args, **kwargs)
            finally:
                whole = thread_time() - start
                self.spent[part] += whole - self._inside.pop()
                self._inside[-1] += whole

        return timed


@contextmanager
def clocked(clock: Clock, names: Container[str]) -> Iterator[None]:
    """Wrap the functions of these parts, and put the plain functions back afterwards."""
    undo: list[tuple[Any, str, Any]] = []
    for part, module, path in PARTS:
        if part not in names:
            continue
        *owners, name = path.split(".")
        place: Any = importlib.import_module(module)
        for owner in owners:
            place = getattr(place, owner)
        undo.append((place, name, getattr(place, name)))
        setattr(place, name, clock.around(part, getattr(place, name)))
    try:
        yield
    finally:
        for place, name, function in undo:
            setattr(place, name, function)


def cpu(backend: SimBackend, seed: int) -> float:
    """Return the thread CPU time of one rollout [s]."""
    start = thread_time()
    backend.rollout({"vd": 0.3}, seed)
    return thread_time() - start


def over_mujoco(backend: SimBackend) -> float:
    """Return the time of a rollout over that of its physics steps, the median of ``REPEATS``.

    Both are of the same rollout, so that a busy machine slows both.
    """
    ratios = []
    for seed in range(REPEATS):
        clock = Clock()
        with clocked(clock, [MUJOCO]):
            whole = cpu(backend, seed)
        ratios.append(whole / clock.spent[MUJOCO])
    return median(ratios)


def main() -> bool:
    backend = SimBackend()
    ticks = round((backend.duration + backend.settings.settling) * RATE) + 1
    backend.rollout({"vd": 0.0}, seed=0)
    plain = min(cpu(backend, seed) for seed in range(REPEATS))
    full = replace(backend, settings=Settings(form="full"))
    full.rollout({"vd": 0.0}, seed=0)
    reference = min(cpu(full, seed) for seed in range(REPEATS))

    clock = Clock()
    with clocked(clock, [part for part, _, _ in PARTS]):
        for seed in range(REPEATS):
            backend.rollout({"vd": 0.3}, seed)
    whole = sum(clock.spent.values())
    print(f"{'part of the tick':36} {'us':>6} {'share':>6}")
    for part, spent in sorted(clock.spent.items(), key=lambda item: -item[1]):
        print(f"{part:36} {spent / REPEATS / ticks * 1e6:6.1f} {spent / whole:6.1%}")
    print(f"{'all, with the clocks':36} {whole / REPEATS / ticks * 1e6:6.1f}")
    print(f"{'all, without the clocks':36} {plain / ticks * 1e6:6.1f}")

    ratio = over_mujoco(backend)
    print(f"the whole tick over MuJoCo's two steps: {ratio:.2f} (wanted: <= 2.2)")
    speed = ticks / RATE / plain
    usual = worker.fresh()
    with worker.nothing_compiled():
        compiling = worker.fresh()
    print(f"\none rollout of {backend.duration} s from the warm state: {plain:.3f} s CPU (wanted: <= 0.15)")
    print(f"speed, settling counted: {speed:.1f} x real time per core (wanted: >= 10)")
    print(f"the 30-variable form: {reference:.3f} s CPU, {ticks / RATE / reference:.1f} x real time")
    print(f"memory of a worker: {usual['peak']:.0f} MiB (wanted: <= 300)")
    print(
        f"of a machine's first workers, which compile for {compiling['first']:.0f} s: "
        f"{compiling['peak']:.0f} MiB (wanted: <= 300)"
    )
    return ratio <= 2.2 and plain <= 0.15 and speed >= 10.0 and max(usual["peak"], compiling["peak"]) <= 300.0


if __name__ == "__main__":
    print(f"{processor()}, {platform.machine()}, Python {platform.python_version()}")
    print(f"model {SimBackend().model_hash[:16]}, thread CPU time, best of {REPEATS}\n")
    met = main()
    print("\nall met" if met else "\nNOT all met")
    sys.exit(0 if met else 1)
