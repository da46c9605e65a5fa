"""Sizes of all effects with intervals, and which of them are named, possible or ruled out.

Data: the posterior over sets of parameters and over sizes (:mod:`.model_search`). Unknown: θ (K,). Estimators, over
all sets with their probabilities:

    value and interval: the 5 %, 50 % and 95 % quantiles of θ_k
    probability of an effect: P(any of its parameters has |θ_k| ≥ 0.25 typical)
    tuned: E θ, the posterior mean of every parameter

An effect is *named* if its probability is at least 0.95, *possible* from 0.05 on, else *ruled out*
(:mod:`.prior`). Every effect gets an entry.

Units: sizes in typical sizes, values in the parameter's unit. Shapes: K parameters, S sets.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from s2r_spec.diagnose.axes import Line
from s2r_spec.diagnose.inference.model_search import ModelPosterior
from s2r_spec.diagnose.inference.prior import POSSIBLE, SURE

FloatArray = NDArray[np.float64]

INTERVAL = (0.05, 0.5, 0.95)
"""Definition: quantiles of an estimate: lower end, value and upper end of a 90 % interval."""


class Status(Enum):
    """Whether an effect is there, by its size."""

    NAMED = "named"
    POSSIBLE = "possible"
    RULED_OUT = "ruled out"

    @classmethod
    def of(cls, probability: float) -> Status:
        """Return the status of an effect that is at least a quarter of typical with this probability."""
        return (
            cls.NAMED if probability >= SURE else cls.POSSIBLE if probability >= POSSIBLE else cls.RULED_OUT
        )


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter of an effect.

    Attributes:
        parameter: name.
        unit: of the next three.
        value: posterior median.
        low: lower end of the 90 % interval.
        high: upper end.
        size: the median in typical sizes.
        size_low: lower end of the interval in typical sizes.
        size_high: upper end.
        at_end: whether the data ask for an end of the range, beyond which nothing was simulated.
    """

    parameter: str
    unit: str
    value: float
    low: float
    high: float
    size: float
    size_low: float
    size_high: float
    at_end: bool = False


@dataclass(frozen=True)
class EffectEstimate:
    """An effect of the catalogue.

    Attributes:
        effect: name.
        family: of the effect.
        probability: that it is at least a quarter of typical.
        parameters: in the order of the catalogue.
    """

    effect: str
    family: str
    probability: float
    parameters: tuple[ParameterEstimate, ...]

    @property
    def status(self) -> Status:
        """Whether it is named, possible or ruled out."""
        return Status.of(self.probability)

    @property
    def largest(self) -> ParameterEstimate:
        """The parameter with the largest size."""
        return max(self.parameters, key=lambda one: abs(one.size))

    @property
    def values(self) -> dict[str, float]:
        """The value of every parameter."""
        return {one.parameter: one.value for one in self.parameters}


def effect_estimates(
    found: ModelPosterior, parameters: Sequence[Line], families: dict[str, str]
) -> tuple[EffectEstimate, ...]:
    """Return the estimate of every effect, in the order of the catalogue.

    Args:
        found: the posterior.
        parameters: of the catalogue, as in the posterior.
        families: effect → family.
    """
    low, middle, high = (found.quantile(level).tolist() for level in INTERVAL)
    # The posterior is truncated to the range. Its mean before that says whether the data ask for more.
    most, ends = found.mean[0], (found.prior.low, found.prior.high)
    at_end = [any(end[k] and most[k] / end[k] >= 1.0 for end in ends) for k in range(len(parameters))]
    rows: dict[str, list[ParameterEstimate]] = {}
    for k, line in enumerate(parameters):
        sizes = low[k], middle[k], high[k]
        below, value, above = map(line.value, sizes)
        one = ParameterEstimate(
            line.parameter, line.unit, value, below, above, sizes[1], sizes[0], sizes[2], bool(at_end[k])
        )
        rows.setdefault(line.effect, []).append(one)
    probabilities = found.beyond().tolist()
    return tuple(
        EffectEstimate(effect, families.get(effect, ""), p, tuple(own))
        for (effect, own), p in zip(rows.items(), probabilities, strict=True)
    )


def any_cause(found: ModelPosterior) -> float:
    """Return the probability that some effect is at least a quarter of typical."""
    together = replace(found.prior, effect=np.zeros_like(found.prior.effect))
    return float(replace(found, prior=together).beyond()[0])


def mean_sizes(found: ModelPosterior) -> FloatArray:
    """Return (K,) the posterior mean of every size, each truncated to its range."""
    from scipy.special import ndtr

    ends = [(end - found.mean) / found.deviation for end in (found.prior.low, found.prior.high)]
    density = [np.exp(-0.5 * np.minimum(end**2, 1e3)) / np.sqrt(2.0 * np.pi) for end in ends]
    mass = np.maximum(ndtr(ends[1]) - ndtr(ends[0]), 1e-12)
    mean = found.mean + found.deviation * (density[0] - density[1]) / mass
    return np.asarray(found.probability @ np.clip(mean, found.prior.low, found.prior.high))


def by_effects(
    found: ModelPosterior, parameters: Sequence[Line]
) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Return sets of effects with their probabilities, most probable first; sets of parameters are summed."""
    total: dict[tuple[str, ...], float] = {}
    for members, p in zip(found.sets, found.probability.tolist(), strict=True):
        names = tuple(dict.fromkeys(parameters[k].effect for k in members))
        total[names] = total.get(names, 0.0) + p
    return tuple(sorted(total.items(), key=lambda item: -item[1]))


def with_status(effects: Iterable[EffectEstimate], status: Status) -> tuple[EffectEstimate, ...]:
    """Return the effects of one status, most probable first."""
    return tuple(sorted((e for e in effects if e.status is status), key=lambda e: -e.probability))
