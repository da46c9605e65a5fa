"""The excitation protocols on a twin, from the words of the A1's protocols alone, in this generator's own code.

A laboratory runs them: it holds the trunk in a rig or stands the robot up, sends joint references to the drives, and
logs what it logs of a walk, without the walking controller's channels.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import mujoco
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.a1 import sensing
from benchmarks.blind.a1.log import Log
from benchmarks.blind.a1.plant import Plant
from benchmarks.blind.a1.robot import Decision
from benchmarks.blind.a1.rollout import _delays
from benchmarks.blind.a1.twin import Twin, of_today, uneven
from benchmarks.blind.a1.world import CELL, GRID, RATE
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

SETTLE = 200
"""Ticks for which the first pose is held."""
RIG_MASS = 1e5
"""[kg] of rig and trunk."""
LEG_MASS = 4 * (0.696 + 1.013 + 0.226)
"""[kg] that hangs on the rig: hips, thighs and shanks by the data sheet."""
WALKING_ONLY = (
    "vx_cmd",
    "vy_cmd",
    "wz_cmd",
    "vx_est",
    "vy_est",
    "acc_pred",
    "qp_iterations",
    "qp_solved",
    "stance",
)
"""Channels of a walk that a protocol has not."""


@dataclass(frozen=True)
class Drill:
    """One protocol: joint angles (n, 12), stiffness and damping (n,), base height [m], whether a rig holds the base."""

    angles: FloatArray
    stiffness: FloatArray
    damping: FloatArray
    height: float
    rig: bool


def _smooth(clock: FloatArray, span: float) -> FloatArray:
    u = np.minimum(1.0, np.maximum(0.0, clock / span))
    return 3.0 * u**2 - 2.0 * u**3


def _foot_at(ahead: FloatArray, below: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return thigh and calf that put a foot there, by the law of cosines for two links of 0.2 m."""
    reach = np.minimum(np.sqrt(ahead**2 + below**2), 0.3999)
    bend = np.arccos(reach / 0.4)
    return bend - np.arctan2(ahead, below), -2.0 * bend


def drill(name: str, amplitude: float = 1.0, gain: float = 1.0) -> Drill:
    """Return a protocol's references at every control tick, the last one included."""
    span = {
        "air_sine": 2.0,
        "air_coast": 0.9,
        "air_low": 1.6,
        "squat": 2.0,
        "sway": 2.0,
        "squeeze": 1.9,
        "hold": 10.0,
    }[name]
    clock = np.linspace(0.0, span, round(span * RATE) + 1)
    legs = [np.zeros((clock.size, 3)) for _ in range(4)]
    stiff = {"air_sine": 25.0, "air_coast": 40.0, "air_low": 40.0, "squeeze": 60.0}.get(name, 120.0)
    damp = {"air_sine": 0.6, "air_coast": 1.0, "air_low": 0.8}.get(name, 3.0)
    for number, leg in enumerate(legs):
        still = np.zeros_like(clock)
        if name == "air_sine":
            grow = amplitude * _smooth(clock, 0.2)
            for joint, (rest, big, small, slow) in enumerate(
                ((0.0, 0.25, 0.05, 1.3), (0.8, 0.35, 0.08, 1.7), (-1.6, 0.4, 0.1, 2.3))
            ):
                low = big * np.sin(2 * pi * (slow + 0.1 * number) * clock + number)
                high = small * np.sin(2 * pi * (6.1 + 0.7 * joint + 0.3 * number) * clock)
                leg[:, joint] = rest + grow * (low + high)
        elif name == "air_coast":
            out = amplitude * _smooth(clock, 0.4)
            leg[:, 0], leg[:, 1], leg[:, 2] = 0.35 * out, 0.8 + 0.6 * out, -1.6 - 0.5 * out
        elif name == "air_low":
            swing = 0.1 * amplitude * _smooth(clock, 0.2) * np.sin(2 * pi * (1.5 + 0.2 * number) * clock)
            leg[:, 1], leg[:, 2] = _foot_at(swing, still + 0.25)
        elif name == "squat":
            dip = 0.035 * amplitude * _smooth(clock, 0.3) * np.sin(2 * pi * 1.1 * clock)
            leg[:, 1], leg[:, 2] = _foot_at(still, 0.26 - dip)
        elif name == "sway":
            grow = amplitude * _smooth(clock, 0.3)
            leg[:, 0] = 0.12 * grow * np.sin(2 * pi * 1.3 * clock)
            leg[:, 1], leg[:, 2] = _foot_at(0.045 * grow * np.sin(2 * pi * 0.9 * clock), still + 0.26)
        elif name == "squeeze":
            leg[:, 1], leg[:, 2] = _foot_at(still, still + 0.26)
            outward = 0.5 * amplitude * _smooth(clock - 0.3, 1.4)
            leg[:, 0] = outward if number % 2 else -outward
        else:
            leg[:, 1], leg[:, 2] = _foot_at(still, 0.26 - 0.06 * amplitude * _smooth(clock, 0.4))
    on = (clock < 0.6) | (name != "air_coast")
    height = {"air_sine": 0.6, "air_coast": 0.6, "air_low": 0.3}.get(name, 0.285)
    return Drill(np.hstack(legs), gain * stiff * on, gain**0.5 * damp * on, height, name.startswith("air"))


class Bench:
    """Runs the protocols on one twin; a run is a pure function of the protocol and its random numbers."""

    def __init__(self, twin: Twin) -> None:
        self._twin = twin
        self._plants: dict[bool, Plant] = {}

    def run(self, name: str, rng: Generator, amplitude: float = 1.0, gain: float = 1.0) -> Trace:
        """Run one protocol."""
        made = drill(name, amplitude, gain)
        twin = of_today(self._twin, rng)
        count = len(made.angles)
        errors = sensing.errors(twin.sensing, rng, SETTLE + count, SETTLE)
        late = _delays(twin, rng, SETTLE + count)
        plant = self._plant(made.rig)
        world = twin.world.copy()
        if made.rig:
            world["slope"], world["roughness"], world["cross_slope"] = 0.0, 0.0, 0.0
        plant.world, plant.ground = world, uneven(rng, GRID, CELL)
        self._place(plant, made, rng)
        lift = np.array([0.0, 0.0, (RIG_MASS + LEG_MASS) * 9.81, 0.0, 0.0, 0.0]) if made.rig else None
        rates = np.gradient(made.angles, 1.0 / RATE, axis=0) * (made.stiffness > 0.0)[:, None]
        log = Log(count, 0.0, float(world["slope"][0]), world["torque_limit"][0])
        truth, rotors, feet = np.zeros(36), np.zeros(24), np.zeros((8, 3))
        seen: list[FloatArray] = []
        fallen = False
        for tick in range(-SETTLE, count):
            now = max(tick, 0)
            if tick == 0:
                plant.begin()
            plant.look(truth, rotors, feet)
            seen.append(truth + errors.added[SETTLE + tick])
            fallen = tick >= 0 and not made.rig and plant.has_fallen(truth)
            motors = np.zeros((5, 12))
            motors[0], motors[1] = made.angles[now], rates[now] if tick >= 0 else 0.0
            motors[2], motors[3] = made.stiffness[now], made.damping[now]
            elapsed = tick / RATE
            if not twin.timing.lost(elapsed):
                plant.send(motors, late[SETTLE + tick])
            before = (truth.copy(), rotors.copy(), feet.copy())
            plant.run(elapsed, lift)
            if tick >= 0:
                decision = Decision(motors, (True, True, True, True), np.zeros(6), 0, False)
                log.write(*before, decision, plant.state["current"][0], plant.ground_force)
            if fallen:
                break
        trace = log.trace(np.array(seen), errors, SETTLE, fallen, rng)
        return trace.only(name for name in trace.channels if name not in WALKING_ONLY)

    def _plant(self, rig: bool) -> Plant:
        if rig not in self._plants:
            world = self._twin.world.copy()
            if rig:
                world["slope"] = 0.0
            plant = Plant(self._twin.build, world)
            if rig:
                plant._model.body_mass[1] = plant._model.body_inertia[1] = RIG_MASS
                mujoco.mj_setConst(plant._model, plant._data)
            self._plants[rig] = plant
        return self._plants[rig]

    @staticmethod
    def _place(plant: Plant, made: Drill, rng: Generator) -> None:
        plant.stand()
        data = plant._data
        data.qpos[:7] = (0.0, 0.0, made.height, 1.0, 0.0, 0.0, 0.0)
        data.qpos[7:] = made.angles[0] + 0.002 * rng.normal(size=12)
        data.qvel[:] = 0.0
        plant.state["angle"] = data.qpos[7:]
        mujoco.mj_step1(plant._model, data)
