"""The simulated robot of a twin: plant, sensors and motor temperatures, in rounds of 2 ms.

Temperatures follow a first-order model whose equilibrium grows with the square of the torque:

    dT/dt = (T_ambient + c τ² − T) / time constant
"""

from __future__ import annotations

import math
from math import inf

import numpy as np

from s2r_a1.twin.placement import FOLDED, Rig, lying_state
from s2r_a1.wire import CLOSED_LOOP, MOTORS, FloatArray, Orders, Reading
from s2r_sim.controller import estimator
from s2r_sim.controller.gains import RATE
from s2r_sim.plant.noise import Noise, accelerometer_errors, sensor_errors
from s2r_sim.plant.physics import Physics
from s2r_sim.plant.plant import Plant, Saved
from s2r_sim.plant.sensors import Sensors
from s2r_sim.robot import rotation
from s2r_sim.robot.constants import A1
from s2r_sim.robot.signals import MotorCommand, RobotState

_BLOCK = 500
"""A budget: rounds whose noise is drawn at once. The numbers do not depend on it."""


AMBIENT = 25.0
"""A level [°C]: initial temperature of all motors."""
RISE = 0.1
"""A level [K/(N·m)²]: equilibrium temperature rise per squared torque. In the trot of `s2r_sim` the mean τ² of a calf
is 60 (N·m)², which gives +6 K. It is deliberately small: a twin that walks for an hour in lock step, without rests,
stays below 50 °C, above which no test begins. Hot motors are an inject."""
TIME_CONSTANT = 300.0
"""A level [s]: time constant of the temperature. All three are levels of this twin, not of the robot, of which it is
only published that its motors stop themselves within 5 to 7 min of walking with 3 kg (arXiv 2605.27046)."""


class Body:
    """The plant of `s2r_sim` with contacts at the knees, on its floor or in a rig, and sensor noise from a seed."""

    def __init__(self, physics: Physics, seed: int, noise: Noise, start: Saved | None = None) -> None:
        self._physics = physics
        self._errors = _Errors(noise, seed)
        self.temperature = np.full(MOTORS, AMBIENT)
        self._lie(lying_state(physics) if start is None else start)

    _rig: Rig | None
    _plant: Plant
    _sensors: Sensors
    _velocity: FloatArray

    def put(self, rig: float | None) -> None:
        """Hang the robot into a rig at a height [m] with folded legs, or lay it onto its floor (None)."""
        if rig is None:
            self._lie(lying_state(self._physics))
            return
        self._rig = held = Rig(self._physics, rig, FOLDED)
        self._begin(held.plant, held.physics)

    def _lie(self, start: Saved) -> None:
        plant = Plant(A1, self._physics, knees=True)
        plant.restore(start)
        self._rig = None
        self._begin(plant, self._physics)

    def _begin(self, plant: Plant, physics: Physics) -> None:
        self._plant, self._sensors = plant, Sensors(A1, physics, "truth")
        self._velocity = plant.truth().velocity

    def truth(self) -> RobotState:
        """Return the true state."""
        return self._plant.truth()

    def save(self) -> Saved:
        """Return the state of the plant, without sensors and temperatures."""
        return self._plant.save()

    def step(self, orders: Orders, push: FloatArray) -> Reading:
        """Simulate one round with these motor commands, under a (3,) force on the base [N].

        The reading has no tick, no remote control, and motors in closed loop.
        """
        if self._rig is None:
            self._plant.step(MotorCommand(*orders), -inf, push)
        else:
            self._plant.step(MotorCommand(*orders), -inf, self._rig.lift + push)
            self._rig.hold()
        plant, truth = self._plant, self._plant.truth()
        noise, noise_of_force = self._errors.next()
        own = self._sensors.disturbed(truth, plant.play, noise)
        change = (truth.velocity - self._velocity).tolist()
        self._velocity = truth.velocity
        force = estimator.specific_force(truth.rpy.tolist(), change, noise_of_force, math.sin, math.cos)
        torque = plant.torque
        equilibrium = AMBIENT + RISE * torque**2
        self.temperature = self.temperature + (equilibrium - self.temperature) * (1.0 / RATE / TIME_CONSTANT)
        x, y, z, w = rotation.quaternion(*own.rpy.tolist())
        return Reading(
            quaternion=np.array([w, x, y, z]),
            gyro=own.omega,
            accelerometer=np.array(force),
            q=own.q,
            dq=own.dq,
            tau=torque,
            temperature=self.temperature,
            mode=np.full(MOTORS, CLOSED_LOOP, dtype=np.int64),
            tick=0,
            # The unit of the robot's foot sensors is unknown; here one count is one newton along the world's z.
            foot_force=plant.foot_forces.reshape(4, 3)[:, 2],
        )


class _Errors:
    """The noise of successive rounds."""

    def __init__(self, noise: Noise, seed: int) -> None:
        self._noise = noise
        self._state, self._force = np.random.default_rng([seed, 2]), np.random.default_rng([seed, 3])
        self._left: list[tuple[FloatArray, list[float]]] = []

    def next(self) -> tuple[FloatArray, list[float]]:
        """Return (36,) errors of the state and (3,) of the accelerometer."""
        if not self._left:
            state = sensor_errors(self._noise, self._state, _BLOCK)
            force = accelerometer_errors(self._noise, self._force, _BLOCK).tolist()
            self._left = list(zip(state, force, strict=True))[::-1]
        return self._left.pop()
