"""Effects of one kind: a law of another order makes either look like the other, however clear the data are.

A rotor whose lag is of second order is fitted better by a delay than by a lag of first order, and no amount of data
changes that: what is wrong is neither the data nor the size, but the law. So where the evidence sees one of two effects
of a kind (:attr:`s2r_spec.diagnose.isolability.Isolability.kin`), it may be either.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.evidence import Set
from s2r_spec.diagnose.judge import Sets

FloatArray = NDArray[np.float64]

OTHER = 0.4
"""Probability that what looks like one effect is the other of its kind: nearly one half, however clear the evidence is
(``benchmarks/blind/kin.py``)."""


def shared(sets: Sets, kin: FloatArray) -> Sets:
    """Return the sets with their probability shared among those of the same kind, which may be further ones.

    Args:
        sets: as the evidence sees them.
        kin: (K, K) from 0 (of two kinds) to 1 (of one).
    """
    found = dict.fromkeys(sets.members, 0.0)
    for members, seen in zip(sets.members, sets.probability.tolist(), strict=True):
        others = [(other, OTHER * alike) for other, alike in _others(members, kin)]
        whole = 1.0 - OTHER + sum(part for _, part in others)
        for other, part in [(members, 1.0 - OTHER), *others]:
            found[other] = found.get(other, 0.0) + seen * part / whole
    return Sets(tuple(found), np.array(list(found.values())))


def _others(members: Set, kin: FloatArray) -> Iterator[tuple[Set, float]]:
    """Yield the sets that this one may be, and how much of one kind they are with it.

    Two of a kind may be one of them, whose law lies between.
    """
    for a in members:
        rest = tuple(k for k in members if k != a)
        for b in np.flatnonzero(kin[a]).tolist():
            yield (rest if b in members else tuple(sorted((*rest, b)))), float(kin[a, b])
