"""The foot tasks: stance feet stay where they are, swing feet follow their polynomial."""

from __future__ import annotations

from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from s2r_sim.base_task import Command
from s2r_sim.dynamics import RigidBody
from s2r_sim.foothold import Pair, Point, raibert, swing
from s2r_sim.gains import Gains
from s2r_sim.gait import Gait, Progress
from s2r_sim.physics import State

FloatArray = NDArray[np.float64]


def foot_task(
    gains: Gains,
    gait: Gait,
    progress: Progress,
    lift_off: list[Point],
    body: RigidBody,
    measured: State,
    command: Command,
    landing_height: float,
) -> FloatArray:
    """Return (3, 12) what the four feet should do at this tick, world axes, three numbers a foot.

    Its rows are the wanted acceleration [m/s²], what is missing to the target
    position [m] and the target's velocity [m/s]; the last two are 0 in stance.
    ``lift_off`` is where each foot last stood, ``landing_height`` that of the
    ball centre at touch-down [m].
    """
    acceleration: list[float] = []
    step: list[float] = []
    velocity: list[float] = []
    landing = _Landing(gains, gait, measured, command)
    kp, kd, brake = gains.kp_swing, gains.kd_swing, -gains.stance_damping
    feet, speeds, thighs = body.feet.tolist(), body.feet_velocity.tolist(), body.thighs.tolist()
    for leg, s in enumerate(progress):
        i = 3 * leg
        ux, uy, uz = speeds[i], speeds[i + 1], speeds[i + 2]
        if s is None:
            acceleration += (brake * ux, brake * uy, brake * uz)
            step += (0.0, 0.0, 0.0)
            velocity += (0.0, 0.0, 0.0)
            continue
        x, y = landing.place((thighs[i], thighs[i + 1]), s)
        (px, py, pz), (vx, vy, vz), (ax, ay, az) = swing(
            lift_off[leg], (x, y, landing_height), gains.swing_height, s, gait.swing_time
        )
        dx, dy, dz = px - feet[i], py - feet[i + 1], pz - feet[i + 2]
        acceleration += (
            ax + kd * (vx - ux) + kp * dx,
            ay + kd * (vy - uy) + kp * dy,
            az + kd * (vz - uz) + kp * dz,
        )
        step += (dx, dy, dz)
        velocity += (vx, vy, vz)
    return np.array((acceleration, step, velocity))


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
