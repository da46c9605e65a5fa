"""Effects on what the feet stand on and move through."""

from __future__ import annotations

from math import exp, radians

from numpy.random import Generator

from benchmarks.blind.a1.effects.kind import Kind, Values, sign
from benchmarks.blind.a1.twin import Twin

_LOAD = 70.0
"""[N] on a standing foot, half the robot's weight."""
_SINKAGE = 0.85
"""Depth that a standing foot reaches, as a part of the catalogue's ``sink``; from ``a1_compare.py``."""
_CREEP = 0.0033
"""[s] in which shear under 10 N relaxes at a tenth of the catalogue's stiffness; likewise."""


def _slippery(twin: Twin, rng: Generator, values: Values) -> None:
    twin.world["mu"] *= values["factor"]


def _soft(twin: Twin, rng: Generator, values: Values) -> None:
    """Bekker's law under every foot, F = k z^1.2, in series with the rubber; soil comes back slowly."""
    if values["sink"] > 0.0:
        twin.world["soil_stiffness"] = _LOAD / (_SINKAGE * values["sink"]) ** 1.2


def _grass(twin: Twin, rng: Generator, values: Values) -> None:
    """A force that grows a little faster than speed, and fades out with height."""
    each = values["coefficient"] * (1.0 + 0.05 * rng.normal(size=4))
    twin.world["drag"] += 0.85 * each
    twin.world["drag_square"] += 0.12 * each


def _creep(twin: Twin, rng: Generator, values: Values) -> None:
    """A Maxwell element, a spring that forgets, and the sooner the more it is pulled."""
    if values["stiffness"] < 1.0:
        twin.world["creep_time"] = _CREEP * 9.0 / (1.0 / values["stiffness"] - 1.0)


def _tilt(twin: Twin, rng: Generator, values: Values) -> None:
    """Gravity leans; the ground stays where it is."""
    twin.world["slope"] += radians(values["angle"])


def _rough(twin: Twin, rng: Generator, values: Values) -> None:
    """A grid of heights with a rounded spectrum, new in every run."""
    twin.world["roughness"] += values["height"]


GROUND = (
    Kind("ground_friction", 1.3, 2.0, lambda rng, size: {"factor": exp(-size)}, _slippery),
    Kind("soft_ground", 0.003, 0.03, lambda rng, size: {"sink": size}, _soft),
    Kind("foot_drag", 1.5, 16.0, lambda rng, size: {"coefficient": size}, _grass),
    Kind("shear_creep", 1.3, 2.0, lambda rng, size: {"stiffness": 10.0**-size}, _creep),
    Kind("slope", 1.2, 5.0, lambda rng, size: {"angle": sign(rng) * size}, _tilt),
    Kind("roughness", 0.002, 0.01, lambda rng, size: {"height": size}, _rough),
)
