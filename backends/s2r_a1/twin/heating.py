"""Motor temperatures: a first-order model whose equilibrium grows with the square of the torque.

    dT/dt = (T_ambient + c τ² − T) / time constant

All constants are levels of this twin, not constants of the robot. It is only published that the robot's motors stop
themselves within 5 to 7 min of walking with 3 kg (arXiv 2605.27046). ``RISE`` is deliberately small: a twin that walks
for an hour in lock step, without rests, stays below 50 °C, above which no test begins. Hot motors are an inject.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

AMBIENT = 25.0
"""A level [°C]: initial temperature of all motors."""
RISE = 0.1
"""A level [K/(N·m)²]: equilibrium temperature rise per squared torque. In the trot of `s2r_sim` the mean τ² of a calf
is 60 (N·m)², which gives +6 K."""
TIME_CONSTANT = 300.0
"""A level [s]: time constant of the temperature."""


def warm(temperature: FloatArray, torque: FloatArray, seconds: float) -> FloatArray:
    """Return (12,) temperatures [°C] after a time [s] at (12,) torques [N·m]."""
    return temperature + (AMBIENT + RISE * torque**2 - temperature) * (seconds / TIME_CONSTANT)
