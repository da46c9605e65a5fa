"""The estimate of a machine: from its traces and a library to sizes of all effects and the posterior over sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend
from s2r_spec.diagnose.inference.gauss_newton import Fit, Observation, Problem, fit
from s2r_spec.diagnose.inference.model_search import ModelPosterior, posterior
from s2r_spec.diagnose.inference.prior import SizePrior
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import Response, ResponseLibrary, simulated
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]

CORRECTIONS = 1
"""Budget: times that the simulator runs at the estimate. Each costs one run of every experiment."""


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
        library: its responses to every experiment of the traces.
        traces: experiment → real runs.
        corrections: times that the simulator runs at the estimate.
    """
    observations = []
    for experiment, runs in traces.items():
        response = library.response(experiment)
        vectors = [response.observables.vector(experiment.with_residuals(run, backend)) for run in runs]
        observations.append(Observation.of(response, vectors))
    problem = Problem(tuple(observations), size_prior(library))
    found = fit(problem)
    for _ in range(corrections):
        problem = problem.corrected(
            [correction(backend, library, one.response, found.theta) for one in observations]
        )
        found = fit(problem, found.theta)
    return Estimate(library, found, posterior(found.likelihood, found.theta, problem.prior))


def correction(
    backend: Backend, library: ResponseLibrary, response: Response, theta: FloatArray
) -> FloatArray:
    """Return (m,) what the simulator's mean at θ is beyond the sum of responses; 0 where a run ended early."""
    exact = simulated(backend, response, library.values(theta)) - response.reference
    beyond = exact - (response.mean(theta) - response.nominal)
    return np.where(np.isfinite(beyond), beyond, 0.0)
