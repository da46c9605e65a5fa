"""A recorded reference, to be followed again from a chosen moment: the files of the EMPS data set.

``t`` [s], ``qg`` position asked for [m] and, where it is there, ``qm`` position
measured [m]. The data set is at nonlinearbenchmark.org and is not part of this
project.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from s2r_emps.noise import FloatArray
from s2r_emps.physics import RATE
from s2r_spec.errors import UsageError, one_of

LEAD_IN = 0.5
"""[s] of the record that run before the wanted part: ten times what the loop remembers."""
_SETTLED = 10
"""Samples over which the first speed is read from the measured position."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """A reference on the controller's grid of 1 ms.

    Attributes:
        asked: (n,) position asked for [m].
        measured: (n,) position measured [m]; that asked for where nothing was measured.
        digest: hex digest of the file.
    """

    asked: FloatArray
    measured: FloatArray
    digest: str

    @property
    def length(self) -> float:
        """From the first to the last sample [s]."""
        return (self.asked.size - 1) / RATE

    def part(self, start: float, ticks: int) -> tuple[FloatArray, int, tuple[float, float]]:
        """Return the reference from a moment on, with what runs before it.

        Args:
            start: [s] from the beginning of the record.
            ticks: samples wanted from there on.

        Returns:
            (lead + ticks,) positions asked for [m]; lead, the samples before ``start``; and
            the position [m] and speed [m/s] that were measured at the first of them all.
        """
        first = round(start * RATE)
        lead = min(first, round(LEAD_IN * RATE))
        begin = first - lead
        here = self.measured[begin : begin + _SETTLED]
        speed = float(np.polyfit(np.arange(here.size) / RATE, here, 1)[0])
        return self.asked[begin : first + ticks], lead, (float(here[0]), speed)


@cache
def read_recorded(path: str) -> Recorded:
    """Read a MATLAB file of the EMPS data set.

    Raises:
        UsageError: it cannot be read, lacks a variable, or is not sampled at 1 kHz.
    """
    from scipy.io import loadmat  # here: listing backends needs no scipy

    try:
        content = Path(path).read_bytes()
        names = loadmat(path, variable_names=("t", "qg", "qm"))
    except OSError as error:
        raise UsageError(f"cannot read the reference {path}: {error.strerror or error}") from None
    except Exception as error:  # loadmat raises whatever its parser trips over
        raise UsageError(f"the reference {path} is no MATLAB file: {error}") from None
    arrays = {
        name: np.ravel(value).astype(np.float64) for name, value in names.items() if not name.startswith("__")
    }
    for name in ("t", "qg"):
        if name not in arrays:
            raise UsageError(
                f"the reference {path} has no variable {name!r}, only {one_of(arrays)}; "
                f"it needs t [s] and qg [m], as in DATA_EMPS.mat"
            )
    times, asked = arrays["t"], arrays["qg"]
    measured = arrays.get("qm", asked)
    if not times.size == asked.size == measured.size or times.size < RATE:
        raise UsageError(
            f"the reference {path} has {times.size} times, {asked.size} positions asked for and "
            f"{measured.size} measured; they must be as many, and a second or more"
        )
    steps = np.diff(times)
    if not np.allclose(steps, 1 / RATE, rtol=0, atol=0.01 / RATE):
        raise UsageError(
            f"the reference {path} is sampled every {1e3 * np.median(steps):.4g} ms; the controller runs at 1 ms"
        )
    if not (np.isfinite(asked).all() and np.isfinite(measured).all()):
        raise UsageError(f"the reference {path} holds values that are not finite numbers")
    return Recorded(asked, measured, hashlib.sha256(content).hexdigest())
