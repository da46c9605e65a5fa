"""The foot tasks: stance feet stay where they are, swing feet follow their polynomial."""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_sim.base_task import Command
from s2r_sim.dynamics import RigidBody
from s2r_sim.foothold import Pair, Point, raibert, swing
from s2r_sim.gains import Gains
from s2r_sim.gait import Gait, Progress
from s2r_sim.physics import State

FloatArray = NDArray[np.float64]


class FootTask(NamedTuple):
    """World axes, three numbers a foot.

    Attributes:
        acceleration: (12,) wanted [m/s²].
        step: (12,) what is missing to the target position [m]; 0 in stance.
        velocity: (12,) of the target [m/s]; 0 in stance.
    """

    acceleration: FloatArray
    step: FloatArray
    velocity: FloatArray


def foot_task(
    gains: Gains,
    gait: Gait,
    progress: Progress,
    lift_off: list[Point],
    body: RigidBody,
    measured: State,
    command: Command,
    landing_height: float,
) -> FootTask:
    """Return what the four feet should do at this tick.

    ``lift_off`` is where each foot last stood, ``landing_height`` that of the
    ball centre at touch-down [m].
    """
    task = FootTask(-gains.stance_damping * body.feet_velocity, np.zeros(12), np.zeros(12))
    landing = _Landing(gains, gait, measured, command)
    kp, kd = gains.kp_swing, gains.kd_swing
    for leg, s in enumerate(progress):
        if s is None:
            continue
        axes = slice(3 * leg, 3 * leg + 3)
        hip_x, hip_y, _ = body.thighs[axes].tolist()
        x, y = landing.place((hip_x, hip_y), s)
        (px, py, pz), (vx, vy, vz), (ax, ay, az) = swing(
            lift_off[leg], (x, y, landing_height), gains.swing_height, s, gait.swing_time
        )
        foot_x, foot_y, foot_z = body.feet[axes].tolist()
        ux, uy, uz = body.feet_velocity[axes].tolist()
        dx, dy, dz = px - foot_x, py - foot_y, pz - foot_z
        task.step[axes] = dx, dy, dz
        task.velocity[axes] = vx, vy, vz
        task.acceleration[axes] = (
            ax + kd * (vx - ux) + kp * dx,
            ay + kd * (vy - uy) + kp * dy,
            az + kd * (vz - uz) + kp * dz,
        )
    return task


class _Landing:
    """Raibert's foothold for any leg at one tick."""

    def __init__(self, gains: Gains, gait: Gait, measured: State, command: Command) -> None:
        self._gait, self._gain = gait, gains.raibert
        self._x, self._y, _ = measured.position.tolist()
        self._vx, self._vy, _ = measured.velocity.tolist()
        self._turn = command.wz
        yaw = float(measured.rpy[2])
        c, s = cos(yaw), sin(yaw)
        self._commanded_x = c * command.vx - s * command.vy
        self._commanded_y = s * command.vx + c * command.vy

    def place(self, hip: Pair, s: float) -> Pair:
        """Return where a leg of this hip should land [m], at progress ``s`` of its swing."""
        # The hip also moves because the base turns; the commanded rate is the less noisy one to use.
        turn_x, turn_y = -self._turn * (hip[1] - self._y), self._turn * (hip[0] - self._x)
        return raibert(
            hip=hip,
            velocity=(self._vx + turn_x, self._vy + turn_y),
            commanded=(self._commanded_x + turn_x, self._commanded_y + turn_y),
            time_to_go=(1.0 - s) * self._gait.swing_time,
            stance_time=self._gait.stance_time,
            gain=self._gain,
        )
