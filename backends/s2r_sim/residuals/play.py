"""Where in the play of its gear every motor stood in a recording, and what torque it passed on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from s2r_spec.compiled import compiled

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@compiled
def passed_on(
    asked: FloatArray,
    kp: FloatArray,
    kd: float,
    q: FloatArray,
    dq: FloatArray,
    given: IntArray,
    strength: FloatArray,
    low: FloatArray,
    high: FloatArray,
    dt: FloatArray,
    gap: float,
    inertia: float,
) -> FloatArray:
    """Return (n, 12) torque [N m] between motor and joint in the last step of every tick.

    A rotor turns freely between the flanks and pushes only against one; the motor's loop is closed on the
    rotor. It starts against the flank towards which it is driven.

    Args:
        asked: (n, 12) what the motor law asks for at the beginning of a tick, on the joint's state [N m].
        kp: (n, 12) its gain on the angle [N m/rad].
        kd: its gain on the speed [N m s/rad].
        q: (n + 1, 12) angles of the joints at the samples [rad].
        dq: (n + 1, 12) their speeds [rad/s].
        given: (n, steps) the tick whose law is in force in each of the steps of physics in a tick.
        strength: (n,) part of the law that is delivered.
        low: (n, 12) least torque that the law can ask for [N m].
        high: (n, 12) most.
        dt: (n,) length of the ticks [s].
        gap: half of the play [rad].
        inertia: of the rotor, seen at the joint, over what a newton metre of the law truly is [kg m²].
    """
    n, joints = asked.shape
    steps = given.shape[1]
    torque = np.zeros((n, joints))
    for j in range(joints):
        play, speed = gap * np.sign(asked[0, j]), 0.0
        for i in range(n):
            step = dt[i] / steps
            for k in range(steps):
                g, part = given[i, k], k / steps
                moved = (1.0 - part) * q[i, j] + part * q[i + 1, j] - q[g, j] + play
                turned = (1.0 - part) * dq[i, j] + part * dq[i + 1, j] - dq[g, j] + speed
                law = asked[g, j] - kp[g, j] * moved - kd * turned
                drive = strength[i] * min(max(law, low[i, j]), high[i, j])
                pushes = (play >= gap and drive > 0.0) or (play <= -gap and drive < 0.0)
                speed = 0.0 if pushes else speed + drive / inertia * step
                play = min(max(play + speed * step, -gap), gap)
                if abs(play) >= gap:
                    speed = 0.0
                torque[i, j] = drive if pushes else 0.0
    return torque
