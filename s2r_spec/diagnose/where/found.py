"""Where the gap lies: in the test space, and, at its worst test, in time, channels and formula."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from s2r_spec.diagnose.where.attribution import Attribution, attribute
from s2r_spec.diagnose.where.gaps import GapAt
from s2r_spec.diagnose.where.space import InSpace, in_space
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

WINDOWS = 6
"""Equal windows of time over which Δρ is summed."""


@dataclass(frozen=True, eq=False)
class Where:
    """Where the gap lies.

    Attributes:
        space: over the test space; None where the spec sweeps no parameter, or more than four.
        test: the test with the largest mean gap, of those that were run.
        pair: Δρ of a real and a simulated rollout there, taken apart.
    """

    space: InSpace | None
    test: Mapping[str, float]
    pair: Attribution

    def windows(self) -> list[dict[str, float]]:
        """Return begin, end [s] and share of Δρ of equal windows of time."""
        edges = np.linspace(self.pair.times[0], self.pair.times[-1], WINDOWS + 1)
        place = np.clip(np.searchsorted(edges, self.pair.times, side="right") - 1, 0, WINDOWS - 1)
        sums = np.bincount(place, weights=self.pair.over_time, minlength=WINDOWS)
        return [
            {"begin": float(low), "end": float(high), "delta": float(amount)}
            for low, high, amount in zip(edges[:-1], edges[1:], sums, strict=True)
        ]

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        apart = self.pair.to_json()
        return {
            "space": None if self.space is None else self.space.to_json(),
            "test": dict(self.test),
            "delta": apart["delta"],
            "time": self.windows(),
            "formula": apart["parts"],
            "channels": apart["channels"],
            "ended": apart["ended"],
            "switch": apart["switch"],
        }


def where(
    spec: Spec,
    requirement: str,
    tests: Sequence[Mapping[str, float]],
    real: Sequence[tuple[Trace, float]],
    simulated: Sequence[tuple[Trace, float]],
    seed: int = 0,
) -> Where:
    """Return where the gap lies.

    Args:
        spec: the specification.
        requirement: one of its requirements.
        tests: n of them, some alike.
        real: (trace, ρ) of the real rollout of each.
        simulated: the same of a simulated one.
        seed: of what is sampled.
    """
    places: dict[tuple[tuple[str, float], ...], list[int]] = {}
    for i, test in enumerate(tests):
        places.setdefault(tuple(sorted(test.items())), []).append(i)
    gaps = tuple(
        GapAt(dict(key), np.array([real[i][1] for i in mine]), np.array([simulated[i][1] for i in mine]))
        for key, mine in places.items()
    )
    space = (
        in_space(spec.space, gaps, spec.unit(requirement), seed=seed) if 1 <= spec.space.dim <= 4 else None
    )
    worst = max(gaps, key=lambda gap: abs(gap.signed))
    first = places[tuple(sorted(worst.params.items()))][0]
    pair = attribute(spec, requirement, real[first][0], simulated[first][0], dict(worst.params))
    return Where(space, dict(worst.params), pair)
