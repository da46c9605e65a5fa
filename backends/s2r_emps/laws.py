"""The forces on the axis over a whole recording, (n,) each; a test holds them to the simulator's own ticks."""

from __future__ import annotations

from math import exp, pi

import numpy as np

from s2r_emps.noise import FloatArray
from s2r_emps.physics import LEAD, MIDDLE, STEP, VOLTAGE, Physics
from s2r_spec.compiled import compiled

TURN = 2 * pi / LEAD
"""[rad/m]"""
RIPPLES = 4
"""Periods of the motor's force ripple in a turn."""
STILL = 2e-3
"""[m/s] below which dry friction holds anything up to itself: there it explains what it can."""


def drive_force(u: FloatArray, q: FloatArray, physics: Physics) -> FloatArray:
    """Return the motor's force [N] at these voltages [V] and positions [m], delayed, late, sagging, rippled.

    A voltage is held for the tick after its sample: on average it acts half a tick later.
    """
    ticks = np.arange(u.size, dtype=np.float64)
    current = np.interp(ticks - physics.delay / STEP, ticks, u)
    if physics.lag:
        late = np.concatenate((current[:1], smoothed(current, physics.lag, float(current[0]))[:-1]))
        current = current + physics.lag / STEP * (1 - exp(-STEP / physics.lag)) * (late - current)
    current = np.interp(ticks - 0.5, ticks, current)
    force = physics.gain * current * (1 - physics.sag / VOLTAGE * np.abs(current))
    return np.asarray(force + physics.ripple * np.sin(RIPPLES * TURN * q + physics.ripple_phase))


def lacking(
    q: FloatArray, v: FloatArray, speeds_up: FloatArray, force: FloatArray, physics: Physics
) -> FloatArray:
    """Return the force [N] that a motion (m, m/s, m/s²) takes beyond the motor's force [N] and the resistance.

    Dry friction holds anything up to itself at rest, and explains what it can there.
    """
    p = physics
    found: FloatArray = _lacking(
        *(q, v, speeds_up, force),
        *(p.mass, p.viscous, p.drag, p.cable, p.offset),
        *(p.coulomb, p.stribeck, p.stribeck_speed, p.load_friction),
    )
    return found


@compiled
def _lacking(
    q: FloatArray,
    v: FloatArray,
    speeds_up: FloatArray,
    force: FloatArray,
    mass: float,
    viscous: float,
    drag: float,
    cable: float,
    offset: float,
    coulomb: float,
    stribeck: float,
    stribeck_speed: float,
    screw: float,
) -> FloatArray:
    left = np.empty_like(v)
    dry = coulomb != 0.0 or stribeck != 0.0 or screw != 0.0
    for k in range(v.size):
        resistance = viscous * v[k] + drag * v[k] * abs(v[k]) + cable * (q[k] - MIDDLE) + offset
        lacks = mass * speeds_up[k] + resistance - force[k]
        brake = 0.0
        if dry:
            fading = v[k] / stribeck_speed
            brake = coulomb + stribeck * exp(-(fading * fading)) + screw * abs(force[k])
        if abs(v[k]) > STILL:
            left[k] = lacks + (brake if v[k] > 0.0 else -brake)
        elif abs(lacks) <= brake:
            left[k] = 0.0
        else:  # what was not recorded is not a number, and stays none
            left[k] = lacks - brake if lacks > 0.0 else lacks + brake
    return left


def encoder_error(q: FloatArray, physics: Physics) -> FloatArray:
    """Return by how much the encoder reads too much [m] at a position [m]."""
    return np.asarray(physics.encoder_ripple * np.sin(TURN * q + physics.encoder_phase))


def smoothed(values: FloatArray, time: float, first: float) -> FloatArray:
    """Return values behind a first-order lag [s] that starts from ``first``."""
    from scipy.signal import lfilter  # here: a rollout needs no scipy

    keep = exp(-STEP / time)
    return np.asarray(lfilter([1 - keep], [1, -keep], values, zi=[keep * first])[0])
