"""One real run of a twin: warm start, settling, the command, and what the lab logs."""

from __future__ import annotations

from functools import cached_property
from math import cos, sin
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.a1 import sensing
from benchmarks.blind.a1.log import Log
from benchmarks.blind.a1.plant import Plant, Saved
from benchmarks.blind.a1.robot import PERIOD, Brain, Decision, Memory
from benchmarks.blind.a1.sensing import Errors
from benchmarks.blind.a1.twin import Twin, of_today, uneven
from benchmarks.blind.a1.world import CELL, GRID, RATE
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

WARM_UP = 500
"""Ticks of trotting in place after the robot was switched on."""
SETTLING = 100
"""Ticks of trotting in place under a run's own noise, before the command."""


class _Warm(NamedTuple):
    plant: Saved
    memory: Memory


class Runner:
    """Runs one twin; a rollout is a pure function of command, duration and random numbers."""

    def __init__(self, twin: Twin) -> None:
        self._twin = twin
        self._plant = Plant(twin.build, twin.world)
        self._brain = Brain()
        self._truth, self._rotors, self._feet = np.zeros(36), np.zeros(24), np.zeros((8, 3))

    @cached_property
    def _warm(self) -> list[_Warm]:
        """Trotting in place, one state for each tick of the gait's period."""
        plant, brain = self._plant, self._brain
        ticks = WARM_UP + PERIOD
        errors = sensing.off(self._twin.sensing, ticks)
        plant.world, plant.ground = self._twin.world, np.zeros(GRID)
        plant.stand()
        brain.restart()
        saved: dict[int, _Warm] = {}
        for tick in range(ticks):
            if tick >= WARM_UP:
                saved[tick % PERIOD] = _Warm(plant.save(), brain.snapshot())
            done = brain.tick(self._measure(errors, tick), 0.0)
            plant.send(done.motors, self._twin.timing.delay)
            plant.run(-1.0)
        return [saved[phase] for phase in range(PERIOD)]

    def _measure(self, errors: Errors, tick: int) -> FloatArray:
        """Return (36,) what the controller is given; the truth stays in ``self._truth``."""
        truth = self._truth
        self._plant.look(truth, self._rotors, self._feet)
        measured = errors.added[tick] + truth
        measured[12:] += self._rotors - truth[12:]
        scale, (forward, left), yaw = errors.scale[tick], errors.bias[tick].tolist(), float(truth[5])
        measured[6] += (scale - 1.0) * truth[6] + cos(yaw) * forward - sin(yaw) * left
        measured[7] += (scale - 1.0) * truth[7] + sin(yaw) * forward + cos(yaw) * left
        return measured

    def run(self, command: float, rng: Generator, duration: float = 1.5) -> Trace:
        """Run one test: the forward velocity command [m/s] steps from zero at t = 0."""
        twin = of_today(self._twin, rng)
        ticks = round(duration * RATE) + 1
        phase = int(rng.integers(PERIOD))
        errors = sensing.errors(twin.sensing, rng, SETTLING + ticks, SETTLING)
        late = _delays(twin, rng, SETTLING + ticks)
        stale = rng.integers(0, round(twin.timing.stale * RATE) + 1, SETTLING + ticks)
        shove = rng.normal(size=(25, 6)).mean(axis=0) * (60.0, 60.0, 60.0, 6.0, 6.0, 6.0)
        warm = self._warm[(phase - SETTLING) % PERIOD]
        plant, brain = self._plant, self._brain
        plant.world = twin.world
        plant.ground = uneven(rng, GRID, CELL)
        plant.restore(warm.plant)
        brain.restart(warm.memory)
        log = Log(ticks, command, float(twin.world["slope"][0]), plant.world["torque_limit"][0])
        seen: list[FloatArray] = []
        for tick in range(-SETTLING, ticks):
            elapsed = tick / RATE
            if tick == 0:
                plant.begin()
            now = SETTLING + tick
            seen.append(self._measure(errors, now))
            fallen = tick >= 0 and plant.has_fallen(self._truth)
            if fallen and len(log) and not np.isfinite(self._truth).all():
                break  # the last sample that means anything is that before
            done = brain.tick(seen[max(0, now - stale[now])], command if tick >= 0 else 0.0)
            if not twin.timing.lost(elapsed):
                plant.send(done.motors, late[now])
            plant.run(elapsed, shove if tick < 25 - SETTLING else None)
            if tick >= 0:
                self._write(log, done)
                if fallen:
                    break
        return log.trace(np.array(seen[: SETTLING + len(log)]), errors, SETTLING, fallen, rng)

    def _write(self, log: Log, done: Decision) -> None:
        plant = self._plant
        log.write(self._truth, self._rotors, self._feet, done, plant.state["current"][0], plant.ground_force)


def _delays(twin: Twin, rng: Generator, ticks: int) -> FloatArray:
    """Return (ticks,) of delays [s]: a bus that is sometimes busy."""
    return twin.timing.delay * (0.6 + 0.4 * rng.gamma(4.0, 0.25, ticks))
