"""Every number of the world that a rollout takes place in, and the plant's memory beside the rigid bodies.

Both are NumPy records, so that compiled code reads them by name. Whatever an
effect does, it does by moving numbers of ``WORLD``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

STEP = 0.00025
"""[s] of the physics; eight steps make a control tick."""
STEPS = 8
RATE = 500
"""Control ticks per second."""
QUEUE = 64
"""Commands that can be on their way at once."""
GRID = (128, 64)
"""Cells of the patch of uneven ground, along x and y."""
CELL = 0.016
"""[m]"""
CORNER = (-0.9, -0.512)
"""[m] of the patch's first cell."""

_J, _L = (12,), (4,)

WORLD = np.dtype(
    [
        # drives
        ("strength", "f8", _J),  # part of the asked current that flows
        ("strength_ripple", "f8"),  # of that part, over six periods a turn of the rotor
        ("sag_rate", "f8"),  # 1/s, strength lost per second at the usual load
        ("sag_recovery", "f8"),  # s
        ("usual_load", "f8"),  # N^2 m^2, sum of squared torques of an unhurried trot
        ("voltage", "f8"),  # part of the supply that is left
        ("speed_limit", "f8"),  # rad/s without load at the full supply
        ("torque_limit", "f8"),  # N m
        ("torque_constant", "f8", _J),  # true over assumed
        ("warming", "f8"),  # of the torque constant lost per second at the usual load
        ("cogging", "f8"),  # N m, torque ripple over the rotor's angle
        ("lag", "f8"),  # s, of the current loop; 0: none
        ("encoder_offset", "f8", _J),  # rad
        # gears
        ("gear_ratio", "f8"),
        ("gear_stiffness", "f8"),  # N m/rad
        ("gear_damping", "f8"),  # N m s/rad
        ("half_gap", "f8", _J),  # rad
        ("rotor", "f8", _J),  # kg m^2, seen at the joint
        ("coulomb", "f8", _J),  # N m
        ("stribeck", "f8"),  # part by which friction is higher at rest
        ("stribeck_speed", "f8"),  # rad/s
        ("presliding", "f8"),  # rad
        ("viscous", "f8", _J),  # N m s/rad, at 3 rad/s
        ("thinning", "f8"),  # rad/s, above which grease thins
        # joints' ends
        ("low", "f8", _J),
        ("high", "f8", _J),
        # feet and ground
        ("radius", "f8"),  # m
        ("hertz", "f8"),  # N/m^1.5, of the foot's rubber
        ("dissipation", "f8"),  # s/m
        ("tangent_stiffness", "f8"),  # N/m
        ("tangent_damping", "f8"),  # N s/m
        ("mu", "f8"),
        ("mu_rest", "f8"),  # part by which friction is higher at rest
        ("twist", "f8"),  # m, torsional friction
        ("creep_time", "f8"),  # s, in which a held foot's shear relaxes under 10 N; inf: never
        ("soil_stiffness", "f8"),  # N/m^1.2; inf: hard ground
        ("soil_viscosity", "f8"),  # N s/m, as it gives way
        ("soil_return", "f8"),  # so many times more as it comes back
        ("drag", "f8", _L),  # N s/m, on a low foot
        ("drag_square", "f8", _L),  # N s^2/m^2
        ("drag_coulomb", "f8", _L),  # N, on a low foot
        ("drag_height", "f8"),  # m
        ("roughness", "f8"),  # m
        ("cross_slope", "f8"),  # rise to the left over run
        ("bump_at", "f8"),  # m
        ("bump_height", "f8"),  # m
        ("bump_width", "f8"),  # m
        # trunk
        ("gust", "f8", (3,)),  # N, world axes
        ("gust_start", "f8"),  # s
        ("gust_end", "f8"),
        ("tether_stiffness", "f8"),  # N/m
        ("tether_slack", "f8"),  # m ahead of where the rollout began
        ("tether_height", "f8"),  # m above the trunk's centre of mass
        ("slosh_mass", "f8"),  # kg, of what swings on the trunk
        ("slosh_rate", "f8"),  # rad/s
        ("slosh_damping", "f8"),  # part of critical
        ("slosh_height", "f8"),  # m above the trunk's centre of mass
        # gravity
        ("slope", "f8"),  # rad, uphill in +x
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("angle", "f8", _J),  # rad, of the rotors, seen at the joint
        ("speed", "f8", _J),
        ("presliding", "f8", _J),  # rad
        ("current", "f8", _J),  # N m, as the drives report it
        ("sag", "f8"),
        ("heat", "f8"),
        ("shear", "f8", (4, 3)),  # m, of the rubber
        ("yield_", "f8", _L),  # m, of the soil under each foot
        ("ground_force", "f8", (4, 3)),  # N
        ("slosh", "f8", (2,)),  # m
        ("slosh_speed", "f8", (2,)),
        ("origin", "f8"),  # m, x at the command
        ("clock", "f8"),  # s
        ("queue", "f8", (QUEUE, 5, 12)),  # motor laws, a ring
        ("due", "f8", (QUEUE,)),  # s, on the clock
        ("sent", "i8"),
        ("in_force", "i8"),  # which of those that were sent; -1: none has arrived
    ],
    align=True,
)

Record = NDArray[Any]


def fresh() -> Record:
    """Return a (1,) state record in which nothing has happened yet."""
    state = np.zeros(1, STATE)
    state["due"] = np.inf
    state["in_force"] = -1
    return state
