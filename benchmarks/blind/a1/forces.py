"""All forces on the rigid bodies, one physics step at a time: drives, gears, ground, grass, air. Compiled.

The ground is flat in the frame of the physics; a slope leans gravity instead.
"""

from __future__ import annotations

from math import asinh, exp, inf, pi, sin, sqrt

import numba
import numpy as np

from benchmarks.blind.a1.world import CELL, CORNER, GRID, QUEUE, STEP

_RIPPLES, _COGS = 6.0, 12.0
"""Periods a turn of the rotor."""
_USUAL_SPEED = 3.0
"""[rad/s] at which a viscous coefficient is what it says."""
_STOP, _STOP_DAMPING = 300.0, 2.0
"""[N m/rad], [N m s/rad] of the joints' ends."""
_CREEP_FORCE = 10.0
"""[N]"""
_EDGE = 0.006
"""[m] over which grass thins out."""
_GROWS = 0.2
"""[s] before the command, in which the ground becomes uneven."""


@numba.njit(cache=True, error_model="numpy")
def act(world, state, elapsed, bodies, ground, forces):
    """Advance drives and soil by a step, and write the forces on the bodies.

    Args:
        world: (1,) record.
        state: (1,) record, advanced.
        elapsed: time since the command, negative before [s].
        bodies: the rigid bodies' motion, a tuple of

            - (19,) ``qpos`` and (18,) ``qvel`` of MuJoCo,
            - (4, 3) ball centres [m],
            - (nbody, 6) angular and linear velocity of the bodies, at the robot's centre of mass,
            - (3,) the robot's centre of mass [m],
            - (nbody, 3) centres of mass of the bodies [m]; the trunk is body 1,
            - (4,) numbers of the shanks' bodies.
        ground: the patch of uneven ground, in standard deviations.
        forces: two arrays to write: (18,) generalised forces, of the joints only, and (nbody, 6) force and
            torque at the bodies' centres of mass.
    """
    w, s = world[0], state[0]
    joints, wrenches = forces
    _drives(w, s, elapsed, bodies, joints)
    for foot in range(4):
        _foot(w, s, foot, elapsed, bodies, ground, wrenches)
    _trunk(w, s, elapsed, bodies, wrenches)
    s.clock += STEP


@numba.njit(cache=True, error_model="numpy")
def _drives(w, s, elapsed, bodies, joints):
    qpos, qvel, _, _, _, _, _ = bodies
    for sent in range(max(s.in_force + 1, s.sent - QUEUE), s.sent):
        if s.due[sent % QUEUE] <= s.clock + 1e-9:
            s.in_force = sent
    # Before any has arrived: the last place of the queue, which is empty then.
    law = s.queue[s.in_force % QUEUE]
    load = 0.0
    for j in range(12):
        angle, speed, q, dq = s.angle[j], s.speed[j], qpos[7 + j], qvel[6 + j]
        asked = (
            law[4, j]
            + law[2, j] * (law[0, j] - angle - w.encoder_offset[j])
            + law[3, j] * (law[1, j] - speed)
        )
        bound = w.torque_limit
        if asked * speed > 0.0:
            bound *= _soft_unit(2.0 * (w.voltage - abs(speed) / w.speed_limit))
        asked /= (1.0 + (asked / bound) ** 8) ** 0.125
        turn = w.gear_ratio * angle
        asked *= w.strength[j] * (1.0 - s.sag) * (1.0 + w.strength_ripple * sin(_RIPPLES * turn))
        s.current[j] += (asked - s.current[j]) * STEP / (w.lag + STEP)
        load += s.current[j] ** 2
        torque = w.torque_constant[j] * (1.0 - s.heat) * s.current[j] + w.cogging * sin(_COGS * turn)

        # The rubbed surface gives way a little before it slides (Dahl), and holds more at rest.
        grip = w.coulomb[j] * (1.0 + w.stribeck * exp(-((speed / w.stribeck_speed) ** 2)))
        bent = (s.presliding[j] + speed * STEP) / (1.0 + abs(speed) * STEP / w.presliding)
        s.presliding[j] = bent
        thin = w.viscous[j] * _USUAL_SPEED * asinh(speed / w.thinning) / asinh(_USUAL_SPEED / w.thinning)

        twist, gap = angle - q, w.half_gap[j]
        meshed = twist - min(gap, max(-gap, twist))
        through = w.gear_stiffness * meshed
        if gap == 0.0:
            through += w.gear_damping * (speed - dq)
        elif meshed != 0.0:
            through += w.gear_damping * (speed - dq) * abs(meshed) / (abs(meshed) + 2e-5)
            if through * meshed < 0.0:
                through = 0.0
        speed += (torque - grip * bent / w.presliding - thin - through) / w.rotor[j] * STEP
        s.speed[j] = speed
        s.angle[j] = angle + speed * STEP
        beyond = q - min(w.high[j], max(w.low[j], q))
        stop = _STOP * beyond + (_STOP_DAMPING * dq if beyond != 0.0 else 0.0)
        joints[6 + j] = through - stop
    if elapsed >= 0.0:
        s.sag += (w.sag_rate * load / w.usual_load - s.sag / w.sag_recovery) * STEP
        s.heat += w.warming * load / w.usual_load * STEP


@numba.njit(cache=True, error_model="numpy")
def _soft_unit(x):
    """Return x between 0 and 1, with rounded corners."""
    above = 0.5 * (x + sqrt(x * x + 4e-4))
    return above / (1.0 + above**6) ** (1.0 / 6.0)


@numba.njit(cache=True, error_model="numpy")
def _surface(w, elapsed, x, y, origin, ground):
    """Return height and its derivatives along x and y."""
    height, along, across = w.cross_slope * y, 0.0, w.cross_slope
    if w.bump_height != 0.0:
        u = (x - origin - w.bump_at) / w.bump_width
        h = w.bump_height * exp(-u * u)
        height += h
        along -= 2.0 * u / w.bump_width * h
    if w.roughness != 0.0:
        scale = w.roughness * min(1.0, max(0.0, 1.0 + elapsed / _GROWS))
        i = (x - CORNER[0]) / CELL
        j = (y - CORNER[1]) / CELL
        i = min(max(i, 0.0), GRID[0] - 2.0)
        j = min(max(j, 0.0), GRID[1] - 2.0)
        a, b = int(i), int(j)
        u, v = i - a, j - b
        p, q, r, t = ground[a, b], ground[a + 1, b], ground[a, b + 1], ground[a + 1, b + 1]
        height += scale * ((p * (1 - u) + q * u) * (1 - v) + (r * (1 - u) + t * u) * v)
        along += scale / CELL * ((q - p) * (1 - v) + (t - r) * v)
        across += scale / CELL * ((r - p) * (1 - u) + (t - q) * u)
    return height, along, across


@numba.njit(cache=True, error_model="numpy")
def _foot(w, s, foot, elapsed, bodies, ground, wrenches):
    _, _, sites, twists, centre, masses_at, shanks = bodies
    body = shanks[foot]
    x, y, z = sites[foot]
    wx, wy, wz, ux, uy, uz = twists[body]
    rx, ry, rz = x - centre[0], y - centre[1], z - centre[2]
    vx, vy, vz = ux + wy * rz - wz * ry, uy + wz * rx - wx * rz, uz + wx * ry - wy * rx
    height, along, across = _surface(w, elapsed, x, y, s.origin, ground)

    # In the grass: at the ball's centre.
    near = 1.0 / (1.0 + exp((z - height - w.drag_height) / _EDGE))
    fast = sqrt(vx * vx + vy * vy + vz * vz)
    hold = near * (w.drag[foot] + w.drag_square[foot] * fast + w.drag_coulomb[foot] / (fast + 0.05))
    gx, gy, gz = -hold * vx, -hold * vy, -hold * vz

    # On the ground: at the lowest point of the ball, if it is hard.
    norm = sqrt(1.0 + along * along + across * across)
    nx, ny, nz = -along / norm, -across / norm, 1.0 / norm
    depth = w.radius - (z - height) * nz - s.yield_[foot]
    fx = fy = fz = 0.0
    # Soil holds the ball over all of the depth that it has sunk, and so by half of that higher.
    arm = w.radius - 0.5 * min(s.yield_[foot], w.radius)
    px, py, pz = -arm * nx, -arm * ny, -arm * nz
    normal = 0.0
    if depth > 0.0:
        cx, cy, cz = vx + wy * pz - wz * py, vy + wz * px - wx * pz, vz + wx * py - wy * px
        closing = -(cx * nx + cy * ny + cz * nz)
        normal = w.hertz * depth * sqrt(depth) * max(0.0, 1.0 + w.dissipation * closing)
        tx, ty, tz = cx + closing * nx, cy + closing * ny, cz + closing * nz
        k = w.tangent_stiffness
        c = w.tangent_damping / (1.0 + w.tangent_damping / k / w.creep_time)
        sx, sy, sz = s.shear[foot, 0], s.shear[foot, 1], s.shear[foot, 2]
        hurry = sqrt(k * sqrt(sx * sx + sy * sy + sz * sz) / _CREEP_FORCE)
        keep = 1.0 / (1.0 + STEP / w.creep_time * hurry)
        sx, sy, sz = sx * keep + tx * STEP, sy * keep + ty * STEP, sz * keep + tz * STEP
        fx, fy, fz = -k * sx - c * tx, -k * sy - c * ty, -k * sz - c * tz
        slip = sqrt(tx * tx + ty * ty + tz * tz)
        most = w.mu * (1.0 + w.mu_rest * exp(-slip / 0.05)) * normal
        force = sqrt(fx * fx + fy * fy + fz * fz)
        if force > most:
            part = most / force
            fx, fy, fz = part * fx, part * fy, part * fz
            sx, sy, sz = -(fx + c * tx) / k, -(fy + c * ty) / k, -(fz + c * tz) / k
        s.shear[foot, 0], s.shear[foot, 1], s.shear[foot, 2] = sx, sy, sz
        fx, fy, fz = fx + normal * nx, fy + normal * ny, fz + normal * nz
    else:
        s.shear[foot, 0] = s.shear[foot, 1] = s.shear[foot, 2] = 0.0
    if w.soil_stiffness < inf:
        # Soil under the foot: a spring and a damper side by side, in series with the rubber; implicit in both springs.
        # It gives way at once, and comes back slowly.
        sunk, part = s.yield_[foot], STEP / w.soil_viscosity
        rubber = 1.5 * normal / depth if depth > 0.0 else 0.0
        soil = w.soil_stiffness * sunk**0.2
        if normal < soil * sunk:
            part /= w.soil_return
        s.yield_[foot] = (sunk + part * (normal + rubber * sunk)) / (1.0 + part * (soil + rubber))
    s.ground_force[foot, 0], s.ground_force[foot, 1], s.ground_force[foot, 2] = fx, fy, fz

    dx, dy, dz = x - masses_at[body, 0], y - masses_at[body, 1], z - masses_at[body, 2]
    qx, qy, qz = dx + px, dy + py, dz + pz
    turn = -w.twist * normal * np.tanh(2.0 * (wx * nx + wy * ny + wz * nz))
    wrenches[body, 0], wrenches[body, 1], wrenches[body, 2] = fx + gx, fy + gy, fz + gz
    wrenches[body, 3] = qy * fz - qz * fy + dy * gz - dz * gy + turn * nx
    wrenches[body, 4] = qz * fx - qx * fz + dz * gx - dx * gz + turn * ny
    wrenches[body, 5] = qx * fy - qy * fx + dx * gy - dy * gx + turn * nz


@numba.njit(cache=True, error_model="numpy")
def _trunk(w, s, elapsed, bodies, wrenches):
    qpos, qvel, _, _, _, masses_at, _ = bodies
    fx = fy = fz = tx = ty = 0.0
    if w.gust_start <= elapsed < w.gust_end:
        shape = sin(pi * (elapsed - w.gust_start) / (w.gust_end - w.gust_start))
        fx, fy, fz = w.gust[0] * shape, w.gust[1] * shape, w.gust[2] * shape
    if w.tether_stiffness != 0.0 and elapsed > -_GROWS:
        pull = w.tether_stiffness * max(0.0, qpos[0] - s.origin - w.tether_slack)
        fx -= pull
        ty -= w.tether_height * pull
    if w.slosh_mass != 0.0:
        for axis in range(2):
            away = s.slosh[axis] - masses_at[1, axis]
            rate = s.slosh_speed[axis] - qvel[axis]
            pull = -(w.slosh_rate**2) * away - 2.0 * w.slosh_damping * w.slosh_rate * rate
            s.slosh_speed[axis] += pull * STEP
            s.slosh[axis] += s.slosh_speed[axis] * STEP
            if axis == 0:
                fx -= w.slosh_mass * pull
                ty -= w.slosh_height * w.slosh_mass * pull
            else:
                fy -= w.slosh_mass * pull
                tx += w.slosh_height * w.slosh_mass * pull
        fz -= w.slosh_mass * 9.81
        # What swings stands off to one side, and so turns the trunk.
        tx -= w.slosh_mass * 9.81 * (s.slosh[1] - masses_at[1, 1])
        ty += w.slosh_mass * 9.81 * (s.slosh[0] - masses_at[1, 0])
    wrenches[1, 0], wrenches[1, 1], wrenches[1, 2] = fx, fy, fz
    wrenches[1, 3], wrenches[1, 4], wrenches[1, 5] = tx, ty, 0.0
