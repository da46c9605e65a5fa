"""The drives and joints of the stiff plant, compiled."""

from __future__ import annotations

import numba
import numpy as np

TORQUE_LIMIT = 33.5
"""Definition: largest torque of a motor at its joint [N m], by the vendor."""
TORQUE_STEP = 1.0 / 64.0
"""Definition: resolution of a drive's torque [N m]."""
GEAR_LOSS = 0.01
"""Definition: part of a gear's load that it loses to dry friction. A planetary stage loses 1 to 3 %."""
STRIBECK, STRIBECK_SPEED = 0.25, 0.15
"""Definitions: part by which dry friction is higher at rest, and the speed [rad/s] that leaves a third of it."""
FLUID_POWER = 0.9
"""Definition: power of speed in viscous friction, per 1 rad/s: grease thins."""


@numba.njit(cache=True)
def demand(law, strength, angle, speed):  # type: ignore[no-untyped-def]
    """Return (12,) torques that the drives demand after one sample; ``law`` (5, 12) is q, q̇, Kp, Kd, τ."""
    torque = np.empty(12)
    for j in range(12):
        wanted = law[4, j] + law[2, j] * (law[0, j] - angle[j]) + law[3, j] * (law[1, j] - speed[j])
        wanted = min(max(wanted, -TORQUE_LIMIT), TORQUE_LIMIT)
        torque[j] = strength * np.round(wanted / TORQUE_STEP) * TORQUE_STEP
    return torque


@numba.njit(cache=True)
def friction(dry, viscous, torque, speed):  # type: ignore[no-untyped-def]
    """Return (12,) largest dry friction and (12,) fluid friction torque [N m] of the joints in one step."""
    most, fluid = np.empty(12), np.empty(12)
    for j in range(12):
        size = abs(speed[j])
        rise = 1.0 + STRIBECK * np.exp(-((size / STRIBECK_SPEED) ** 2))
        most[j] = dry[j] * rise + GEAR_LOSS * abs(torque[j])
        fluid[j] = -np.sign(speed[j]) * viscous[j] * size**FLUID_POWER
    return most, fluid
