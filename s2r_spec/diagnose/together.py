"""The likeliest sets of effects, each simulated as a whole, for simulators too dear to differentiate.

There the joint fit has to do with the bank's derivatives, which know each effect
by itself. A few sets can still be fitted alone, by the simulator, and what each
leaves of the data says more than the linear evidence does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.evidence import Set
from s2r_spec.diagnose.judge import Sets
from s2r_spec.diagnose.prepare import State

FloatArray = NDArray[np.float64]

LIKELIEST = 3
"""Sets that are simulated at first."""
FURTHER = 2
"""Effects that are then tried with the best of them."""
MOST = 3
"""Effects in a set."""
LEAST = 0.02
"""Least prior probability of a set that is tried."""
TEMPERATURE = 10.0
"""By which a difference of log likelihoods is divided before it is believed: the laws are not ours."""


@dataclass(frozen=True)
class Together:
    """Sets, weighed again.

    Attributes:
        sets: all of them.
        at: set → (K,) coordinates, of those that were simulated.
    """

    sets: Sets
    at: dict[Set, FloatArray]


def together(state: State, progress: Callable[[int, int], None]) -> Together:
    """Simulate the likeliest sets, and the best of them with one effect more, and weigh them by what they leave."""
    prior = dict(state.sets.ranked())
    tried: dict[Set, tuple[FloatArray, float]] = {}

    def look(members: Set) -> None:
        if members not in tried:
            tried[members] = state.alone(members)
            progress(len(tried), LIKELIEST + FURTHER * (MOST - 1))

    for members in [s for s, _ in state.sets.ranked() if s][:LIKELIEST]:
        look(members)
    best = max(tried, key=lambda s: _score(s, tried, prior, state))
    while len(best) < MOST:
        open_ = [int(k) for k in np.argsort(-state.memberships) if k not in best][:FURTHER]
        for k in open_:
            look(tuple(sorted((*best, k))))
        wider = max(tried, key=lambda s: _score(s, tried, prior, state))
        if len(wider) <= len(best):
            break
        best = wider
    scores = np.array([_score(s, tried, prior, state) for s in tried])
    share = np.exp(scores - scores.max())
    moved = max(sum(prior.get(s, 0.0) for s in tried), LEAST)
    rest = {s: q for s, q in prior.items() if s not in tried}
    scale = (1.0 - moved) / max(sum(rest.values()), 1e-12)
    merged = {s: q * scale for s, q in rest.items()}
    merged |= {s: moved * float(v) for s, v in zip(tried, share / share.sum(), strict=True)}
    every = tuple(merged)
    return Together(
        Sets(every, np.array([merged[s] for s in every])), {s: at for s, (at, _) in tried.items()}
    )


def _score(
    members: Set, tried: dict[Set, tuple[FloatArray, float]], prior: dict[Set, float], state: State
) -> float:
    """Return the log weight of a set that was tried, up to one constant."""
    least = max(min(misfit for _, misfit in tried.values()), 1.0)
    likelihood = -0.5 * state.coefficients.size * tried[members][1] / least
    return float(np.log(max(prior.get(members, 0.0), LEAST)) + likelihood / TEMPERATURE)
