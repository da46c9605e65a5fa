"""The lines of a bank as one vector of coordinates: who owns each, how far it goes, and what values it stands for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.signatures import Curve

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Catalogue:
    """The lines of a bank, as the fit sees them.

    Attributes:
        curves: one a line.
        effects: names.
        owner: (K,) place of each line's effect.
        first: (K,) place of the first line of its effect.
        based: (K,) which lines only say how another of the same effect acts.
        lower: (K,) ends of the coordinates.
        upper: (K,)
        side: (K,) 1 or −1 where a coordinate can only be of that sign, else 0.
    """

    curves: tuple[Curve, ...]
    effects: tuple[str, ...]
    owner: NDArray[np.intp]
    first: NDArray[np.intp]
    based: NDArray[np.bool_]
    lower: FloatArray
    upper: FloatArray
    side: NDArray[np.intp]

    @classmethod
    def of(cls, curves: Sequence[Curve]) -> Catalogue:
        """Collect what the lines say of themselves."""
        names = [c.line.effect for c in curves]
        effects = tuple(dict.fromkeys(names))
        based = np.array([bool(c.line.base) for c in curves])
        lower = np.array([min(0.0, float(c.coordinates.min())) for c in curves])
        upper = np.array([max(0.0, float(c.coordinates.max())) for c in curves])
        side = np.where(lower >= 0, 1, np.where(upper <= 0, -1, 0))
        return cls(
            tuple(curves),
            effects,
            np.array([effects.index(n) for n in names]),
            np.array([names.index(n) for n in names]),
            based,
            lower,
            upper,
            np.where(based, 0, side),
        )

    def values(self, at: FloatArray, only: Sequence[int] | None = None) -> dict[str, dict[str, float]]:
        """Return what :meth:`HasEffects.with_effects` takes, of all effects or of ``only`` these places."""
        out: dict[str, dict[str, float]] = {}
        for k, curve in enumerate(self.curves):
            line = curve.line
            if not self.based[k] and abs(at[k]) > 1e-4 and (only is None or self.owner[k] in only):
                out.setdefault(line.effect, {})[line.parameter] = line.value(float(at[k]))
        for k, curve in enumerate(self.curves):
            if self.based[k] and curve.line.effect in out:
                out[curve.line.effect][curve.line.parameter] = curve.line.value(float(at[k]))
        return out
