"""Sizes of all effects with intervals, and which of them are named, possible, ruled out or hidden.

Data: the likelihood of θ (K,) with information L, and the posterior over sets of parameters and over sizes
(:mod:`.model_search`). Estimators, over all sets with their probabilities:

    value and interval: the 5 %, 50 % and 95 % quantiles of θ_k
    probability of an effect: P(one of its parameters that act alone has |θ_k| ≥ 0.25); presence: the same with 0.125
    half-width: 1.645 √ diag (L + 1/σ_slab²)⁻¹, what the data alone say of θ_k, with all other sizes free
    tuned: E θ, the posterior mean of every parameter

An effect of at least 0.25 is to be named, one below 0.125 must not be. So an effect is *named* if its presence is at
least 0.95 and its probability at least 0.5. It is *possible* from a probability of 0.05 on, else *ruled out*, or
*hidden* if each of its parameters that act alone has a half-width above a quarter: the prior alone speaks against it.

Units: sizes in typical sizes, values in the parameter's unit. Shapes: K parameters, S sets.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_values import Shown
from s2r_spec.diagnose.inference.hierarchical import Likelihood
from s2r_spec.diagnose.inference.model_search import ModelPosterior
from s2r_spec.diagnose.inference.prior import LIKELY, NAMED, POSSIBLE, SLAB, SURE, UNNAMED
from s2r_spec.diagnose.simulator.axes import EffectAxis

INTERVAL = (0.05, 0.5, 0.95)
"""Definition: quantiles of an estimate: lower end, value and upper end of a 90 % interval."""
COVER = 1.645
"""Definition: standard deviations to either end of a 90 % interval of a normal distribution."""


class Status(Enum):
    """Whether an effect is there, by its size."""

    NAMED = "named"
    POSSIBLE = "possible"
    RULED_OUT = "ruled out"
    HIDDEN = "hidden"


@dataclass(frozen=True)
class ParameterEstimate(Shown):
    """A parameter of an effect.

    Attributes:
        parameter: name.
        estimate: the posterior median, in the unit.
        low: the lower end of the 90 % interval.
        high: the upper end of the 90 % interval.
        unit: the unit of the estimate and the interval.
        size: the estimate in typical sizes; a typical size is twice the standard deviation of the parameter's prior.
        size_low: the lower end in typical sizes.
        size_high: the upper end in typical sizes.
        half_width: half-width of the interval by the data alone, with all other sizes free, in typical sizes.
        at_end: whether the data ask for an end of the range, beyond which nothing was simulated.
        dependent: whether it acts only beside another parameter, and only says how the effect acts.
    """

    parameter: str
    unit: str
    value: float
    low: float
    high: float
    size: float
    size_low: float
    size_high: float
    half_width: float
    at_end: bool = False
    dependent: bool = False

    JSON = "estimate=value unit low high size size_low size_high half_width at_end dependent"

    @property
    def hidden(self) -> bool:
        """Whether the data alone do not measure it to a quarter of typical."""
        return self.half_width > NAMED


@dataclass(frozen=True)
class EffectEstimate:
    """An effect of the catalogue.

    Attributes:
        effect: name.
        family: of the effect.
        probability: that it is at least a quarter of typical.
        presence: probability that it is at least an eighth of typical.
        parameters: in the order of the catalogue.
    """

    effect: str
    family: str
    probability: float
    presence: float
    parameters: tuple[ParameterEstimate, ...]

    @property
    def status(self) -> Status:
        """Whether it is named, possible, ruled out or hidden."""
        if self.presence >= SURE and self.probability >= LIKELY:
            return Status.NAMED
        if self.probability >= POSSIBLE:
            return Status.POSSIBLE
        return Status.HIDDEN if all(one.hidden for one in self.causes) else Status.RULED_OUT

    @property
    def causes(self) -> tuple[ParameterEstimate, ...]:
        """The parameters that act alone."""
        return tuple(one for one in self.parameters if not one.dependent)

    @property
    def largest(self) -> ParameterEstimate:
        """The parameter with the largest size, of those that act alone."""
        return max(self.causes, key=lambda one: abs(one.size))

    @property
    def values(self) -> dict[str, float]:
        """The value of every parameter."""
        return {one.parameter: one.value for one in self.parameters}


def effect_estimates(
    posterior: ModelPosterior,
    likelihood: Likelihood,
    parameters: Sequence[EffectAxis],
    families: Mapping[str, str],
) -> tuple[EffectEstimate, ...]:
    """Return the estimate of every effect, in the order of the catalogue; ``families`` is effect → family."""
    low, middle, high = (posterior.quantile(level) for level in INTERVAL)
    width = COVER * np.sqrt(np.diag(np.linalg.inv(likelihood.information + np.eye(len(middle)) / SLAB**2)))
    # The posterior is truncated to the range. Its mean before that says whether the data ask for more.
    ends = np.array([posterior.prior.low, posterior.prior.high])
    at_end = (posterior.mean[0] / np.where(np.abs(ends) > 1e-9, ends, np.nan) >= 1.0).any(axis=0)
    rows: dict[str, list[ParameterEstimate]] = {}
    for axis, size, below, above, half, end in zip(
        parameters, *(x.tolist() for x in (middle, low, high, width, at_end)), strict=True
    ):
        value, least, most = axis.interval(size, below, above)
        one = ParameterEstimate(
            axis.parameter, axis.unit, value, least, most, size, below, above, half, end, bool(axis.base)
        )
        rows.setdefault(axis.effect, []).append(one)
    probabilities, presences = (posterior.beyond(size).tolist() for size in (NAMED, UNNAMED))
    return tuple(
        EffectEstimate(effect, families.get(effect, ""), p, presence, tuple(own))
        for (effect, own), p, presence in zip(rows.items(), probabilities, presences, strict=True)
    )


def further_causes(posterior: ModelPosterior, effects: Sequence[EffectEstimate]) -> tuple[str, ...]:
    """Return the possible effects if, more likely than not, one without a name is at least a quarter of typical."""
    named = np.array([one.status is Status.NAMED for one in effects])
    effect = posterior.prior.effect
    together = replace(posterior.prior, effect=np.where(named[effect], effect + 1, 0))
    if float(replace(posterior, prior=together).beyond()[0]) < LIKELY:
        return ()
    return tuple(one.effect for one in with_status(effects, Status.POSSIBLE))


def mean_sizes(posterior: ModelPosterior) -> FloatArray:
    """Return (K,) the posterior mean of every size, each truncated to its range."""
    from scipy.special import ndtr

    low, high = posterior.ends
    ends = [(end - posterior.mean) / posterior.deviation for end in (low, high)]
    density = [np.exp(-0.5 * np.minimum(end**2, 1e3)) / np.sqrt(2.0 * np.pi) for end in ends]
    mass = np.maximum(ndtr(ends[1]) - ndtr(ends[0]), 1e-12)
    mean = posterior.mean + posterior.deviation * (density[0] - density[1]) / mass
    return np.asarray(posterior.probability @ np.clip(mean, low, high))


def by_effects(
    posterior: ModelPosterior, parameters: Sequence[EffectAxis]
) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Return sets of effects with their probabilities, most probable first; sets of parameters are summed."""
    total: dict[tuple[str, ...], float] = {}
    for members, p in zip(posterior.sets, posterior.probability.tolist(), strict=True):
        names = tuple(dict.fromkeys(parameters[k].effect for k in members))
        total[names] = total.get(names, 0.0) + p
    return tuple(sorted(total.items(), key=lambda item: -item[1]))


def with_status(effects: Iterable[EffectEstimate], status: Status) -> tuple[EffectEstimate, ...]:
    """Return the effects of one status, most probable first."""
    return tuple(sorted((e for e in effects if e.status is status), key=lambda e: -e.probability))


def hidden_names(effects: Iterable[EffectEstimate]) -> tuple[str, ...]:
    """Return the effects, or some of their parameters, that the data alone do not measure to a quarter of typical."""
    return tuple(
        name
        for one in effects
        for name in (
            [one.effect]
            if all(each.hidden for each in one.causes)
            else [f"{one.effect}.{each.parameter}" for each in one.parameters if each.hidden]
        )
    )
