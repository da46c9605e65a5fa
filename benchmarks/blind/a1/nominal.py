"""The world as it would be if nothing were different about it."""

from __future__ import annotations

from math import inf

import numpy as np

from benchmarks.blind.a1.robot import A1
from benchmarks.blind.a1.world import WORLD, Record

_NOMINAL = {
    "strength": 1.0,
    "sag_recovery": 3.0,
    "usual_load": 245.0,
    "voltage": 1.0,
    "speed_limit": A1.speed_limit,
    "torque_limit": A1.torque_limit,
    "torque_constant": 1.0,
    "gear_ratio": 9.1,
    "gear_stiffness": 12000.0,
    "gear_damping": 4.0,
    "rotor": 0.005,
    "coulomb": 0.1,
    "stribeck": 0.1,
    "stribeck_speed": 0.15,
    "presliding": 0.004,
    "viscous": 0.05,
    "thinning": 6.0,
    "radius": A1.foot_radius,
    "hertz": 2e7,
    "dissipation": 10.0,
    "tangent_stiffness": 2e5,
    "tangent_damping": 250.0,
    "mu": 0.8,
    "mu_rest": 0.05,
    "twist": 0.008,
    "creep_time": inf,
    "soil_stiffness": inf,
    "soil_viscosity": 100.0,
    "soil_return": 15.0,
    "drag_height": 0.06,
    "bump_width": 0.03,
    "gust_start": inf,
    "gust_end": inf,
}


def nominal() -> Record:
    """Return a (1,) world record; what is not named above is zero."""
    world = np.zeros(1, WORLD)
    for name, value in _NOMINAL.items():
        world[name] = value
    world["low"] = np.tile([low for low, _ in A1.limits], 4)
    world["high"] = np.tile([high for _, high in A1.limits], 4)
    return world
