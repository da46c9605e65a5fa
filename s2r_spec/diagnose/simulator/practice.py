"""Practice machines: the simulator with random sizes, which show how well a sum of responses predicts a machine.

Units: coordinates are in typical sizes (:mod:`.axes`). Shapes: K parameters.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.prior import BACKGROUND
from s2r_spec.diagnose.simulator.axes import EffectAxis

MACHINES = 24
"""Budget: practice machines; the error of a sum of responses is then known to 15 %."""
CAUSES = 3
"""Definition: a practice machine has 0 to 3 causes, of a quarter of the typical size to all of it. More causes make
sums of responses look worse."""
SEED = 1_000
"""Definition: seed of all practice machines."""


def practice_machine(
    parameters: Sequence[EffectAxis], variants: Sequence[str], number: int
) -> tuple[FloatArray, str]:
    """Return (K,) coordinates and the variant of a practice machine: small amounts of all effects, and its causes."""
    theta, sizes, turn = (np.zeros(len(parameters)) for _ in range(3))
    for k, axis in enumerate(parameters):
        random = _stream(axis.name, number)
        low, high = axis.ends
        theta[k] = _small(axis, random)
        sign = 1.0 if low > -1e-9 or (high > 1e-9 and random.uniform() < 0.5) else -1.0
        sizes[k] = np.clip(sign * random.uniform(0.25, 1.0), low, high)
        turn[k] = np.inf if axis.base else random.uniform()
    random = _stream("", number)
    causes = np.argsort(turn)[: min(int(random.integers(CAUSES + 1)), int(np.isfinite(turn).sum()))]
    theta[causes] = sizes[causes]
    return theta, str(random.choice(["", *sorted(variants)]))


def healthy_machine(parameters: Sequence[EffectAxis], number: int) -> FloatArray:
    """Return (K,) coordinates of a machine without causes: small amounts of all effects."""
    return np.array([_small(axis, _stream(axis.name, number)) for axis in parameters])


def _stream(name: str, number: int) -> np.random.Generator:
    """Return the random numbers of a parameter. Each has a stream of its own, so that their order changes nothing."""
    return np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(number, zlib.crc32(name.encode()))))


def _small(axis: EffectAxis, random: np.random.Generator) -> float:
    low, high = axis.ends
    if axis.is_phase:
        return float(random.uniform(low, high))
    # A dependent parameter may have any value: where a load lies is no sign of its mass.
    return float(np.clip((1.0 if axis.base else BACKGROUND) * random.normal(), low, high))
