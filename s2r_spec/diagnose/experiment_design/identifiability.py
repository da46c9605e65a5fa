"""What one more run of each experiment would say about the effects that are possible.

Data: the likelihood of an estimate, with information L (K, K), and the response library. Unknown: how far the most
probable sets of effects differ in a further run. Model, linear and Gaussian around the estimate:

    ψ = θ + c,   c ~ N(0, S)        the error that all groups share; more runs do not lower it
    θ | A ~ N(0, P_A)               prior of the sizes given a set A
    data so far: information (L⁻¹ − S)⁻¹ about ψ;   a further run of experiment p: information B_p about ψ

B_p is that of `inference/hierarchical.py`, with the variances of all groups at their prior and every slope taken from
nominal to the size that a set has. Runs of the same experiment share its law errors: B_p is the information of n + 1
runs less that of n. Estimator:

    D²_ij = δᵀ B_p (1 + Σ B_p)⁻¹ δ,   δ = E(ψ | i) − E(ψ | j),   Σ = mean of both posterior covariances of ψ

A run *settles* a possible effect if it separates the most probable sets with and without it by at least 3 σ, and the
size is then surely below a quarter of typical, or surely above an eighth.

Units: θ, ψ in typical sizes, D in standard deviations per run. Shapes: K parameters, S sets.
Source: Atkinson, Donev & Tobias, *Optimum Experimental Designs* (2007), ch. 20.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.json_values import Shown
from s2r_spec.diagnose.estimation import Estimate
from s2r_spec.diagnose.inference.estimates import COVER
from s2r_spec.diagnose.inference.hierarchical import Variances, form_error
from s2r_spec.diagnose.inference.observation import Observation
from s2r_spec.diagnose.inference.prior import NAMED, UNNAMED
from s2r_spec.diagnose.simulator.axes import EffectAxis
from s2r_spec.diagnose.simulator.experiments import Experiment

APART = 3.0
"""Level: standard deviations from which on two sets are told apart. Higher, more pairs are called inseparable."""
COMPARED = 12
"""Budget: sets that are compared, most probable first."""


@dataclass(frozen=True)
class Candidate:
    """An experiment that could be run.

    Attributes:
        cost: of one run [s].
        allowed: whether the user allows it.
        runs: number of real runs so far.
        test: of the specification, in its units; None for a protocol, or where the simulator has the same units.
    """

    experiment: Experiment
    cost: float
    allowed: bool = True
    runs: int = 0
    test: Mapping[str, float] | None = None

    @property
    def shown(self) -> Experiment:
        """The experiment in the units of the specification."""
        return self.experiment if self.test is None else Experiment.test(self.test)


@dataclass(frozen=True)
class Power(Shown):
    """What one more run of an experiment says about a possible effect.

    Attributes:
        candidate: the experiment.
        experiment: the experiment in words.
        allowed: whether the user allows it.
        sigma: distance of the most probable sets with and without the effect, in standard deviations per run.
        settles: whether the effect is then named or ruled out.
    """

    candidate: Candidate
    sigma: float
    settles: bool

    JSON = "experiment=candidate.shown.__str__ allowed=candidate.allowed sigma settles"


@dataclass(frozen=True)
class Separation:
    """A possible effect, and the experiments that could settle it.

    Attributes:
        effect: the name of the effect.
        included: the most probable set with the effect.
        excluded: the most probable set without it.
        powers: the experiments, largest distance first.
    """

    effect: str
    included: tuple[str, ...]
    excluded: tuple[str, ...]
    powers: tuple[Power, ...]

    def best(self, allowed: bool) -> Power | None:
        """Return the experiment that settles the effect, the most powerful one first; None where none does."""
        return next((one for one in self.powers if one.settles and one.candidate.allowed is allowed), None)


@dataclass(frozen=True)
class InformationForecast:
    """The posterior of ψ given each of the most probable sets.

    Attributes:
        information, shared: (K, K) of the data so far about ψ, and (K,) the diagonal of S.
        variance: (S, K) diagonal of P_A.
        mean, covariance: (S, K) and (S, K, K) of ψ.
    """

    estimate: Estimate
    information: FloatArray
    shared: FloatArray
    variance: FloatArray
    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, estimate: Estimate) -> InformationForecast:
        """Return the forecast of an estimate."""
        theta, likelihood = estimate.fit.theta, estimate.fit.likelihood
        shared, one = estimate.fit.shared, np.eye(theta.size)
        inner = one - likelihood.information * shared
        information = np.linalg.solve(inner, likelihood.information)
        information = (information + information.T) / 2.0
        moment = np.linalg.solve(inner, likelihood.score + likelihood.information @ theta)
        prior = estimate.posterior.prior
        variance = np.array([prior.deviation(members) ** 2 for members in estimate.posterior.sets[:COMPARED]])
        covariance = np.array([np.linalg.inv(information + np.diag(1.0 / (v + shared))) for v in variance])
        return cls(estimate, information, shared, variance, covariance @ moment, covariance)

    @cached_property
    def names(self) -> tuple[tuple[str, ...], ...]:
        """The effects of each set."""
        sets = self.estimate.posterior.sets[: len(self.mean)]
        return tuple(tuple(dict.fromkeys(self.axes[k].effect for k in members)) for members in sets)

    @property
    def axes(self) -> tuple[EffectAxis, ...]:
        """The parameters of the catalogue."""
        return self.estimate.library.parameters

    @cached_property
    def sizes(self) -> FloatArray:
        """(K,) the size of each parameter whose response counts: the largest of any set, or a quarter of typical."""
        prior = self.estimate.posterior.prior
        largest = np.take_along_axis(self.mean, np.abs(self.mean).argmax(axis=0)[None], axis=0)[0]
        usual = np.where(prior.high > 0.0, NAMED, -NAMED)
        return np.clip(np.where(np.abs(largest) < NAMED, usual, largest), prior.low, prior.high)

    @cached_property
    def _gains(self) -> dict[tuple[Experiment, int], FloatArray]:
        return {}

    def gained(self, candidate: Candidate) -> FloatArray:
        """Return (K, K) the information of one more run about ψ."""
        key = candidate.experiment, candidate.runs
        if key not in self._gains:
            self._gains[key] = self._gained(candidate)
        return self._gains[key]

    def _gained(self, candidate: Candidate) -> FloatArray:
        response = self.estimate.library.response(candidate.experiment)
        one = Observation.of(response, [response.nominal], self.estimate.library.dependence)
        fit = self.estimate.fit

        def of(runs: int) -> FloatArray:
            return information(one.of_runs(runs), fit.theta, fit.errors.sizes, self.sizes)

        if not candidate.runs:
            return of(1)
        more = of(candidate.runs + 1) - of(candidate.runs)
        # Errors of law bound the information of an experiment, so the difference may be negative by a little.
        values, vectors = np.linalg.eigh(more)
        return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)

    def apart(self, gained: FloatArray) -> FloatArray:
        """Return (S, S) the distance D of any two sets in data of this information."""
        count = len(self.mean)
        distance = np.zeros((count, count))
        for i in range(count):
            for j in range(i):
                delta = self.mean[i] - self.mean[j]
                between = 0.5 * (self.covariance[i] + self.covariance[j])
                projected = np.linalg.solve(np.eye(delta.size) + gained @ between, gained @ delta)
                distance[i, j] = distance[j, i] = np.sqrt(max(float(delta @ projected), 0.0))
        return distance

    def deviation(self, gained: FloatArray, row: int) -> FloatArray:
        """Return (K,) the deviation of every size given a set, after data of this information."""
        total = self.information + gained
        precision = np.linalg.solve(np.eye(len(total)) + total * self.shared, total)
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(precision + np.diag(1.0 / self.variance[row])))))


def information(one: Observation, theta: FloatArray, at: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return (K, K) the information of an observation about ψ.

    The errors of responses are those at (K,) θ, and errors of law those at (K,) ``at``. Slopes are from nominal to (K,)
    ``sizes``.
    """
    if not one.parts:
        return np.zeros((sizes.size, sizes.size))
    slopes = [
        curve.at(size) / size if size else curve.slope(0.0)
        for curve, size in zip(one.curves, sizes.tolist(), strict=True)
    ]
    columns = np.vstack([*slopes, one.variants])
    groups = one.reduced(np.zeros(columns.shape[1]), columns, one.errors(theta))
    before = Variances.prior(len(one.parts))
    marginal = groups.likelihood(at, before).without_variants(sizes.size)
    kinds = len(one.parts) * [one.response.experiment.protocol]
    form = form_error(at, groups.information(at, before), kinds, marginal.information)
    return marginal.with_form_error(form).information


def separations(
    forecast: InformationForecast, possible: Iterable[str], candidates: Sequence[Candidate]
) -> tuple[Separation, ...]:
    """Return what one more run of each candidate says about each possible effect.

    A candidate that the library does not have is left out.
    """
    names = list(possible)
    if not names:
        return ()
    known = forecast.estimate.library.experiments
    gains = [(one, forecast.gained(one)) for one in candidates if one.experiment in known]
    distances = [forecast.apart(gained) for _, gained in gains]
    return tuple(_separation(forecast, name, gains, distances) for name in names)


def _separation(
    forecast: InformationForecast,
    effect: str,
    gains: Sequence[tuple[Candidate, FloatArray]],
    distances: Sequence[FloatArray],
) -> Separation:
    names = forecast.names
    included = next((n for n, own in enumerate(names) if effect in own), None)
    excluded = next((n for n, own in enumerate(names) if effect not in own), None)
    row = included or 0
    size = np.where([axis.effect == effect for axis in forecast.axes], np.abs(forecast.mean[row]), 0.0)
    powers = []
    for (one, gained), distance in zip(gains, distances, strict=True):
        largest = int(size.argmax())
        margin = size[largest] - UNNAMED if size[largest] >= NAMED else NAMED - size[largest]
        sigma = clear = float(margin / forecast.deviation(gained, row)[largest])
        settles = clear >= COVER
        if included is not None and excluded is not None:  # else only the width of the size is open
            sigma = float(distance[included, excluded])
            settles &= sigma >= APART
        powers.append(Power(one, sigma, settles))
    return Separation(
        effect,
        () if included is None else names[included],
        () if excluded is None else names[excluded],
        tuple(sorted(powers, key=lambda power: -power.sigma)),
    )
