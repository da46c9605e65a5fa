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
"""Definition: speed of a motor without load [rad/s], by the vendor."""
CURRENT_TIME = 0.0006
"""Definition: time constant of the current loop [s], a bandwidth of 265 Hz. Doubled, torques come 0.6 ms later."""
SPEED_TIME = 0.0008
"""Definition: time constant of the drive's speed filter [s]. Doubled, speeds are read 0.8 ms later."""
ENCODER_STEP = 2.0 * np.pi / 65536.0
"""Definition: resolution of the encoders at the joint [rad], 16 bits a turn."""
JOINT_SPEED = 0.03
"""Definition: speed scale of the joints' Coulomb friction [rad/s]. Doubled, a loaded joint creeps twice as fast."""
SLIP_SPEED = 0.002
"""Definition: speed scale of the feet's friction [m/s]. Doubled, loaded feet creep twice as fast."""
REACH = 0.01
"""Tolerance: height of a foot [m] above which a step leaves out its contact; no foot falls so far in a step."""
SWEEPS = 40
"""Budget: sweeps over the contacts in a step."""
TOLERANCE = 1e-7
"""Tolerance: change of an impulse between two sweeps [N s]."""


@numba.njit(cache=True)
def drive(law, strength, dt, angle, speed, state):  # type: ignore[no-untyped-def]
    """Run the drives for one step.

    Args:
        law: (5, 12) q, q̇, Kp, Kd, τ of the motor law.
        strength: torque that flows, as a fraction of the command.
        dt: duration of the step [s].
        angle: (12,) of the encoders' shafts [rad].
        speed: (12,) of the same [rad/s].
        state: (4, 12) angle as read, its speed, current as a torque [N m], and whether there was a step before.
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
            most = strength * TORQUE_LIMIT * max(2.0 * (1.0 - abs(speed[j]) / TOP_SPEED), 0.0)
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
def advance(terms, centres, velocity, torque, friction, ground, free, dt, impulses):  # type: ignore[no-untyped-def]
    """Return (18,) velocities a step later; ``impulses`` (4, 3) [N s], along the ground's axes, is updated in place.

    Args:
        terms: (18, 18) mass matrix, of which the upper triangle counts; (18,) Coriolis, centrifugal and gravitational
            forces; (6, 18) Jacobian of all joints in the world, linear rows at its origin, then angular rows.
        centres: (4, 3) of the balls at the feet.
        velocity: (18,) at the step's beginning.
        torque: (12,) on the joints.
        friction: (2, 12) Coulomb and viscous friction of the joints.
        ground: (15,) as made by ``plant.py``.
        free: first of the velocities that can change: 6 if a rig holds the base.
        dt: duration of the step.
        impulses: those of the step before.
    """
    mass, bias, jacobian = terms
    n = 18 - free
    near = np.zeros(4, np.int64)
    depth, push = np.zeros(4), np.zeros(18)
    row, rows = np.zeros((3, 18)), np.zeros((12, 18))
    count = 0
    for foot in range(4):
        x, y, z = centres[foot, 0], centres[foot, 1], centres[foot, 2]
        height = x * ground[6] + y * ground[7] + z * ground[8]
        drag = ground[13] * low(height, ground[14])
        if drag > 0.0:
            carry(jacobian, x, y, z, foot, row)
            for axis in range(3):
                speed = 0.0
                for k in range(18):
                    speed += row[axis, k] * velocity[k]
                for k in range(18):
                    push[k] -= drag * speed * row[axis, k]
        if height - ground[12] > REACH:
            for axis in range(3):
                impulses[foot, axis] = 0.0
            continue
        depth[count] = ground[12] - height
        below = min(ground[12], height)  # the point that touches lies below the ball's centre
        carry(jacobian, x - below * ground[6], y - below * ground[7], z - below * ground[8], foot, row)
        for axis in range(3):
            for k in range(18):
                rows[3 * count + axis, k] = (
                    ground[3 * axis] * row[0, k]
                    + ground[3 * axis + 1] * row[1, k]
                    + ground[3 * axis + 2] * row[2, k]
                )
        near[count] = foot
        count += 1
    m = 3 * count
    lower, right = np.zeros((n, n)), np.zeros((n, m + 1))
    for i in range(n):
        for j in range(i + 1):
            lower[i, j] = mass[free + j, free + i]
        total, joint = push[free + i] - bias[free + i], free + i - 6
        if joint >= 0:
            slope = joint_slope(friction[0, joint], friction[1, joint], velocity[6 + joint])
            lower[i, i] += dt * slope
            total += torque[joint] - slope * velocity[6 + joint]
        for k in range(m):
            right[i, k] = rows[k, free + i]
        right[i, m] = dt * total
    solve(lower, right)
    after = np.zeros(18)
    for i in range(n):
        after[free + i] = velocity[free + i] + right[i, m]
    ease, moving, found = np.zeros((12, 12)), np.zeros(12), np.zeros((4, 3))
    for k in range(m):
        for i in range(n):
            moving[k] += rows[k, free + i] * after[free + i]
            for other in range(m):
                ease[k, other] += rows[k, free + i] * right[i, other]
        found[k // 3, k % 3] = impulses[near[k // 3], k % 3]
    contact(count, ease, moving, depth, ground, dt, found)
    for k in range(m):
        impulses[near[k // 3], k % 3] = found[k // 3, k % 3]
        for i in range(n):
            after[free + i] += right[i, k] * found[k // 3, k % 3]
    return after


@numba.njit(cache=True)
def carry(jacobian, x, y, z, foot, row):  # type: ignore[no-untyped-def]
    """Write (3, 18) what carries velocities to the velocity of the point (x, y, z) on a foot, world axes."""
    for k in range(18):
        row[0, k] = row[1, k] = row[2, k] = 0.0
    for k in range(9):
        column = k if k < 6 else 3 * foot + k
        a, b, c = jacobian[3, column], jacobian[4, column], jacobian[5, column]
        row[0, column] = jacobian[0, column] + b * z - c * y
        row[1, column] = jacobian[1, column] + c * x - a * z
        row[2, column] = jacobian[2, column] + a * y - b * x


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
    for c in range(right.shape[1]):
        for i in range(n):
            for k in range(i):
                right[i, c] -= lower[i, k] * right[k, c]
            right[i, c] /= lower[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                right[i, c] -= lower[k, i] * right[k, c]
            right[i, c] /= lower[i, i]


@numba.njit(cache=True)
def contact(count, ease, moving, depth, ground, dt, impulses):  # type: ignore[no-untyped-def]
    """Find the impulses of feet that agree with the laws at the step's end, foot by foot until nothing changes.

    Kelvin–Voigt rubber that cannot pull, N = max(0, k δ + c δ̇), and friction μ N tanh(|s| / v_s) against the slip s.

    Args:
        count: number of the feet; they come first in all arrays.
        ease: (12, 12) velocities of the contacts under unit impulses.
        moving: (12,) velocities of the contacts without impulses.
        depth: (4,) of the feet in the ground.
        ground: as in :func:`advance`.
        dt: duration of the step.
        impulses: (4, 3), a first guess; updated in place.
    """
    mu, stiffness, damping = ground[9], ground[10], ground[11]
    gain = stiffness * dt + damping
    v = np.empty(3)
    for _ in range(SWEEPS):
        largest = 0.0
        for foot in range(count):
            f = 3 * foot
            x, y, z = impulses[foot, 0], impulses[foot, 1], impulses[foot, 2]
            for axis in range(3):
                v[axis] = moving[f + axis]
                for k in range(3 * count):
                    v[axis] += ease[f + axis, k] * impulses[k // 3, k % 3]
            without = v[2] - ease[f + 2, f + 2] * z
            normal = dt * (stiffness * depth[foot] - gain * without) / (1.0 + dt * gain * ease[f + 2, f + 2])
            if depth[foot] - dt * without <= 0.0 or normal < 0.0:
                normal = 0.0
            each = max(ease[f, f], ease[f + 1, f + 1]) + abs(ease[f, f + 1])
            pull_x = v[0] + ease[f, f + 2] * (normal - z) - each * x
            pull_y = v[1] + ease[f + 1, f + 2] * (normal - z) - each * y
            pulled = np.hypot(pull_x, pull_y)
            held = 0.0
            if normal > 0.0 and pulled > 0.0:
                held = (1.0 - slip_speed(pulled, mu * normal, each) / pulled) / each
            impulses[foot, 0], impulses[foot, 1], impulses[foot, 2] = -held * pull_x, -held * pull_y, normal
            change = abs(impulses[foot, 0] - x) + abs(impulses[foot, 1] - y) + abs(normal - z)
            largest = max(largest, change)
        if largest < TOLERANCE:
            break
