"""The likeliest sets of effects, each fitted by the simulator itself with a little of everything else beside it.

The linear evidence is exact at one point, that of the joint fit. A set that lies far from it
is judged by what the simulator does there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.evidence import Set, explained
from s2r_spec.diagnose.joint import Joint
from s2r_spec.diagnose.judge import Sets
from s2r_spec.diagnose.prepare import State

FloatArray = NDArray[np.float64]

LIKELIEST = 5
"""Sets that are simulated at first."""
MOST = 9
"""Sets that are simulated at all: on, while one that was not is the likeliest."""

HEARD = 2.0
"""A look moves a set's log probability by at most so much against the others."""


@dataclass(frozen=True)
class Together:
    """Sets, weighed again.

    Attributes:
        sets: all of them.
        logs: log evidence of each, up to one constant.
        fits: of those that were simulated.
    """

    sets: Sets
    logs: FloatArray
    fits: dict[Set, Joint]


def together(state: State, progress: Callable[[int, int], None]) -> Together:
    """Simulate the likeliest sets, and put what they cost in the place of what the linear evidence made of them."""
    found, sets = state.found, state.sets
    fits: dict[Set, Joint] = {}
    moved: dict[Set, float] = {}
    while len(fits) < MOST:
        ranked = [members for members, _ in sets.ranked()]
        if ranked[0] in fits and len(fits) >= LIKELIEST:
            break
        upcoming = ranked[0] if ranked[0] not in fits else next(s for s in ranked if s not in fits)
        fits[upcoming] = state.beside(upcoming)
        moved[upcoming] = -0.5 * (fits[upcoming].cost / state.data.scale - explained(state.data, upcoming))
        progress(len(fits), MOST)
        # What was not simulated is taken to err as the others did; and a fit may have stopped in a wrong valley.
        usual = float(np.median(list(moved.values())))
        far = np.array([moved.get(members, usual) for members in found.members]) - usual
        logs = found.logs + np.clip(far, -HEARD * state.temperature, HEARD * state.temperature)
        sets = state.judge.sets(replace(found, logs=logs), state.memberships, state.temperature)
    return Together(sets, logs, fits)
