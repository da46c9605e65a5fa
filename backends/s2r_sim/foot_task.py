"""The foot tasks: stance feet stay where they are, swing feet follow their polynomial."""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from s2r_sim.base_task import Command
from s2r_sim.dynamics import RigidBody
from s2r_sim.foothold import FootTarget, raibert, swing
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
    lift_off: FloatArray,
    body: RigidBody,
    measured: State,
    command: Command,
    landing_height: float,
) -> FootTask:
    """Return what the four feet should do at this tick.

    ``lift_off`` (4, 3) is where each foot last stood, ``landing_height`` that
    of the ball centre at touch-down [m].
    """
    acceleration = -gains.stance_damping * body.feet_velocity
    step, velocity = np.zeros((4, 3)), np.zeros((4, 3))
    for leg, s in enumerate(progress):
        if s is not None:
            x, y = _landing(gains, gait, s, body.thighs[leg], measured, command)
            start_x, start_y, start_z = lift_off[leg].tolist()
            target = swing(
                (start_x, start_y, start_z), (x, y, landing_height), gains.swing_height, s, gait.swing_time
            )
            step[leg] = target.position - body.feet[leg]
            velocity[leg] = target.velocity
            acceleration[leg] = _track(gains, target, step[leg], body.feet_velocity[leg])
    return FootTask(acceleration.ravel(), step.ravel(), velocity.ravel())


def _track(gains: Gains, target: FootTarget, step: FloatArray, velocity: FloatArray) -> FloatArray:
    tracked: FloatArray = (
        target.acceleration + gains.kd_swing * (target.velocity - velocity) + gains.kp_swing * step
    )
    return tracked


def _landing(
    gains: Gains, gait: Gait, s: float, thigh: FloatArray, measured: State, command: Command
) -> tuple[float, float]:
    hip_x, hip_y, _ = thigh.tolist()
    x, y, _ = measured.position.tolist()
    vx, vy, _ = measured.velocity.tolist()
    yaw = float(measured.rpy[2])
    # The hip also moves because the base turns; the commanded rate is the less noisy one to use.
    turn_x, turn_y = -command.wz * (hip_y - y), command.wz * (hip_x - x)
    return raibert(
        hip=(hip_x, hip_y),
        velocity=(vx + turn_x, vy + turn_y),
        commanded=(
            cos(yaw) * command.vx - sin(yaw) * command.vy + turn_x,
            sin(yaw) * command.vx + cos(yaw) * command.vy + turn_y,
        ),
        time_to_go=(1.0 - s) * gait.swing_time,
        stance_time=gait.stance_time,
        gain=gains.raibert,
    )
