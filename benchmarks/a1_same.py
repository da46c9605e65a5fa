"""The twin behind its wire against the simulator's own loop: do they walk alike from the same start?

    OMP_NUM_THREADS=1 python benchmarks/a1_same.py [seeds] [--write]

Both begin from one saved state of a robot that stands, without delay, without effects, with commands in the counts of
the wire. One walks as a test of `a1` does: packets to the twin and from it, the walker's own sensing. The other is the
loop of `sim`: plant, sensors with its own velocity estimate, controller. Noise has the same table and other draws.

Printed are how far their joints are apart until the first foot touches down, without noise, and mean ρ over the seeds
with its standard errors at both ends of the test space. ρ is of the true velocity.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from s2r_a1.guard import moves
from s2r_a1.pilot import Pilot, orders
from s2r_a1.schedule import Schedule
from s2r_a1.twin import Twin, TwinSettings
from s2r_a1.wire import A1, Orders, pack, unpack, unpack_orders
from s2r_sim.controller.base_task import Reference
from s2r_sim.controller.gains import RATE
from s2r_sim.controller.trot import Controller, Memory
from s2r_sim.plant.noise import Noise, draw
from s2r_sim.plant.plant import Plant, Saved
from s2r_sim.plant.sensors import Sensors
from s2r_sim.robot.signals import Command, MotorCommand, State
from s2r_sim.settings import Settings
from s2r_spec.trace import Trace

sys.path.insert(0, str(Path(__file__).parent))
from a1_trot import rho
from machine import describe

RESULTS = Path(__file__).parent / "results" / "a1_same.json"
SPEEDS = (-0.2, 0.3)
SECONDS = 1.5
TOUCH_DOWN = 100  # [ticks] of the first pair of feet: they lift after 10, and swing for 90
SETTINGS = Settings()


def standing() -> Saved:
    """Return the state of a robot that stood up and holds the stand."""
    twin = Twin(TwinSettings("nominal", noise=False))

    def sent(orders: Orders) -> NDArray[np.float64]:
        return unpack(twin.round([pack(orders, A1)])[-1], A1).q

    motion = moves.standing_up(sent(moves.LIMP), 0)
    for round_ in range(1250):
        sent(moves.orders(motion, round_ * 2_000_000))
    return twin.saved()


@cache
def walker() -> Pilot:
    """Return who walks the twin."""
    pilot = Pilot(SETTINGS)
    pilot.practise()
    return pilot


def over_the_wire(start: Saved, schedule: Schedule, seed: int, noise: bool) -> Iterator[tuple[int, State]]:
    """Yield tick and true state of a walk of the twin."""
    twin = Twin(TwinSettings("nominal", seed=seed, delay=0, noise=noise, start=start))
    pilot = walker()
    pilot.begin(schedule, "ms")
    # The stand goes on for a round, so that there is a first reading.
    (packet,) = twin.round([pack(moves.orders(moves.Motion(moves.STANDING, moves.STANDING, 0, 0), 0), A1)])
    while True:
        note = pilot.step(unpack(packet, A1))
        yield note.tick, twin.truth()
        (packet,) = twin.round([pack(orders(note), A1)])


def in_the_loop(start: Saved, schedule: Schedule, seed: int, noise: bool) -> Iterator[tuple[int, State]]:
    """Yield tick and true state of a walk in the simulator's own loop."""
    plant = Plant(SETTINGS.robot, SETTINGS.physics, knees=True)
    plant.restore(start)
    held = moves.orders(moves.Motion(moves.STANDING, moves.STANDING, 0, 0), 0)
    plant.step(MotorCommand(*unpack_orders(pack(held, A1), A1)), -math.inf)
    sensors = Sensors(SETTINGS.robot, SETTINGS.physics, "estimate")
    random = draw(Noise() if noise else Noise.off(), seed, schedule.trot + 2 + round(SECONDS * RATE), 1)
    sensors.begin(random, None)
    controller = Controller(SETTINGS.robot, SETTINGS.gains)
    x, y, _ = plant.truth().position.tolist()
    controller.restore(Memory(Reference(x, y, float(plant.truth().rpy[2]))))
    tick = -schedule.trot
    while True:
        truth = plant.truth()
        yield tick, truth
        measured = sensors.read(truth, plant.play, controller.stance)
        decided = controller.tick(measured, schedule.at(tick)).motors
        plant.step(MotorCommand(*unpack_orders(pack(Orders(*decided), A1), A1)), -math.inf)
        tick += 1


def apart(start: Saved) -> float:
    """Return the largest difference of a joint [rad] until a foot touches down, without noise."""
    schedule = Schedule.of(Command(), 0, 0, SETTINGS.gains)
    ways = over_the_wire(start, schedule, 0, False), in_the_loop(start, schedule, 0, False)
    both = itertools.islice(zip(*ways, strict=True), TOUCH_DOWN)
    return float(max(np.abs(one.q - other.q).max() for (_, one), (_, other) in both))


def measured(walk: Iterator[tuple[int, State]], vd: float) -> float:
    """Return ρ of the true forward velocity of a walk."""
    vx = []
    for tick, truth in walk:
        if tick < 0:
            continue
        yaw = float(truth.rpy[2])
        vx.append(math.cos(yaw) * truth.velocity[0] + math.sin(yaw) * truth.velocity[1])
        if tick == round(SECONDS * RATE):
            break
    return float(rho(Trace(np.arange(len(vx)) / RATE, {"vx": np.array(vx)}), vd))


def compared(seeds: int) -> dict[str, object]:
    """Return what is printed."""
    start = standing()
    found: dict[str, object] = {"seeds": seeds, "apart [rad]": apart(start), "rho [m/s]": {}}
    for vd in SPEEDS:
        values = []
        for walk in (over_the_wire, in_the_loop):
            schedules = [Schedule.of(Command(vd), seed, 750, SETTINGS.gains) for seed in range(seeds)]
            values.append([measured(walk(start, one, seed, True), vd) for seed, one in enumerate(schedules)])
        means, errors = np.mean(values, axis=1), np.std(values, axis=1, ddof=1) / math.sqrt(seeds)
        difference, allowed = abs(means[0] - means[1]), 2.0 * math.hypot(*errors)
        found["rho [m/s]"][f"vd = {vd}"] = {  # type: ignore[index]
            "twin": round(means[0], 5),
            "sim": round(means[1], 5),
            "standard errors": [round(error, 5) for error in errors],
            "difference": round(difference, 5),
            "two standard errors": round(allowed, 5),
            "met": bool(difference <= allowed),
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seeds", nargs="?", type=int, default=50)
    parser.add_argument("--write", action="store_true", help=f"to {RESULTS.name}")
    options = parser.parse_args()
    text = json.dumps({**describe("mujoco"), **compared(options.seeds)}, indent=2)
    print(text)
    if options.write:
        RESULTS.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
