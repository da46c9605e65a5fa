"""Certify any number that a rollout gives: a barrier function's minimum, a distance, a time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

from s2r_spec.backend import Backend
from s2r_spec.base.distribution import version
from s2r_spec.base.errors import UsageError
from s2r_spec.certify.arguments import as_backend, as_folder, options_from
from s2r_spec.certify.bound.certificate import Certificate
from s2r_spec.certify.options import MeasureKeywords, MeasureOptions, require_begun, with_seed
from s2r_spec.certify.result.voids import machine_assumptions, machine_fields, without_too_many
from s2r_spec.certify.search.experiments import Rollouts, run_search
from s2r_spec.certify.search.search import Search
from s2r_spec.machine.attendance import Terms, refuse_terms
from s2r_spec.machine.machine_runner import runner_for
from s2r_spec.runs.journal import Journal
from s2r_spec.runs.scorer import Measure, Scorer, open_system, pass_backend


def check_measure(
    measure: Measure,
    name: str,
    backend: Backend | str,
    search: Search,
    folder: Path | str,
    **keywords: Unpack[MeasureKeywords],
) -> Certificate:
    """Certify the worst expected value of ``measure(trace, params)`` over the search's test space.

    The search maximises −measure: the worst expected value lies in
    [−certificate.upper, −certificate.lower] with probability ≥ 1 − δ.

    Args:
        measure: the function of a trace that did not fail, and its test; runs in this process. Its kernel norm B, its
            noise R and its ``fall`` are declared with the search, as in a spec.
        name: the name of the measure in the journal; a resumed run must have the same name.
        backend: a backend object, or the name of an installed one; the search's parameters must be the backend's, in
            its units.
        search: new, over the test space.
        folder: the folder of the journal and the traces.
        keywords: ``fall`` must be given, the others may be; see :class:`~s2r_spec.certify.options.MeasureOptions`.

    Raises:
        UsageError: backend, search and folder do not fit together, or there is no run to resume.
        BackendError: a rollout raised, or the measure of one did or gave no finite number; the message names the
            rollout and its test. Every rollout before it is in the journal, and that trace is kept.
    """
    options = options_from(MeasureOptions, keywords)
    backend, folder = as_backend(backend), as_folder(folder)
    if not callable(measure):
        raise UsageError(f"measure must be a function of a trace and its test, not {measure!r}")
    if not isinstance(name, str):
        raise UsageError(f"name must be a string, the name of the measure in the journal, not {name!r}")
    if not isinstance(search, Search):
        raise UsageError(f"search must be an s2r.Search, not a value of type {type(search).__name__}")
    if options.resume:
        require_begun([folder], folder)
    options = with_seed(options, folder)
    search.refuse_hopeless()
    (called, machine), terms = open_system(backend, options.duration), Terms()
    refuse_terms(machine, terms)
    passed = None if isinstance(backend, str) else pass_backend(machine)
    scorer = Scorer(called, machine, measure, options.fall, passed=passed)
    header: dict[str, Any] = {
        "s2r": version(),
        "measure": name,
        "backend": called,
        "model_hash": machine.model_hash,
        "duration": machine.duration,
        "seed": options.fixed_seed,
        "fall": options.fall,
        "settings": search.certificate().settings,
    }
    header |= machine_fields(scorer, terms.void)
    journal = Journal.resume(folder, header) if options.resume else Journal.create(folder, header, {})
    with options.runner(passed) as pool, runner_for(pool, machine, journal, terms, search.budget) as runner:
        run_search(search, Rollouts(scorer, options.fixed_seed, journal, runner), options.watching)
    certificate = without_too_many(search.certificate(), called, journal)
    assumptions = (*certificate.assumptions, *machine_assumptions(called, header, journal))
    return replace(certificate, assumptions=assumptions)
