"""How warm the motors get: first order, towards a temperature that grows with the square of the torque.

    dT/dt = (T_ambient + c τ² − T) / time constant

All constants are levels of this twin, not figures of the robot; published is only that its motors stop themselves
within 5 to 7 min of walking with 3 kg (arXiv 2605.27046). ``RISE`` is small on purpose: a twin that walks for an hour
in lock step, where no time passes at rest, stays below the 50 °C at which no test begins. Heat is an inject.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

AMBIENT = 25.0
"""A level: [°C] of all motors at the beginning."""
RISE = 0.1
"""A level: [K/(N·m)²] at which a motor ends above ambient. In the trot of `s2r_sim` the mean τ² of a calf is 60 (N·m)²,
which ends at +6 K; twice as much, at +12 K."""
TIME_CONSTANT = 300.0
"""A level: [s]."""


def warmed(temperature: FloatArray, torque: FloatArray, seconds: float) -> FloatArray:
    """Return (12,) temperatures [°C] after so much time at (12,) torques [N·m]."""
    return temperature + (AMBIENT + RISE * torque**2 - temperature) * (seconds / TIME_CONSTANT)
