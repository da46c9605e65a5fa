"""The likeliest sets of effects, each fitted by the simulator itself with a little of everything else beside it.

The linear evidence is exact at one point, that of the joint fit. A set that lies far from it
is judged by what the simulator does there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.diagnose.evidence import Evidence, Set, explained
from s2r_spec.diagnose.joint import Joint
from s2r_spec.diagnose.judge import Sets
from s2r_spec.diagnose.prepare import State

LIKELIEST = 5
"""Sets that are simulated at first."""
MOST = 9
"""Sets that are simulated at all: on, while one that was not is the likeliest."""


@dataclass(frozen=True)
class Together:
    """Sets, weighed again.

    Attributes:
        sets: all of them.
        fits: of those that were simulated.
    """

    sets: Sets
    fits: dict[Set, Joint]


def together(state: State, progress: Callable[[int, int], None]) -> Together:
    """Simulate the likeliest sets, and put what they cost in the place of what the linear evidence made of them."""
    found, sets = state.found, state.sets
    fits: dict[Set, Joint] = {}
    moved: dict[Set, float] = {}
    scale = max(state.fitted.misfit, 1.0)
    while len(fits) < MOST:
        ranked = [members for members, _ in sets.ranked()]
        if ranked[0] in fits and len(fits) >= LIKELIEST:
            break
        upcoming = ranked[0] if ranked[0] not in fits else next(s for s in ranked if s not in fits)
        fits[upcoming] = state.beside(upcoming)
        moved[upcoming] = -0.5 * (fits[upcoming].cost / scale - explained(state.data, upcoming))
        progress(len(fits), MOST)
        # What was not simulated is taken to err as the others did.
        usual = float(np.mean(list(moved.values())))
        logs = found.logs + np.array([moved.get(members, usual) for members in found.members])
        sets = state.judge.sets(_with(found, logs), state.memberships)
    return Together(sets, fits)


def _with(found: Evidence, logs: np.ndarray) -> Evidence:
    return replace(found, logs=logs)
