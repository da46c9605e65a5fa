"""Position of every rotor within the play of its gear in a recording, and the torque that reached its joint.

Encoders sit on the rotor's side: a recorded angle is the sum of the joint's angle and the play. While a rotor crosses
the gap, the reported torque accelerates the rotor alone.
"""

from __future__ import annotations

import numpy as np

from s2r_sim.robot.constants import FloatArray
from s2r_spec.compiled import compiled


@compiled
def cross_play(
    torque: FloatArray, dt: FloatArray, steps: int, gap: float, inertia: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (n + 1, 12) play [rad] and its rate [rad/s] at the samples, (n, 12) torque [N m] on the joints.

    A rotor turns freely between the flanks and pushes only against one. It starts against the flank
    towards which it is driven.

    Args:
        torque: (n, 12) torque of the rotors in every tick [N m]; an unknown torque counts as zero.
        dt: (n,) length of the ticks [s].
        steps: physics steps in a tick.
        gap: half of the play [rad].
        inertia: inertia of a rotor, seen at the joint [kg m²].
    """
    n, joints = torque.shape
    play, rate, passed = np.zeros((n + 1, joints)), np.zeros((n + 1, joints)), np.zeros((n, joints))
    for j in range(joints):
        at, speed = gap * np.sign(torque[0, j]), 0.0
        if not abs(at) >= 0.0:
            at = 0.0
        play[0, j] = at
        for i in range(n):
            drive, step = torque[i, j], dt[i] / steps
            if not abs(drive) >= 0.0:
                drive = 0.0
            for _ in range(steps):
                pushes = (at >= gap and drive > 0.0) or (at <= -gap and drive < 0.0)
                speed = 0.0 if pushes else speed + drive / inertia * step
                at = min(max(at + speed * step, -gap), gap)
                if abs(at) >= gap:
                    speed = 0.0
                if pushes:
                    passed[i, j] += drive / steps
            play[i + 1, j], rate[i + 1, j] = at, speed
    return play, rate, passed
