"""One rollout: warm start, settling, command, record."""

from __future__ import annotations

from functools import lru_cache
from math import cos, inf, radians, sin
from threading import Lock
from typing import NamedTuple

import numpy as np

from s2r_sim.controller.gains import RATE
from s2r_sim.controller.gait import Gait
from s2r_sim.controller.trot import Controller, Memory
from s2r_sim.parameters import Test
from s2r_sim.plant.noise import Noise, draw, with_instruments
from s2r_sim.plant.plant import Plant, Saved
from s2r_sim.plant.recorder import Recorder
from s2r_sim.plant.sensors import SensorMemory, Sensors
from s2r_sim.robot.constants import FloatArray
from s2r_sim.robot.leg_kinematics import stand_angles
from s2r_sim.robot.signals import RobotState, VelocityCommand
from s2r_sim.settings import Settings

_STILL = VelocityCommand()


class RolloutRecord(NamedTuple):
    """Record of a rollout: samples by channel, failed QPs, whether it ended in a fall."""

    channels: dict[str, FloatArray]
    qp_failures: int
    fallen: bool


class _Warm(NamedTuple):
    """World, sensors and controller, trotting in place."""

    world: Saved
    sensors: SensorMemory | None
    memory: Memory


class Simulator:
    """Plant, sensors and controller, with a saved state for every tick of the gait period.

    Every rollout starts from one of the saved states alone, so that it is a pure
    function of its arguments, bit for bit.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._plant = Plant(settings.robot, settings.physics)
        self._sensors = Sensors(settings.robot, settings.physics, settings.feedback)
        self._controller = Controller(settings.robot, settings.gains, settings.form)
        self._lock = Lock()
        self._warm = self._trot_in_place()

    def _trot_in_place(self) -> tuple[_Warm, ...]:
        """Return the states of one gait period, by gait tick, after the warm-up without noise."""
        settings, plant, controller = self._settings, self._plant, self._controller
        period = Gait.of(settings.gains).period
        height = settings.gains.base_height
        plant.place(np.array([0.0, 0.0, height]), np.zeros(3), stand_angles(settings.robot, height))
        controller.restore(Memory())
        saved: dict[int, _Warm] = {}
        warm_up = round(settings.warm_up * RATE)
        for tick in range(warm_up + period):
            if tick >= warm_up:
                saved[tick % period] = _Warm(plant.save(), self._sensors.memory, controller.snapshot())
            measured = self._sensors.read(plant.truth(), plant.play, controller.stance)
            plant.step(controller.tick(measured, _STILL).motors, -inf)
        return tuple(saved[tick] for tick in range(period))

    def rollout(self, test: Test, noise: Noise, seed: int, ticks: int) -> RolloutRecord:
        """Run one test for this number of control ticks, or until the robot falls."""
        with self._lock:
            plant, sensors, controller = self._plant, self._sensors, self._controller
            settling = round(self._settings.settling * RATE)
            period = len(self._warm)
            random = draw(noise, seed, settling + ticks, period)

            warm = self._warm[(random.phase - settling) % period]
            plant.restore(warm.world)
            sensors.begin(random, warm.sensors)
            controller.restore(warm.memory)
            plant.origin = random.ground
            plant.displace(random.rise, random.tilt, random.joints)
            settings = self._settings
            recorder = Recorder(
                settings.robot, settings.physics, test.command, truth=settings.record == "truth"
            )
            for tick in range(-settling, ticks):
                truth = plant.truth()
                measured = sensors.read(truth, plant.play, controller.stance)
                if tick < 0:
                    plant.step(controller.tick(measured, _STILL).motors, tick / RATE)
                    continue
                fallen = plant.has_fallen(truth, self._settings.fall)
                own = sensors.reported(truth, plant.play)
                done = controller.tick(measured, test.command)
                plant.step(done.motors, tick / RATE, _push(test, tick, truth))
                recorder.write(truth, own, done, plant.torque, plant.foot_forces)
                if fallen:
                    break
            channels = recorder.channels(sensors.estimates()[settling:], fallen)
            return RolloutRecord(with_instruments(channels, noise, seed), recorder.qp_failures, fallen)


simulator = lru_cache(maxsize=32)(Simulator)
"""This process's simulator for some settings, built and warmed up once; it takes about 2 MiB.

Every slope and every payload needs its own warm states, so that a search over them keeps only the last simulators.
"""


def _push(test: Test, tick: int, truth: RobotState) -> FloatArray | None:
    """Return the (3,) force on the base [N] at this tick, world axes."""
    force = test.push_force(tick / RATE)
    if force == 0.0:
        return None
    heading = float(truth.rpy[2]) + radians(test.push_towards)
    return force * np.array([cos(heading), sin(heading), 0.0])
