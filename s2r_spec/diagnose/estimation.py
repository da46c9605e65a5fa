"""The estimate of a machine: from its traces and a library to sizes of all effects and the posterior over sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend
from s2r_spec.diagnose.inference.gauss_newton import Fit, Observation, Problem, fit
from s2r_spec.diagnose.inference.hierarchical import Likelihood
from s2r_spec.diagnose.inference.model_search import ModelPosterior, posterior
from s2r_spec.diagnose.inference.prior import BACKGROUND, SLAB, SizePrior
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import Response, ResponseLibrary, nominal, simulated
from s2r_spec.errors import UsageError, one_of
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

CORRECTIONS = 1
"""Budget: times that the simulator runs at the estimate. Twice as many take twice the runs of every experiment."""
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
    return SizePrior.of([line.effect for line in lines], low, high)


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
    observations = [Observation.of(library.response(e), each) for e, each in vectors.items()]
    if not any(one.parts for one in observations):
        raise UsageError(
            "no run has a channel that the simulator has, too, so no size can be estimated; add such runs"
        )
    prior = size_prior(library)
    plain = Problem(tuple(observations), prior)
    joint = fit(plain)
    first = posterior(joint.likelihood, joint.theta, prior)
    starts = [(first.mean[0], first.sets[0]), *rivals(joint.likelihood, first)]
    modes = [around(library, plain, theta, active) for theta, active in starts]
    modes.sort(key=lambda mode: -mode.posterior.log_evidence)
    best = [exact(backend, mode, plain, corrections) for mode in modes[:SIMULATED]]
    return max(best, key=lambda mode: mode.posterior.log_evidence)


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


def around(
    library: ResponseLibrary, problem: Problem, theta: FloatArray, active: tuple[int, ...]
) -> Estimate:
    """Return the estimate around a set: its own effects are causes, and all others are background."""
    prior = problem.prior
    deviation = np.where(np.isin(np.arange(theta.size), active), SLAB, BACKGROUND)
    found = fit(problem, np.clip(theta, prior.low, prior.high), deviation)
    return Estimate(library, found, posterior(found.likelihood, found.theta, prior))


def exact(backend: Backend, mode: Estimate, problem: Problem, corrections: int) -> Estimate:
    """Return the estimate with runs of the simulator at the most probable set in place of sums of responses."""
    for _ in range(corrections):
        active = mode.posterior.sets[0]
        if not active:
            break
        theta = np.clip(mode.posterior.mean[0], problem.prior.low, problem.prior.high)
        causes = np.where(np.isin(np.arange(theta.size), active), theta, 0.0)
        responses = [one.response for one in problem.observations]
        new = problem.corrected([correction(backend, mode.library, each, causes) for each in responses])
        mode = around(mode.library, new, theta, active)
    return mode


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


def correction(
    backend: Backend, library: ResponseLibrary, response: Response, theta: FloatArray
) -> FloatArray:
    """Return (m,) what the simulator's mean at θ is beyond the sum of responses; 0 where a run ended early."""
    moved = simulated(backend, response, library.values(theta)) - response.reference
    beyond = moved - (response.mean(theta) - response.nominal)
    return np.where(np.isfinite(beyond), beyond, 0.0)
