"""Runs of protocols: the plant under joint references, without the trot controller."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from threading import Lock

import mujoco
import numpy as np

from s2r_sim.controller.gains import RATE
from s2r_sim.controller.trot import Tick
from s2r_sim.plant.channels import TRUE_CHANNELS
from s2r_sim.plant.noise import Noise, draw, with_instruments
from s2r_sim.plant.physics import Physics
from s2r_sim.plant.plant import Plant
from s2r_sim.plant.recorder import Recorder
from s2r_sim.plant.sensors import Sensors
from s2r_sim.protocols.references import Reference
from s2r_sim.robot.constants import GRAVITY, LEGS, FloatArray
from s2r_sim.robot.signals import MotorCommand, VelocityCommand
from s2r_sim.settings import Settings

SETTLING = 0.4
"""[s] for which the robot holds the first pose before the protocol begins."""
RIG = 1e5
"""[kg] mass of the trunk with the rig that holds it."""
LOGGED = (
    *("vx", "vy", "vz", "wz", "x", "y", "z", "height", "roll", "pitch", "yaw", "omega", "fallen"),
    *("q", "dq", "tau_cmd", "tau", "foot_position", "foot_velocity", "foot_force", "contact"),
)
"""Channels of a protocol's trace: those of a rollout that need no gait and no QP."""
_STILL = VelocityCommand()


class ProtocolSimulator:
    """The plant in the air and on the ground. A run is a pure function of reference, noise and seed."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._plants: dict[bool, tuple[Plant, Physics]] = {}
        self._lock = Lock()

    def run(self, reference: Reference, noise: Noise, seed: int) -> tuple[dict[str, FloatArray], bool]:
        """Return name → samples of every channel, and whether the robot has fallen."""
        with self._lock:
            settings = self._settings
            plant, physics = self._plant(reference.held)
            settling, ticks = round(SETTLING * RATE), len(reference.q)
            random = draw(noise, seed, settling + ticks, 1)
            plant.place(np.array([0.0, 0.0, reference.height]), np.zeros(3), reference.q[0])
            plant.origin = random.ground
            rise, tilt = (0.0, np.zeros(3)) if reference.held else (random.rise, random.tilt)
            plant.displace(rise, tilt, random.joints)
            robot = settings.robot
            legs = len(LEGS) * (robot.hip.mass + robot.thigh.mass + robot.shank.mass)
            carried = np.array([0.0, 0.0, (RIG + legs) * GRAVITY])  # by the rig
            weight = carried if reference.held else None
            sensors = Sensors(settings.robot, physics, settings.feedback)
            recorder = Recorder(settings.robot, physics, _STILL, truth=settings.record == "truth")
            zero, one = np.zeros(12), np.ones(12)
            stance = (True,) * 4  # no gait: the velocity estimate, which needs one, is not logged
            fallen = False
            for tick in range(-settling, ticks):
                now = max(tick, 0)
                speed = reference.dq[now] if tick >= 0 else zero
                motors = MotorCommand(
                    reference.q[now], speed, reference.kp[now] * one, reference.kd[now] * one, zero
                )
                truth = plant.truth()
                sensors.read(truth, plant.play, stance)
                own = sensors.reported(truth, plant.play)
                plant.step(motors, tick / RATE, weight)
                if tick < 0:
                    continue
                recorder.write(truth, own, Tick(motors, stance, None), plant.torque, plant.foot_forces)
                fallen = not reference.held and plant.has_fallen(truth, settings.fall)
                if fallen:
                    break
            channels = recorder.channels(sensors.estimates()[settling:], fallen)
            channels = with_instruments(channels, noise, seed)
            kept = (*LOGGED, *(channel.name for channel in TRUE_CHANNELS if settings.record == "truth"))
            return {name: channels[name] for name in kept}, fallen

    def _plant(self, held: bool) -> tuple[Plant, Physics]:
        """Return the plant, with its physics; a rig holds the base level, whatever the ground."""
        if held not in self._plants:
            physics = self._settings.physics
            if held:
                physics = replace(physics, slope=0.0, roughness=0.0)
            plant = Plant(self._settings.robot, physics)
            if held:
                base = int(plant.model.body("base").id)
                plant.model.body_mass[base] = RIG
                plant.model.body_inertia[base] = RIG
                mujoco.mj_setConst(plant.model, plant.data)
            self._plants[held] = plant, physics
        return self._plants[held]


protocol_simulator = lru_cache(maxsize=32)(ProtocolSimulator)
"""This process's simulator of protocols for some settings."""
