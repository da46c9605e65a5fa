"""A recorded reference from the EMPS data set, which a rollout can follow from any time on.

A file has ``t`` [s], the reference position ``qg`` [m] and optionally the measured position ``qm`` [m]. The data set is
at nonlinearbenchmark.org and is not part of this project.
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
"""Time of the record that runs before the requested part [s]: ten times the memory of the loop."""
_SETTLED = 10
"""Samples of the measured position from which the first speed is computed."""


@dataclass(frozen=True, eq=False)
class RecordedReference:
    """A reference on the controller's grid of 1 ms.

    Attributes:
        position: (n,) reference position [m].
        measured: (n,) measured position [m]; the reference if nothing was measured.
        digest: hex digest of the file.
    """

    position: FloatArray
    measured: FloatArray
    digest: str

    @property
    def length(self) -> float:
        """Time from the first to the last sample [s]."""
        return (self.position.size - 1) / RATE

    def part(self, start: float, ticks: int) -> tuple[FloatArray, int, tuple[float, float]]:
        """Return a part of the reference, with a lead-in before it.

        Args:
            start: time from the beginning of the record [s].
            ticks: number of samples from there on.

        Returns:
            (lead + ticks,) reference positions [m]; lead, the number of samples before ``start``; and the measured
            position [m] and speed [m/s] at the first of all these samples.
        """
        first = round(start * RATE)
        lead = min(first, round(LEAD_IN * RATE))
        begin = first - lead
        here = self.measured[begin : begin + _SETTLED]
        speed = float(np.polyfit(np.arange(here.size) / RATE, here, 1)[0])
        return self.position[begin : first + ticks], lead, (float(here[0]), speed)


@cache
def read_recorded(path: str) -> RecordedReference:
    """Read a MATLAB file of the EMPS data set.

    Raises:
        UsageError: the file cannot be read, lacks a variable, or is not sampled at 1 kHz.
    """
    from scipy.io import loadmat  # here, because a list of backends needs no scipy

    try:
        content = Path(path).read_bytes()
        names = loadmat(path, variable_names=("t", "qg", "qm"))
    except OSError as error:
        raise UsageError(f"cannot read the reference {path}: {error.strerror or error}") from None
    except Exception as error:  # loadmat raises many kinds of errors
        raise UsageError(f"the reference {path} is not a MATLAB file: {error}") from None
    arrays = {
        name: np.ravel(value).astype(np.float64) for name, value in names.items() if not name.startswith("__")
    }
    for name in ("t", "qg"):
        if name not in arrays:
            raise UsageError(
                f"the reference {path} has no variable {name!r}, only {one_of(arrays)}; "
                f"it needs t [s] and qg [m], as in DATA_EMPS.mat"
            )
    times, position = arrays["t"], arrays["qg"]
    measured = arrays.get("qm", position)
    if not times.size == position.size == measured.size or times.size < RATE:
        raise UsageError(
            f"the reference {path} has {times.size} values of t, {position.size} of qg and {measured.size} of qm; "
            f"it needs equally many, over one second or more"
        )
    steps = np.diff(times)
    if not np.allclose(steps, 1 / RATE, rtol=0, atol=0.01 / RATE):
        raise UsageError(
            f"the reference {path} is sampled every {1e3 * np.median(steps):.4g} ms; t must step by 1 ms, the "
            f"controller's period"
        )
    if not (np.isfinite(position).all() and np.isfinite(measured).all()):
        raise UsageError(f"the reference {path} has values of qg or qm that are not finite numbers")
    return RecordedReference(position, measured, hashlib.sha256(content).hexdigest())
