"""Certify any number that a rollout gives: a barrier function's minimum, a distance, a time."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import version
from math import isfinite
from pathlib import Path

from s2r_spec.certify.arguments import as_folder, as_name, require_begun
from s2r_spec.certify.certificate import Certificate
from s2r_spec.certify.experiments import Observer, Rollouts, run_search
from s2r_spec.certify.search import Search
from s2r_spec.certify.voids import about, assumed, without_too_many
from s2r_spec.errors import UsageError
from s2r_spec.rollouts.attendance import Terms, refuse_terms
from s2r_spec.rollouts.journal import Journal
from s2r_spec.rollouts.machine_runner import runner_for
from s2r_spec.rollouts.pools import ExecutorFactory, process_pool
from s2r_spec.rollouts.runner import Runner, open_backend
from s2r_spec.rollouts.scorer import Measure, Scorer


def check_measure(
    measure: Measure,
    name: str,
    backend: str,
    search: Search,
    folder: Path | str,
    *,
    fall: float,
    duration: float | None = None,
    seed: int = 0,
    executor: ExecutorFactory | None = None,
    resume: bool = False,
    observer: Observer | None = None,
) -> Certificate:
    """Certify the worst expected value of ``measure(trace, params)`` over the search's test space.

    The search maximises −measure: the worst expected value lies in
    [−certificate.upper, −certificate.lower] with probability ≥ 1 − δ.

    Args:
        measure: of a trace that did not fail, and its test; runs in this process. Its kernel norm B, its
            noise R and its ``fall`` are declared with the search, like those of a spec.
        name: what the journal calls it; a resumed run must call it the same.
        backend: its name; the search's parameters must be the backend's, in its units.
        search: fresh, over the test space.
        folder: of the journal and the traces.
        fall: value of a rollout that fails.
        duration: length of the rollouts [s]; the backend's own if None.
        seed: of the rollouts.
        executor: makes the pool; two local processes by default.
        resume: go on with the run in ``folder``.
        observer: is told of batches and rollouts.

    Raises:
        UsageError: backend, search and folder do not fit together, or there is no run to resume.
        BackendError: a rollout raised, or the measure of one did or gave no finite number; the message names the
            rollout and its test. All that came before is in the journal, and that trace is kept.
    """
    backend, folder = as_name(backend), as_folder(folder)
    if not callable(measure):
        raise UsageError(f"measure must be a function of a trace and its test, not {measure!r}")
    if not isinstance(name, str):
        raise UsageError(f"name must be a text, what the journal calls the measure, not {name!r}")
    if not isinstance(search, Search):
        raise UsageError(f"search must be an s2r.Search, not a value of type {type(search).__name__}")
    if not isinstance(fall, int | float) or not isfinite(fall):
        raise UsageError(f"fall must be a finite number, what a rollout that fails is worth, not {fall!r}")
    if resume:
        require_begun([folder], folder)
    search.refuse_hopeless()
    machine, terms = open_backend(backend, duration), Terms()
    refuse_terms(machine, terms)
    scorer = Scorer(backend, machine, measure, fall)
    header = {
        "s2r": version("s2r"),
        "measure": name,
        "backend": backend,
        "model_hash": machine.model_hash,
        "duration": machine.duration,
        "seed": seed,
        "fall": fall,
        "settings": search.certificate().settings,
    }
    header |= about(machine, terms.void)
    journal = Journal.resume(folder, header) if resume else Journal.create(folder, header, {})
    with (
        Runner(executor or process_pool(2)) as pool,
        runner_for(pool, machine, journal, terms, search.budget) as runner,
    ):
        run_search(search, Rollouts(scorer, seed, journal, runner), observer)
    certificate = without_too_many(search.certificate(), backend, journal)
    return replace(certificate, assumptions=(*certificate.assumptions, *assumed(backend, header, journal)))
