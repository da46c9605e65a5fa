"""How large the named effects are, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.catalogue import Catalogue
from s2r_spec.diagnose.evidence import Linear, posterior

FloatArray = NDArray[np.float64]

COVER = 1.645
"""Standard deviations to either end of a 90 % interval."""
SEEN = 0.5
"""A further parameter of an effect is named from so many standard deviations off nominal on."""


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
    """

    effect: str
    parameter: str
    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Fit:
    """The best values of a set of effects.

    Attributes:
        estimates: one a parameter that is off nominal.
        values: what :meth:`HasEffects.with_effects` takes.
    """

    estimates: tuple[Estimate, ...]
    values: dict[str, dict[str, float]]


def fit(
    data: Linear,
    catalogue: Catalogue,
    chosen: Sequence[int],
    temperature: float,
    found: FloatArray | None = None,
    ends: Mapping[int, tuple[float, float]] | None = None,
) -> Fit:
    """Return the values of these effects, all others being background.

    Args:
        data: linear around the joint fit.
        catalogue: of the same lines.
        chosen: places of effects.
        temperature: by which evidence is divided before it is believed; intervals are so much wider.
        found: (K,) coordinates at which the simulator with these effects alone fits best, where that
            was looked for; else those of the linear data.
        ends: line → coordinates between which it may be, where that was looked for: of a phase the linear data know
            one valley.
    """
    mean, covariance = posterior(data, chosen)
    at = np.clip(data.around + mean if found is None else found, catalogue.lower, catalogue.upper)
    spread = COVER * np.sqrt(np.diag(covariance) * max(temperature, 1.0))
    estimates = []
    for k, curve in enumerate(catalogue.curves):
        line = curve.line
        if catalogue.owner[k] not in chosen:
            continue
        if catalogue.first[k] != k and not catalogue.based[k] and abs(at[k]) < SEEN * spread[k]:
            at[k] = 0.0
            continue
        least, most = (ends or {}).get(k, (at[k], at[k]))
        low, high = (
            line.value(float(np.clip(x, catalogue.lower[k], catalogue.upper[k])))
            for x in (min(at[k] - spread[k], least), max(at[k] + spread[k], most))
        )
        estimates.append(
            Estimate(line.effect, line.parameter, line.value(float(at[k])), low, high, line.unit)
        )
    return Fit(tuple(estimates), catalogue.values(at, chosen))
