"""The laws of the smooth plant, compiled: drives, joints, contact and one step of the motion.

Unknowns of a step are the velocities v' at its end. Contact impulses are functions of v', which makes stiff rubber and
steep friction stable at this step. Units: SI. Shapes: 18 velocities (base in base axes, then joints), 4 feet.
"""

from __future__ import annotations

import numba
import numpy as np

TORQUE_LIMIT = 33.5
"""Definition: largest torque of a motor at its joint [N m], by the vendor."""
TOP_SPEED = 21.0
"""Definition: speed without load at the full supply [rad/s], by the vendor."""
CURRENT_TIME = 0.0006
"""Definition: time constant of the current loop [s], a bandwidth of 265 Hz. Twice as much delays torques by 0.6 ms more."""
SPEED_TIME = 0.0008
"""Definition: time constant of the drive's speed filter [s]. Twice as much delays the measured speed by 0.8 ms more."""
ENCODER_STEP = 2.0 * np.pi / 65536.0
"""Definition: resolution of the encoders at the joint [rad], 16 bits a turn."""
JOINT_SPEED = 0.03
"""Definition: speed scale of the joints' Coulomb friction [rad/s]. Twice as much lets a loaded joint creep twice as fast."""
SLIP_SPEED = 0.002
"""Definition: speed scale of the feet's friction [m/s]. Twice as much lets loaded feet creep twice as fast."""
SWEEPS = 40
"""Budget: sweeps over the contacts in a step."""
TOLERANCE = 1e-7
"""Tolerance: change of an impulse between two sweeps [N s]."""


@numba.njit(cache=True)
def drive(law, strength, voltage, dt, angle, speed, state):  # type: ignore[no-untyped-def]
    """Run the drives for one step.

    ``law`` (5, 12) is q, q̇, Kp, Kd, τ of the motor law. ``angle`` and ``speed`` (12,) are those of the encoders' shafts.
    ``state`` (4, 12) is the angle as read, its speed, the current as a torque [N m] and whether there was a step before.
    """
    for j in range(12):
        read = np.round(angle[j] / ENCODER_STEP) * ENCODER_STEP
        if state[3, j] == 0.0:
            state[0, j], state[1, j], state[3, j] = read, speed[j], 1.0
        raw = (read - state[0, j]) / dt
        state[1, j] += (raw - state[1, j]) * (1.0 - np.exp(-dt / SPEED_TIME))
        state[0, j] = read
        wanted = law[4, j] + law[2, j] * (law[0, j] - read) + law[3, j] * (law[1, j] - state[1, j])
        wanted = strength * min(max(wanted, -TORQUE_LIMIT), TORQUE_LIMIT)
        if wanted * speed[j] > 0.0:  # back electromotive force limits a driving torque
            most = strength * TORQUE_LIMIT * max(2.0 * (voltage - abs(speed[j]) / TOP_SPEED), 0.0)
            wanted = min(max(wanted, -most), most)
        state[2, j] += (wanted - state[2, j]) * (1.0 - np.exp(-dt / CURRENT_TIME))


@numba.njit(cache=True)
def joint_slope(dry, viscous, speed):  # type: ignore[no-untyped-def]
    """Return friction over speed [N m s/rad] of F tanh(v / v_s) + b v."""
    size = abs(speed)
    if size < 1e-9:
        return dry / JOINT_SPEED + viscous
    return dry * np.tanh(size / JOINT_SPEED) / size + viscous


@numba.njit(cache=True)
def slip_speed(pulled, limit, ease):  # type: ignore[no-untyped-def]
    """Return the speed s ≥ 0 with s + ease · limit · tanh(s / v_s) = pulled, by Newton's method from above."""
    s = pulled
    for _ in range(50):
        t = np.tanh(s / SLIP_SPEED)
        error = s + ease * limit * t - pulled
        change = error / (1.0 + ease * limit * (1.0 - t * t) / SLIP_SPEED)
        following = s - change
        if following < 0.0:  # the function bends down: its tangent may lead below the root
            following = 0.5 * s if s > 1e-12 else 0.0
        if abs(following - s) < 1e-10:
            return following
        s = following
    return s


@numba.njit(cache=True)
def advance(mass, bias, jacobian, centres, velocity, torque, friction, ground, free, dt, impulses):  # type: ignore[no-untyped-def]
    """Return (18,) velocities a step later; ``impulses`` (4, 3) [N s], along the ground's axes, is updated in place.

    Args:
        mass: (18, 18) of which the upper triangle counts.
        bias: (18,) Coriolis, centrifugal and gravitational forces.
        jacobian: (6, 18) of all joints in the world: linear rows at the world's origin, then angular rows.
        centres: (4, 3) of the balls at the feet.
        velocity: (18,) at the step's beginning.
        torque: (12,) on the joints.
        friction: (2, 12) Coulomb and viscous friction of the joints.
        ground: (12,) its axes (forward, left, normal) in the world, friction coefficient, stiffness, damping; see Plant.
        free: first of the velocities that can change: 6 if a rig holds the base.
        dt: duration of the step.
        impulses: those of the step before.
    """
    n = 18 - free
    radius = ground[12]
    lower = np.zeros((n, n))
    right = np.zeros((n, 13))
    for i in range(n):
        for j in range(i + 1):
            lower[i, j] = mass[free + j, free + i]
    pushes = np.zeros(18)
    rows = np.zeros((12, 18))
    depth = np.zeros(4)
    for foot in range(4):
        x, y, z = centres[foot]
        depth[foot] = radius - (x * ground[6] + y * ground[7] + z * ground[8])
        # The point that touches: below the ball's centre along the normal.
        reach = radius - max(depth[foot], 0.0)
        point = (x - reach * ground[6], y - reach * ground[7], z - reach * ground[8])
        for column in range(18):
            if column >= 6 and (column - 6) // 3 != foot:
                continue
            a, b, c = jacobian[3, column], jacobian[4, column], jacobian[5, column]
            px = jacobian[0, column] + b * point[2] - c * point[1]
            py = jacobian[1, column] + c * point[0] - a * point[2]
            pz = jacobian[2, column] + a * point[1] - b * point[0]
            for axis in range(3):
                rows[3 * foot + axis, column] = (
                    px * ground[3 * axis] + py * ground[3 * axis + 1] + pz * ground[3 * axis + 2]
                )
        # Drag on a low foot, on the ball's centre, taken at the step's beginning.
        drag = ground[13] * low(radius - depth[foot], ground[14])
        if drag > 0.0:
            for axis in range(3):
                speed = 0.0
                for column in range(18):
                    a, b, c = jacobian[3, column], jacobian[4, column], jacobian[5, column]
                    if column >= 6 and (column - 6) // 3 != foot:
                        continue
                    if axis == 0:
                        one = jacobian[0, column] + b * z - c * y
                    elif axis == 1:
                        one = jacobian[1, column] + c * x - a * z
                    else:
                        one = jacobian[2, column] + a * y - b * x
                    speed += one * velocity[column]
                for column in range(18):
                    if column >= 6 and (column - 6) // 3 != foot:
                        continue
                    a, b, c = jacobian[3, column], jacobian[4, column], jacobian[5, column]
                    if axis == 0:
                        one = jacobian[0, column] + b * z - c * y
                    elif axis == 1:
                        one = jacobian[1, column] + c * x - a * z
                    else:
                        one = jacobian[2, column] + a * y - b * x
                    pushes[column] -= drag * speed * one
    for i in range(n):
        total = pushes[free + i] - bias[free + i]
        if free + i >= 6:
            j = free + i - 6
            slope = joint_slope(friction[0, j], friction[1, j], velocity[6 + j])
            lower[i, i] += dt * slope
            total += torque[j] - slope * velocity[6 + j]
        right[i, 12] = dt * total
        for row in range(12):
            right[i, row] = rows[row, free + i]
    solve(lower, right)
    able = rows[:, free:].copy()
    ease = able @ right[:, :12].copy()
    moving = rows @ velocity + able @ right[:, 12].copy()
    contact(ease, moving, depth, ground, dt, impulses)
    after = velocity.copy()
    for i in range(n):
        change = right[i, 12]
        for row in range(12):
            change += right[i, row] * impulses[row // 3, row % 3]
        after[free + i] += change
    return after


@numba.njit(cache=True)
def low(height, reach):  # type: ignore[no-untyped-def]
    """Return how much of the drag acts on a foot at this height [m]: it fades out over a fifth of its reach."""
    share = (1.1 * reach - height) / (0.2 * reach)
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


@numba.njit(cache=True)
def solve(lower, right):  # type: ignore[no-untyped-def]
    """Replace ``right`` by the solution of A x = right, for a positive definite A whose lower triangle is given."""
    n = lower.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = lower[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            lower[i, j] = np.sqrt(total) if i == j else total / lower[j, j]
    for i in range(n):
        for k in range(i):
            right[i] -= lower[i, k] * right[k]
        right[i] /= lower[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= lower[k, i] * right[k]
        right[i] /= lower[i, i]


@numba.njit(cache=True)
def contact(ease, moving, depth, ground, dt, impulses):  # type: ignore[no-untyped-def]
    """Find (4, 3) impulses that agree with the laws at the step's end, foot by foot until nothing changes.

    Kelvin–Voigt rubber that cannot pull, N = max(0, k δ + c δ̇), and friction μ N tanh(|s| / v_s) against the slip s.
    """
    mu, stiffness, damping = ground[9], ground[10], ground[11]
    gain = stiffness * dt + damping
    for foot in range(4):
        if depth[foot] <= -0.01:
            impulses[foot] = 0.0
    for _ in range(SWEEPS):
        largest = 0.0
        for foot in range(4):
            if depth[foot] <= -0.01:
                continue
            f = 3 * foot
            v = np.empty(3)
            for axis in range(3):
                v[axis] = moving[f + axis]
                for other in range(4):
                    for a in range(3):
                        v[axis] += ease[f + axis, 3 * other + a] * impulses[other, a]
            before = impulses[foot].copy()
            without = v[2] - ease[f + 2, f + 2] * before[2]
            normal = dt * (stiffness * depth[foot] - gain * without) / (1.0 + dt * gain * ease[f + 2, f + 2])
            if depth[foot] - dt * without <= 0.0 or normal < 0.0:
                normal = 0.0
            change = normal - before[2]
            impulses[foot, 2] = normal
            v[0] += ease[f, f + 2] * change
            v[1] += ease[f + 1, f + 2] * change
            each = max(ease[f, f], ease[f + 1, f + 1]) + abs(ease[f, f + 1])
            x, y = v[0] - each * before[0], v[1] - each * before[1]
            pulled = np.hypot(x, y)
            if normal == 0.0 or pulled == 0.0:
                impulses[foot, 0] = impulses[foot, 1] = 0.0
            else:
                held = (pulled - slip_speed(pulled, mu * normal, each)) / each
                impulses[foot, 0], impulses[foot, 1] = -held * x / pulled, -held * y / pulled
            for axis in range(3):
                largest = max(largest, abs(impulses[foot, axis] - before[axis]))
        if largest < TOLERANCE:
            break
