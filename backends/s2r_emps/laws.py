"""Forces on the axis over a whole recording, (n,) each; a test compares them with the simulator's ticks."""

from __future__ import annotations

from math import exp, pi

import numpy as np

from s2r_emps.noise import FloatArray
from s2r_emps.physics import LEAD, MIDDLE, STEP, VOLTAGE, Physics
from s2r_spec.compiled import compiled

TURN = 2 * pi / LEAD
"""Motor angle per travel of the carriage [rad/m]."""
RIPPLES = 4
"""Periods of the motor's force ripple per turn."""
STILL = 2e-3
"""Speed below which dry friction counts as static friction [m/s]: it balances any force up to its own size."""


def drive_force(u: FloatArray, q: FloatArray, physics: Physics) -> FloatArray:
    """Return the motor's force [N] at these voltages [V] and positions [m], with delay, lag, sag and ripple.

    A voltage is held for the tick after its sample, so it acts half a tick later on average.
    """
    ticks = np.arange(u.size, dtype=np.float64)
    current = np.interp(ticks - physics.delay / STEP, ticks, u)
    if physics.lag:
        late = np.concatenate((current[:1], smooth(current, physics.lag, float(current[0]))[:-1]))
        current = current + physics.lag / STEP * (1 - exp(-STEP / physics.lag)) * (late - current)
    current = np.interp(ticks - 0.5, ticks, current)
    force = physics.gain * current * (1 - physics.sag / VOLTAGE * np.abs(current))
    return np.asarray(force + physics.ripple * np.sin(RIPPLES * TURN * q + physics.ripple_phase))


def lacking_force(
    q: FloatArray, v: FloatArray, speeds_up: FloatArray, force: FloatArray, physics: Physics
) -> FloatArray:
    """Return the force [N] that a motion (m, m/s, m/s²) needs on top of the motor's force [N] and the resistance.

    At rest, dry friction balances any force up to its own size.
    """
    p = physics
    resistance = (
        p.viscous * (v + p.viscous_direction * np.abs(v))
        + p.drag * v * np.abs(v)
        + p.cable * (q - MIDDLE)
        + p.offset
    )
    unbalanced = p.mass * speeds_up + resistance - force
    friction = _dry_friction(v, force, p.coulomb, p.stribeck, p.stribeck_speed, p.load_friction)
    return _less_friction(unbalanced, v, friction)


@compiled
def _dry_friction(
    v: FloatArray,
    force: FloatArray,
    coulomb: float,
    stribeck: float,
    stribeck_speed: float,
    load_friction: float,
) -> FloatArray:
    """Return (n,) the size of dry friction [N] at a speed [m/s] under the motor's force [N]; see :class:`Physics`."""
    size = np.zeros_like(v)
    if coulomb != 0.0 or stribeck != 0.0 or load_friction != 0.0:
        for k in range(v.size):
            fading = v[k] / stribeck_speed
            size[k] = coulomb + stribeck * exp(-(fading * fading)) + load_friction * abs(force[k])
    return size


@compiled
def _less_friction(unbalanced: FloatArray, v: FloatArray, friction: FloatArray) -> FloatArray:
    """Return (n,) the force that dry friction of this size leaves unbalanced [N]; a NaN stays NaN."""
    left = np.empty_like(v)
    for k in range(v.size):
        lacks, size = unbalanced[k], friction[k]
        if abs(v[k]) > STILL:
            left[k] = lacks + (size if v[k] > 0.0 else -size)
        elif abs(lacks) <= size:
            left[k] = 0.0
        else:
            left[k] = lacks - size if lacks > 0.0 else lacks + size
    return left


def encoder_error(q: FloatArray, physics: Physics) -> FloatArray:
    """Return the encoder's error [m] at a position [m]."""
    return np.asarray(physics.encoder_ripple * np.sin(TURN * q + physics.encoder_phase))


def smooth(values: FloatArray, time: float, first: float) -> FloatArray:
    """Return values filtered by a first-order lag of time constant ``time`` [s] that starts from ``first``."""
    from scipy.signal import lfilter  # here: a rollout needs no scipy

    keep = exp(-STEP / time)
    return np.asarray(lfilter([1 - keep], [1, -keep], values, zi=[keep * first])[0])
