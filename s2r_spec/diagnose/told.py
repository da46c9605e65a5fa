"""Which effects are there, by what the equations of motion ask for.

The coordinates that they ask for (:mod:`s2r_spec.diagnose.asked`) are each of one effect, off by a few hundredths of
its typical size on a machine of another code, whatever the closed loop makes of the rest. The evidence is Gaussian:

    seen = Σ_k J_k c_k + e,   c_k ~ N(0, LARGE²) for lines k of its effects that are off, N(0, ALLOWED²) for all others

A law of one sign has that half of the prior; a line that only says how its effect acts is N(0, ALLOWED⁴) where there is
none. In e are an error that all coordinates share, a part FORM of each, ACROSS, and the simulator's variants. Seldom
one coordinate says nothing: a cause that the catalogue lacks pulls it, or one that it has where its law is another. An
effect of several parameters seldom has all of them off: all, and each alone, are as likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, product

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.asked import Asked, Curve
from s2r_spec.diagnose.evidence import ALLOWED, FORM, gained
from s2r_spec.diagnose.logs import logsumexp

FloatArray = NDArray[np.float64]

ERRORS = (0.03, 0.05, 0.08, 0.13, 0.2, 0.35, 0.6, 1.0)
"""What no effect explains of a coordinate may be any of these, all as likely before they are seen: a few hundredths on
twins, but of a machine whose laws nobody wrote down as much as a typical effect."""
ASTRAY = 0.003
"""How likely one of the coordinates says nothing."""
ANYWHERE = 2.0
"""Standard deviation of one that does."""
ACROSS = 0.3
"""Part of what an effect makes of others' coordinates that is not believed: it hangs on the rest of the machine."""


def log_evidence(asked: Asked, seen: FloatArray, sets: Sequence[Sequence[str]]) -> FloatArray:
    """Return (sets,) log evidence of (p,) mean coordinates, less nominal, up to one constant.

    Args:
        asked: the bank.
        seen: what a machine's equations ask for.
        sets: names of effects; a set with one that the bank does not have has none, −inf.
    """
    lines = _Lines.near(asked, seen)
    chosen: list[tuple[int, ...]] = []
    place: list[int] = []
    less: list[float] = []
    for number, members in enumerate(sets):
        able = [lines.ways.get(name, []) for name in members]
        for each in product(*able):
            chosen.append(tuple(chain(*each)))
            place.append(number)
            less.append(sum(np.log(len(of)) for of in able))
    known = np.diag((FORM * seen) ** 2 + lines.across) + asked.numerics.T @ asked.numerics
    p = len(seen)
    common = [known + error**2 * np.eye(p) for error in ERRORS]
    right = logsumexp([lines.spoken(seen, spread, chosen) for spread in common], axis=0)
    stray = [ANYWHERE**2 * np.diag(one) for one in np.eye(p)]
    wrong = logsumexp(
        [lines.spoken(seen, spread + one, chosen) for spread in common for one in stray], axis=0
    )
    logs = np.logaddexp(np.log1p(-ASTRAY) + right, np.log(ASTRAY / p) + wrong) - np.array(less)
    found = np.full(len(sets), -np.inf)
    np.logaddexp.at(found, np.array(place, dtype=np.intp), logs)
    return found


@dataclass(frozen=True)
class _Lines:
    """The bank's lines, straight between nominal and what is asked for.

    Attributes:
        rows: (K, p) what a unit of each does to the coordinates.
        usual: (K,) standard deviation of each where its effect is no cause.
        side: (K,) 1 or −1 where one can only be of that sign, else 0.
        ways: effect → which of its lines may be off together: all, or one that acts alone.
        across: (p,) variance of what effects make of the others' coordinates.
    """

    rows: FloatArray
    usual: FloatArray
    side: FloatArray
    ways: dict[str, list[tuple[int, ...]]]
    across: FloatArray

    @classmethod
    def near(cls, asked: Asked, seen: FloatArray) -> _Lines:
        curves = [*asked.curves, *asked.turns]
        rows = np.zeros((len(curves), len(seen)))
        for row, curve in zip(rows, curves, strict=True):
            if curve.line.base:
                row[:] = _turned(curve)
                continue
            own = asked.names.index(curve.line.name) if curve.line.name in asked.names else None
            row[:] = curve.secant(None if own is None else seen[own])
        base = np.array([bool(curve.line.base) for curve in curves])
        # How it acts matters as much as there is of it.
        usual = np.where(base, ALLOWED**2, ALLOWED)
        return cls(
            rows,
            usual,
            np.array([_side(curve) for curve in curves]),
            _ways(curves),
            ACROSS**2 * asked.across(seen),
        )

    def spoken(self, seen: FloatArray, spread: FloatArray, chosen: Sequence[tuple[int, ...]]) -> FloatArray:
        """Return (chosen,) log evidence, if ``chosen`` lines are large; ``spread`` (p, p) is of what is left."""
        weigh = np.linalg.inv(spread)
        toward = self.rows @ weigh @ seen
        inner = self.rows @ weigh @ self.rows.T + np.diag(self.usual**-2.0)
        covariance: FloatArray = np.asarray(np.linalg.inv(inner), dtype=np.float64)
        mean = covariance @ toward
        volume = (
            np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(spread)[1] - 2.0 * np.log(self.usual).sum()
        )
        little = 0.5 * float(mean @ toward - seen @ weigh @ seen + volume)
        return little + gained(covariance, mean, self.usual, self.side, chosen)


def _ways(lines: Sequence[Curve]) -> dict[str, list[tuple[int, ...]]]:
    """Return effect → which of its lines may be off together: all, or one that acts alone."""
    of: dict[str, list[int]] = {}
    for place, curve in enumerate(lines):
        of.setdefault(curve.line.effect, []).append(place)
    return {
        effect: [tuple(mine), *((k,) for k in mine if len(mine) > 1 and not lines[k].line.base)]
        for effect, mine in of.items()
    }


def _side(curve: Curve) -> float:
    """Return 1 or −1 where a coordinate can only be of that sign, else 0."""
    if curve.line.base or curve.at[0] < 0.0 < curve.at[-1]:
        return 0.0
    return 1.0 if curve.at[-1] > 0.0 else -1.0


def _turned(curve: Curve) -> FloatArray:
    """Return (p,) change per unit of a line that only says how its effect acts, with that at its typical size."""
    low, high = max(float(curve.at[0]), -1.0), min(float(curve.at[-1]), 1.0)
    return np.asarray((curve(high) - curve(low)) / max(high - low, 1e-9))
