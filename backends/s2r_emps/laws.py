"""The forces on the axis over a whole recording, (n,) each; a test holds them to the simulator's own ticks."""

from __future__ import annotations

from math import exp, pi

import numpy as np

from s2r_emps.noise import FloatArray
from s2r_emps.physics import LEAD, MIDDLE, STEP, VOLTAGE, Physics

TURN = 2 * pi / LEAD
"""[rad/m]"""
RIPPLES = 4
"""Periods of the motor's force ripple in a turn."""


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


def resistance(q: FloatArray, v: FloatArray, physics: Physics) -> FloatArray:
    """Return what the motor must overcome besides inertia and dry friction [N]."""
    p = physics
    return p.viscous * v + p.drag * v * np.abs(v) + p.cable * (q - MIDDLE) + p.offset


def dry_friction(v: FloatArray, force: FloatArray, physics: Physics) -> FloatArray:
    """Return the largest force [N] with which dry friction can act."""
    p = physics
    fading = np.exp(-((v / p.stribeck_speed) ** 2))
    return np.asarray(p.coulomb + p.stribeck * fading + p.load_friction * np.abs(force))


def encoder_error(q: FloatArray, physics: Physics) -> FloatArray:
    """Return by how much the encoder reads too much [m] at a position [m]."""
    return np.asarray(physics.encoder_ripple * np.sin(TURN * q + physics.encoder_phase))


def smoothed(values: FloatArray, time: float, first: float) -> FloatArray:
    """Return values behind a first-order lag [s] that starts from ``first``."""
    from scipy.signal import lfilter  # here: a rollout needs no scipy

    keep = exp(-STEP / time)
    return np.asarray(lfilter([1 - keep], [1, -keep], values, zi=[keep * first])[0])
