"""The base task: where the trunk should accelerate to follow the commanded velocity."""

from __future__ import annotations

from math import cos, pi, sin

from s2r_sim.robot.constants import FloatArray, Vector3
from s2r_spec.compiled import compiled


@compiled
def advance(reference: FloatArray, measured: FloatArray, command: Vector3, rate: float) -> None:
    """Move the reference pose of the base by one tick.

    Along the heading it moves with the robot, since only the speed is commanded
    there; across the heading it moves with the command.

    Args:
        reference: (x, y) [m] and yaw [rad] in the world.
        measured: ``State.flat``.
        command: forward, left [m/s] and yaw rate [rad/s].
        rate: number of ticks per second.
    """
    x, y = measured[0], measured[1]
    across = _left_of(reference, x, y) + command[1] / rate
    yaw = reference[2] + command[2] / rate
    reference[0], reference[1], reference[2] = x - across * sin(yaw), y + across * cos(yaw), yaw


@compiled
def _left_of(reference: FloatArray, x: float, y: float) -> float:
    """Return the distance from a point to the reference, left positive [m]."""
    return -sin(reference[2]) * (reference[0] - x) + cos(reference[2]) * (reference[1] - y)


@compiled
def base_task(
    reference: FloatArray,
    measured: FloatArray,
    twist: FloatArray,
    command: Vector3,
    ground: float,
    constants: tuple[FloatArray, float, float],
    task: FloatArray,
) -> None:
    """Advance the reference, and write the base's task (L, −L a): an acceleration x costs |(L, −L a) (x, 1)|².

    The desired spatial acceleration a is proportional-derivative in the heading
    frame and in roll, pitch, yaw; L'L is the weight of a deviation from it.

    p̈ = kp (p_des − p) + kd (v_des − v), no integral. The spatial acceleration
    is R'p̈ − ω × (R'v). The weights w are given in the heading frame, too;
    H = Ry(pitch) Rx(roll) turns base axes into it, so that the linear part of L is √w H.

    Args:
        reference: see :func:`advance`.
        measured: ``State.flat``.
        twist: (18,) or its first six, in base axes.
        command: forward, left [m/s] and yaw rate [rad/s].
        ground: height of the ground [m].
        constants: (6, 3) kp, kd and √w of the linear part, and the same of the angular part; desired height of the
            base above the ground [m]; number of ticks per second.
        task: (6, 7) on return the task.
    """
    gains, desired_height, rate = constants
    advance(reference, measured, command, rate)
    across = _left_of(reference, measured[0], measured[1])
    turn = reference[2] - measured[5]
    turn -= 2.0 * pi * round(turn / (2.0 * pi))  # the shortest way
    height = desired_height - (measured[2] - ground)
    roll, pitch, yaw = measured[3], measured[4], measured[5]
    vx, vy, vz = measured[6], measured[7], measured[8]
    ux, uy, uz, wx, wy, wz = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
    c, s = cos(yaw), sin(yaw)
    kp, kd, root, kp_turn, kd_turn, root_turn = gains[0], gains[1], gains[2], gains[3], gains[4], gains[5]

    forward = kd[0] * (command[0] - (c * vx + s * vy))
    left = kp[1] * across + kd[1] * (command[1] - (c * vy - s * vx))
    up = kp[2] * height - kd[2] * vz
    cr, sr, cp, sp = cos(roll), sin(roll), cos(pitch), sin(pitch)
    ax = cp * forward - sp * up - (wy * uz - wz * uy)
    ay = sp * sr * forward + cr * left + cp * sr * up - (wz * ux - wx * uz)
    az = sp * cr * forward - sr * left + cp * cr * up - (wx * uy - wy * ux)

    task[:] = 0.0
    task[0, 0], task[0, 1], task[0, 2] = root[0] * cp, root[0] * sp * sr, root[0] * sp * cr
    task[1, 1], task[1, 2] = root[1] * cr, -root[1] * sr
    task[2, 0], task[2, 1], task[2, 2] = -root[2] * sp, root[2] * cp * sr, root[2] * cp * cr
    for row in range(3):
        task[row, 6] = -(task[row, 0] * ax + task[row, 1] * ay + task[row, 2] * az)
        task[3 + row, 3 + row] = root_turn[row]
    task[3, 6] = root_turn[0] * (kp_turn[0] * roll + kd_turn[0] * wx)
    task[4, 6] = root_turn[1] * (kp_turn[1] * pitch + kd_turn[1] * wy)
    task[5, 6] = -root_turn[2] * (kp_turn[2] * turn + kd_turn[2] * (command[2] - wz))
