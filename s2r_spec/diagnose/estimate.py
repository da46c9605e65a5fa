"""How large the named effects are, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.evidence import FORM, Linear, posterior

FloatArray = NDArray[np.float64]

COVER = 1.645
"""Standard deviations to either end of a 90 % interval."""
SEEN = 0.5
"""A further parameter of an effect is named from so many standard deviations off nominal on."""
AT_END = 1e-3
"""A value that is nearer to an end of its range, in parts of the way there from nominal, stands at it."""


@dataclass(frozen=True)
class Estimate:
    """A parameter of a named effect.

    Attributes:
        effect: name.
        parameter: name.
        value: estimate, in ``unit``.
        low: of the 90 % interval.
        high: of the 90 % interval.
        unit: of the three.
        at_end: whether the value stands at an end of its range, past which nothing was tried; no value that only says
            how an effect acts does.
    """

    effect: str
    parameter: str
    value: float
    low: float
    high: float
    unit: str
    at_end: bool = False


@dataclass(frozen=True)
class Fit:
    """The best values of a set of effects.

    Attributes:
        estimates: one a parameter that is off nominal.
        values: what :meth:`HasEffects.with_effects` takes.
    """

    estimates: tuple[Estimate, ...]
    values: dict[str, dict[str, float]]


@dataclass(frozen=True)
class Sized:
    """Where a set of effects fits best.

    Attributes:
        at: (K,) coordinates.
        deviation: (K,) standard deviations of them.
        ends: line that only says how an effect acts → between which coordinates it may be, where that was looked for:
            of a phase linear data know one valley.
        free: (K,) coordinates of the fit in which others take what they can, where ``at`` is not it.
    """

    at: FloatArray
    deviation: FloatArray
    ends: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    free: FloatArray | None = None

    @property
    def tuned(self) -> FloatArray:
        """Return (K,) coordinates that close most of a gap: whatever takes the part of what the catalogue lacks."""
        return self.at if self.free is None else self.free


def by_linear(data: Linear, chosen: Sequence[int], temperature: float) -> Sized:
    """Return how large the linear data say that these effects are, all others being background.

    Intervals are as much wider as evidence is divided by before it is believed: by the root of the temperature.
    """
    mean, covariance = posterior(data, chosen)
    return Sized(data.around + mean, np.sqrt(np.diag(covariance) * max(temperature, 1.0)))


def fit(catalogue: Catalogue, chosen: Sequence[int], sized: Sized) -> Fit:
    """Return the values of these effects, with intervals.

    However well a value fits, it is that of our law: the machine's is another by a part FORM of it.
    """
    at = np.clip(sized.at, catalogue.lower, catalogue.upper)
    spread = COVER * np.hypot(sized.deviation, np.where(catalogue.based, 0.0, FORM * at))
    estimates = []
    for k, curve in enumerate(catalogue.curves):
        line = curve.line
        if catalogue.owner[k] not in chosen:
            continue
        if catalogue.first[k] != k and not catalogue.based[k] and abs(at[k]) < SEEN * spread[k]:
            at[k] = 0.0
            continue
        least, most = sized.ends.get(k, (at[k], at[k]))
        low, high = (
            line.value(float(np.clip(x, catalogue.lower[k], catalogue.upper[k])))
            for x in (min(at[k] - spread[k], least), max(at[k] + spread[k], most))
        )
        end = catalogue.upper[k] if at[k] > 0 else catalogue.lower[k]
        at_end = bool(not catalogue.based[k] and end and abs(at[k] / end) > 1.0 - AT_END)
        estimates.append(
            Estimate(line.effect, line.parameter, line.value(float(at[k])), low, high, line.unit, at_end)
        )
    return Fit(tuple(estimates), catalogue.values(at, chosen))
