"""The estimate of a machine: from its traces and a library to sizes of all effects and the posterior over sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend
from s2r_spec.diagnose.inference.gauss_newton import Fit, Observation, Problem, fit, search
from s2r_spec.diagnose.inference.hierarchical import Likelihood
from s2r_spec.diagnose.inference.model_search import ModelPosterior, combined, posterior
from s2r_spec.diagnose.inference.prior import SizePrior
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import Response, ResponseLibrary, nominal, simulated
from s2r_spec.errors import UsageError, one_of
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

CORRECTIONS = 1
"""Budget: times that the simulator runs at the estimate. Twice as many take twice the runs of every experiment."""
AGAIN = 1
"""Budget: further searches, each from the estimate of the one before. Every one takes about 5 s of one core."""
RIVALS = 3
"""Budget: sets that are fitted beside the most probable one. Twice as many take about twice the time of all fits."""
SIMULATED = 2
"""Budget: of these fits, the best ones whose set the simulator runs. Twice as many take twice the runs."""


@dataclass(frozen=True)
class Estimate:
    """The joint estimate and the posterior of a machine."""

    library: ResponseLibrary
    fit: Fit
    posterior: ModelPosterior


def size_prior(library: ResponseLibrary) -> SizePrior:
    """Return the prior of the catalogue's parameters."""
    lines = library.parameters
    low = np.array([min(line.coordinate(line.low), line.coordinate(line.high)) for line in lines])
    high = np.array([max(line.coordinate(line.low), line.coordinate(line.high)) for line in lines])
    return SizePrior.of([line.effect for line in lines], low, high, library.dependence.base >= 0)


def estimate(
    backend: Backend,
    library: ResponseLibrary,
    traces: Mapping[Experiment, Sequence[Trace]],
    corrections: int = CORRECTIONS,
) -> Estimate:
    """Return the estimate of a machine.

    Args:
        backend: the nominal simulator.
        library: its responses to every protocol of the traces, and to some tests of the specification.
        traces: experiment → real runs. Runs of a test that the library does not have count for the nearest one that
            it has, less the difference that the nominal simulator makes between the two.
        corrections: times that the simulator runs at the estimate.

    Raises:
        UsageError: there is no run, a run's protocol is not in the library, or no run has a channel of the simulator.
    """
    vectors: dict[Experiment, list[FloatArray]] = {}
    for experiment, runs in traces.items():
        response = nearest(library, experiment)
        found = [response.observables.vector(experiment.with_residuals(run, backend)) for run in runs]
        shift: FloatArray | float = 0.0
        if response.experiment != experiment:
            shift = nominal(backend, response, experiment) - response.reference
        vectors.setdefault(response.experiment, []).extend(each - shift for each in found)
    observations = [
        Observation.of(library.response(e), each, library.dependence) for e, each in vectors.items()
    ]
    if not any(one.parts for one in observations):
        raise UsageError(
            "no run has a channel that the simulator has, too, so no size can be estimated; add such runs"
        )
    prior = size_prior(library)
    plain = Problem(tuple(observations), prior)
    starts: list[Mode] = []
    joint = fit(plain)
    for _ in range(1 + AGAIN):
        joint = fit(plain, search(plain, joint.theta)) if starts else joint
        joint = fit(plain, joint.theta, sizes=np.abs(joint.theta))
        first = posterior(joint.likelihood, joint.theta, prior)
        starts.append(Mode(plain, first.mean[0], first.sets[0]))
    starts += [Mode(plain, *one) for one in rivals(joint.likelihood, first)]
    errors = Errors(plain.errors(joint.theta), np.abs(joint.theta))
    errors = Errors.expected(plain, fitted(library, starts, errors))
    modes = fitted(library, starts, errors)
    for _ in range(corrections):
        different = {mode.posterior.sets[0]: mode for mode in reversed(modes)}
        best = [mode for mode in modes if different[mode.posterior.sets[0]] is mode][:SIMULATED]
        modes = fitted(library, [corrected(backend, library, plain, mode) for mode in best], errors)
    return replace(modes[0], posterior=combined([mode.posterior for mode in modes]))


def nearest(library: ResponseLibrary, experiment: Experiment) -> Response:
    """Return the response of an experiment, or of the nearest test in units of the tests' spread.

    Raises:
        UsageError: the library lacks the protocol, or has no test of these parameters.
    """
    responses = {each.experiment: each for each in library.responses}
    if experiment in responses:
        return responses[experiment]
    names = [name for name, _ in experiment.params]
    tests = [
        e for e in responses if not (e.protocol or experiment.protocol) and [n for n, _ in e.params] == names
    ]
    if not tests:
        have = one_of(sorted({e.protocol or "tests" for e in responses}))
        raise UsageError(f"the response library has no {experiment}; it has {have}")
    places = np.array([[value for _, value in e.params] for e in (*tests, experiment)])
    spread = np.ptp(places, axis=0)
    distance = np.abs((places[:-1] - places[-1]) / np.where(spread > 0.0, spread, 1.0)).sum(axis=1)
    return responses[tests[int(np.argmin(distance))]]


@dataclass(frozen=True)
class Mode:
    """A mode of the likelihood: a problem, (K,) a point, and the parameters that are causes."""

    problem: Problem
    theta: FloatArray
    active: tuple[int, ...]


@dataclass(frozen=True)
class Errors:
    """Errors of the model, the same for all modes, so that their evidence can be compared.

    They grow with the sizes. First they are those at the joint estimate, in which every parameter may be a cause; then
    their posterior means over the modes that this gives.

    Attributes:
        variances: (n_p,) of the responses, for every experiment.
        sizes: (K,) at which the law errors are.
    """

    variances: Sequence[FloatArray]
    sizes: FloatArray

    @classmethod
    def expected(cls, problem: Problem, modes: Sequence[Estimate]) -> Errors:
        """Return the posterior means over modes."""
        evidence = np.array([mode.posterior.log_evidence for mode in modes])
        weight = np.exp(evidence - evidence.max())
        weight /= weight.sum()
        theta = np.array([mode.fit.theta for mode in modes])
        each = [problem.errors(one) for one in theta]
        return cls([weight @ np.array(same) for same in zip(*each, strict=True)], np.sqrt(weight @ theta**2))


def fitted(library: ResponseLibrary, modes: Sequence[Mode], errors: Errors) -> list[Estimate]:
    """Return the estimate around each mode, the most probable first.

    In the fit the causes of a mode have the prior of causes, and all other parameters that of the background.
    """
    found = []
    for mode in modes:
        prior = mode.problem.prior
        last = fit(mode.problem, mode.theta, prior.deviation(mode.active), errors.variances, errors.sizes)
        found.append(Estimate(library, last, posterior(last.likelihood, last.theta, prior)))
    return sorted(found, key=lambda mode: -mode.posterior.log_evidence)


def corrected(backend: Backend, library: ResponseLibrary, problem: Problem, found: Estimate) -> Mode:
    """Return the mode with runs of the simulator at its most probable set in place of sums of responses."""
    active = found.posterior.sets[0]
    theta = np.clip(found.posterior.mean[0], problem.prior.low, problem.prior.high)
    if not active:
        return Mode(problem, theta, active)
    part = [k in active or (found.library.dependence.base[k] in active) for k in range(theta.size)]
    causes = np.where(part, theta, 0.0)
    new = [correction(backend, library, one, causes) for one in problem.observations]
    return Mode(problem.corrected(new, causes), theta, active)


def rivals(found: Likelihood, sets: ModelPosterior) -> list[tuple[FloatArray, tuple[int, ...]]]:
    """Return a start and a set for each rival: one effect of the most probable set, exchanged for a similar one.

    Effects are similar if the cosine of their signatures is large in the metric of the likelihood.
    """
    active, information = sets.sets[0], found.information
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    cosine = np.abs(information / np.outer(scale, scale))
    others = [k for k in range(len(scale)) if k not in active]
    pairs = [(float(cosine[j, k]), j, k) for j in active for k in others if cosine[j, k] > 0.0]
    starts = []
    for _, lost, gained in sorted(pairs, reverse=True)[:RIVALS]:
        theta = sets.mean[0].copy()
        theta[gained] = theta[lost] * information[lost, gained] / information[gained, gained]
        theta[lost] = 0.0
        starts.append((theta, tuple(sorted({*active, gained} - {lost}))))
    return starts


def correction(backend: Backend, library: ResponseLibrary, one: Observation, theta: FloatArray) -> FloatArray:
    """Return (m,) what the simulator's mean at θ is beyond the sum of responses; 0 where a run ended early."""
    response = one.response
    beyond = simulated(backend, response, library.values(theta)) - response.reference
    beyond[one.kept] -= one.moved(theta)
    return np.where(np.isfinite(beyond), beyond, 0.0)
