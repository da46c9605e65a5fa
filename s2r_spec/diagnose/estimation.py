"""The estimate of a machine: from its traces and a library to sizes of all effects and the posterior over sets.

Data: observables of the real runs of each experiment, and of runs of the simulator at estimates. Unknown: θ (K,), and
the set A of parameters that are causes. Model: :mod:`.inference.hierarchical`; prior: :mod:`.inference.prior`.

Estimator: a joint fit (:mod:`.inference.gauss_newton`), corrected by runs at its posterior mean. Its Gaussian
likelihood holds near its point alone. So the best set, its rivals and the most probable sets get fits of their own, the
*modes*, each by its causes. Errors of form leave a part of the difference of the evidence of two modes
(:func:`.hierarchical.score_left`).

Units: θ in typical sizes. Shapes: K parameters, G groups, n_p observables of experiment p.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from s2r_spec.backend import Backend
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError, one_of
from s2r_spec.diagnose.candidates import predicted
from s2r_spec.diagnose.inference.gauss_newton import CLOSE, Errors, Fit, fit
from s2r_spec.diagnose.inference.hierarchical import Likelihood, score_left
from s2r_spec.diagnose.inference.misfit import Misfit, energies
from s2r_spec.diagnose.inference.model_search import ModelPosterior, Set, combine, nearest_mode, posterior
from s2r_spec.diagnose.inference.observation import Observation, Problem
from s2r_spec.diagnose.inference.prior import SizePrior
from s2r_spec.diagnose.inference.recorded import Recorded
from s2r_spec.diagnose.inference.search import search
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import simulated_rows
from s2r_spec.diagnose.simulator.open_loop import OpenLoop
from s2r_spec.diagnose.simulator.response import ResponseLibrary
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import ExecutorFactory

Refine = Callable[[FloatArray, FloatArray], ResponseLibrary | None]
"""Returns a library with more points for (K,) means and (K,) deviations, or None if it would be the same."""
CORRECTIONS = 3
"""Budget: most runs of the simulator at the posterior mean. The most probable sets share :data:`SIMULATED` times as
many."""
SETTLED = 0.02
"""Tolerance: the simulator does not run again where the estimate moved less, in typical sizes."""
RIVALS = 3
"""Budget: sets that are fitted beside the most probable one, each with a run of every experiment."""
PROPOSED = 3
"""Budget: most probable sets of the joint estimate that are proposed for predictions."""
SIMULATED = 2
"""Budget: most probable sets at whose own estimates the simulator runs."""


@dataclass(frozen=True)
class Estimate:
    """The fit of the mode nearest to the most probable set, its problem, and the posterior over all modes.

    Where predictions of left-out tests give the posterior, the fit is the joint one, for forecasts alone. The misfit
    is what the posterior mean leaves; it is None without runs of the simulator there.
    """

    library: ResponseLibrary
    fit: Fit
    posterior: ModelPosterior
    problem: Problem
    misfit: Misfit | None = None


def size_prior(library: ResponseLibrary) -> SizePrior:
    """Return the prior of the catalogue's parameters."""
    axes = library.parameters
    low, high = np.array([axis.ends for axis in axes]).reshape(-1, 2).T
    turns = np.array([axis.is_phase for axis in axes])
    low, high = np.where(turns, -np.inf, low), np.where(turns, np.inf, high)
    return SizePrior.of([axis.effect for axis in axes], low, high, library.dependence.base >= 0)


def estimate(
    backend: Backend,
    library: ResponseLibrary,
    traces: Mapping[Experiment, Sequence[Trace]],
    corrections: int = CORRECTIONS,
    executor: ExecutorFactory | None = None,
    refine: Refine | None = None,
) -> Estimate:
    """Return the estimate of a machine, from experiment → real runs.

    The simulator runs at most ``corrections`` times at the posterior mean, in a pool or here; 0 means no run at all.
    ``refine`` may give a library with more points after the first fit, which then begins again.

    Raises:
        UsageError: there is no run, an experiment is not in the library, or no run has a channel of the simulator.
    """
    seen = _seen(backend, library, traces)
    problem = _problem(library, seen)
    corrected = partial(_corrected, backend, library, executor)
    prior = problem.prior
    joint = _joint_fit(library, problem)
    first = posterior(joint.likelihood, joint.theta, prior)
    if refine is not None and (finer := refine(*moments(first))) is not None:
        return estimate(backend, finer, traces, corrections, executor)
    if corrections and not isinstance(backend, OpenLoop) and not any(one.protocol for one in seen):
        likely = list(zip(first.sets[:PROPOSED], first.mean[:PROPOSED], strict=True))
        found = predicted(backend, library, seen, prior, executor, likely)
        if found is not None:
            return Estimate(library, joint, found.posterior, problem, found.misfit)
    for _ in range(corrections):
        before, deviation = moments(first)
        problem = corrected(problem, before)
        joint = fit(problem, joint.theta, errors=Errors.at(problem, joint.theta, deviation))
        first = posterior(joint.likelihood, joint.theta, prior)
        if np.abs(first.probability @ first.mean - before)[prior.causes].max(initial=0.0) < SETTLED:
            break
    starts = {first.sets[0]: (problem, first.mean[0])}
    for theta, members in rivals(joint.likelihood, first):
        # Beside a large effect a sum of responses may be wrong, so each rival has runs of its own.
        starts[members] = corrected(problem, theta) if corrections else problem, theta
    errors = _expected_variances(fit_modes(library, starts, problem.errors(joint.theta, moments(first)[1])))
    modes = fit_modes(library, starts, errors)
    total = over_modes(modes)
    for _ in range(SIMULATED * corrections):
        row = next((n for n, own in enumerate(total.sets[:SIMULATED]) if not _is_settled(modes, own)), None)
        if row is None:
            break
        members = total.sets[row]
        theta = modes[members].fit.theta if members in modes else total.mean[row]
        modes |= fit_modes(library, {members: (corrected(problem, theta), theta)}, errors)
        total = over_modes(modes)
    misfit = _misfit(backend, library, executor, seen, moments(total)[0]) if corrections else None
    return replace(modes[nearest_mode(modes, total.sets[0])], posterior=total, misfit=misfit)


def _seen(
    backend: Backend, library: ResponseLibrary, traces: Mapping[Experiment, Sequence[Trace]]
) -> dict[Experiment, list[Trace]]:
    """Return experiment → real runs with their residuals; each experiment must be in the library."""
    known = {one.experiment for one in library.responses}
    for experiment in traces:
        if experiment not in known:
            have = one_of(sorted({one.protocol or "other tests" for one in known}))
            raise UsageError(f"the response library has no {experiment}; it has {have}")
    return {e: [e.with_residuals(run, backend) for run in runs] for e, runs in traces.items() if runs}


def _problem(library: ResponseLibrary, seen: Mapping[Experiment, Sequence[Trace]]) -> Problem:
    """Return the data and the prior; some run must have a channel of the simulator."""
    observations = []
    for experiment, runs in seen.items():
        own = library.response(experiment)
        vectors = [own.observables.vector(run) for run in runs]
        observations.append(Observation.of(own, vectors, library.dependence))
    if not any(one.parts for one in observations):
        raise UsageError(
            "no run has a channel that the simulator has, too, so no size can be estimated; add such runs"
        )
    return Problem(tuple(observations), size_prior(library))


def _misfit(
    backend: Backend,
    library: ResponseLibrary,
    executor: ExecutorFactory | None,
    seen: Mapping[Experiment, Sequence[Trace]],
    theta: FloatArray,
) -> Misfit:
    """Return what the simulator leaves of all experiments at (K,) sizes."""
    data = Recorded.of(backend, library, seen)
    responses, nominal = [one.response for one in data.observations], np.zeros_like(theta)
    before, after = (
        energies(
            data.near(sizes, simulated_rows(backend, responses, library.values(sizes), executor)),
            data.background,
            sizes,
        )
        for sizes in (nominal, theta)
    )
    return Misfit.of(data.observations, before, after)


def _is_settled(modes: Mapping[Set, Estimate], members: Set) -> bool:
    if members not in modes:
        return False
    problem, theta = modes[members].problem, modes[members].fit.theta
    away = np.abs(theta - problem.observations[0].ran)
    return bool(away[problem.prior.causes].max(initial=0.0) < SETTLED)


def _corrected(
    backend: Backend,
    library: ResponseLibrary,
    executor: ExecutorFactory | None,
    problem: Problem,
    theta: FloatArray,
) -> Problem:
    """Return the problem with runs at (K,) θ in place of sums of responses there, as far as the runs reach."""
    theta = np.clip(theta, problem.prior.low, problem.prior.high)
    responses = [one.response for one in problem.observations]
    rows = simulated_rows(backend, responses, library.values(theta), executor)
    observations = []
    for one, own in zip(problem.observations, rows, strict=True):
        correction = own.mean(axis=0) - one.response.reference
        correction[one.kept] -= one.moved(theta)
        observations.append(one.corrected(correction, theta))
    return replace(problem, observations=tuple(observations))


def _joint_fit(library: ResponseLibrary, problem: Problem) -> Fit:
    """Return the more probable of two joint estimates; the second search starts from the first."""
    first = fit(problem)
    fits = [first, fit(problem, search(problem, first.theta))]
    fits = [fit(problem, one.theta, errors=Errors.at(problem, one.theta)) for one in fits]
    if np.abs(fits[0].theta - fits[1].theta)[problem.prior.causes].max(initial=0.0) < CLOSE:
        return fits[1]
    sets = [posterior(one.likelihood, one.theta, problem.prior) for one in fits]
    each = [problem.errors(one.theta) for one in fits]
    errors = [np.max(same, axis=0) for same in zip(*each, strict=True)]
    modes = [fit_modes(library, {one.sets[0]: (problem, one.mean[0])}, errors) for one in sets]
    evidence = [estimate.posterior.log_evidence for own in modes for estimate in own.values()]
    return fits[int(np.argmax(evidence))]


def moments(posterior: ModelPosterior) -> tuple[FloatArray, FloatArray]:
    """Return (K,) mean and (K,) standard deviation of every size over all sets, before truncation to the ranges."""
    mean = posterior.probability @ posterior.mean
    square = posterior.probability @ (posterior.deviation**2 + (posterior.mean - mean) ** 2)
    return mean, np.sqrt(square)


def _expected_variances(modes: Mapping[Set, Estimate]) -> list[FloatArray]:
    """Return (n_p,) the posterior means over modes of the variances of responses, for every experiment.

    Those at the joint estimate, in which every parameter may be a cause, are too large.
    """
    evidence = np.array([mode.posterior.log_evidence for mode in modes.values()])
    weight = np.exp(evidence - evidence.max())
    weight /= weight.sum()
    each = [mode.problem.errors(mode.fit.theta, moments(mode.posterior)[1]) for mode in modes.values()]
    return [weight @ np.array(same) for same in zip(*each, strict=True)]


def fit_modes(
    library: ResponseLibrary, modes: Mapping[Set, tuple[Problem, FloatArray]], variances: Sequence[FloatArray]
) -> dict[Set, Estimate]:
    """Return the estimate around each mode: causes → problem and (K,) a point.

    In the fit the causes of a mode have the prior of causes, and all other parameters that of the background. Its law
    errors are those of its own sizes: an effect that is not there has none. The (n_p,) ``variances`` of the responses
    are the same for all modes, so that their evidence can be compared.
    """
    estimates = {}
    for active, (problem, theta) in modes.items():
        prior = problem.prior
        start = np.clip(theta, prior.low, prior.high)
        own = Errors(variances, np.abs(start))
        last = fit(problem, start, prior.deviation(active), own)
        estimates[active] = Estimate(library, last, posterior(last.likelihood, last.theta, prior), problem)
    return estimates


def over_modes(modes: Mapping[Set, Estimate]) -> ModelPosterior:
    """Return the posterior over all modes.

    The evidence of a mode is that of its best set. Errors of form leave a part of the difference of two modes. Within
    one mode the likelihood has these errors already.
    """
    best = max(modes.values(), key=lambda mode: mode.posterior.log_evidence)
    most, softened = best.posterior.log_evidence, {}
    for active, mode in modes.items():
        deficit = most - mode.posterior.log_evidence
        ratio = best.fit.form_ratio(squared_difference(best, mode))
        softened[active] = replace(mode.posterior, log_evidence=most - score_left(deficit, ratio))
    return combine(softened)


def squared_difference(one: Estimate, other: Estimate) -> FloatArray:
    """Return (G,) the mean squared difference of two predictions in each group, in u of the first."""
    squares = []
    pairs = zip(one.problem.observations, other.problem.observations, one.fit.errors.variances, strict=True)
    for first, second, errors in pairs:
        difference = first.residual(one.fit.theta) - second.residual(other.fit.theta)
        squares += [float(((difference / first.unit(errors))[own] ** 2).mean()) for _, own in first.parts]
    return np.array(squares)


def rivals(likelihood: Likelihood, sets: ModelPosterior) -> list[tuple[FloatArray, Set]]:
    """Return a start and a set for each rival: one effect of the most probable set, exchanged for a similar one.

    Effects are similar if the cosine of their signatures is large in the metric of the likelihood.
    """
    active, information = sets.sets[0], likelihood.information
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    cosine = np.abs(information / np.outer(scale, scale))
    others = [k for k in sets.prior.causes.tolist() if k not in active]
    pairs = [(float(cosine[j, k]), j, k) for j in active for k in others if cosine[j, k] > 0.0]
    starts = []
    for _, lost, gained in sorted(pairs, reverse=True)[:RIVALS]:
        theta = sets.mean[0].copy()
        theta[gained] = theta[lost] * information[lost, gained] / scale[gained] ** 2
        theta[lost] = 0.0
        starts.append((theta, tuple(sorted({*active, gained} - {lost}))))
    return starts
