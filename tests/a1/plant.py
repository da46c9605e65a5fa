"""The simulator's plant as the robot, and a guard that agrees to everything, in the process of the test."""

import math

import numpy as np

from s2r_a1.client import StateChange
from s2r_a1.wire import A1, CLOSED_LOOP, Reading, pack, pack_reading, unpack, unpack_orders
from s2r_sim.controller import estimator
from s2r_sim.plant.plant import Plant
from s2r_sim.robot import rotation
from s2r_sim.robot.leg_kinematics import stand_angles
from s2r_sim.robot.signals import MotorCommand
from s2r_sim.settings import Settings

STATES = {"stand": "STAND", "walk": "WALK", "halt": "STAND", "lie": "RESTING", "damp": "DAMPING"}
HOLDING = 60.0, 2.0


class PlantLine:
    """A line to a plant that stands; packets are kept as a raw log has them: (direction, bytes)."""

    unit = "ms"
    lockstep = True

    def __init__(self, saved=None, lost=()):
        settings = Settings()
        self.plant = Plant(settings.robot, settings.physics)
        self.stand = stand_angles(settings.robot, settings.gains.base_height)
        self.plant.place(np.array([0.0, 0.0, settings.gains.base_height]), np.zeros(3), self.stand)
        if saved is not None:
            self.plant.restore(saved)
        self.change = StateChange("STAND")
        self.wanted = None
        self.packets = []
        self.rounds = 0
        self.lost = set(lost)
        self.endings = {}
        self._velocity = self.plant.truth().velocity.copy()
        self._arrived = self._seen()

    def receive(self):
        self.rounds += 1
        if self.rounds in self.endings:
            self.change = self.endings[self.rounds]
        return None if self.rounds in self.lost else unpack(self._arrived, A1)

    def send(self, orders):
        none = np.zeros(12)
        kp, kd = HOLDING
        command = MotorCommand(self.stand, none, np.full(12, kp), np.full(12, kd), none)
        if self.change.state == "WALK" and orders is not None:
            data = pack(orders, A1)
            self.packets.append((1, data))
            command = MotorCommand(*unpack_orders(data, A1))
        elif self.change.state == "DAMPING":
            command = MotorCommand(none, none, none, np.full(12, 3.0), none)
        self.plant.step(command, -math.inf)
        self._arrived = self._seen()

    def request(self, do, **fields):
        self.change = StateChange(STATES[do])
        return {"ok": True, "state": self.change.state}

    def _seen(self):
        data = pack_reading(reading(self.plant, self._velocity, 2 * self.rounds), A1)
        self._velocity = self.plant.truth().velocity.copy()
        self.packets.append((0, data))
        return data


def reading(plant, velocity, clock):
    """Return what the robot reports without noise; ``velocity`` (3,) was the true one a tick ago."""
    truth = plant.truth()
    change = (truth.velocity - velocity).tolist()
    force = estimator.specific_force(truth.rpy.tolist(), change, (0.0, 0.0, 0.0), math.sin, math.cos)
    x, y, z, w = rotation.quaternion(*truth.rpy.tolist())
    return Reading(
        quaternion=np.array([w, x, y, z]),
        gyro=truth.omega,
        accelerometer=np.array(force),
        q=truth.q,
        dq=truth.dq,
        tau=plant.torque,
        temperature=np.full(12, 30.0),
        mode=np.full(12, CLOSED_LOOP),
        tick=clock,
    )
