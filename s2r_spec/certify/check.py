"""Search 1: a certified bound on the worst expected robustness over the test space.

The search maximises −ρ. It asks for tests, the backend runs them, and every rollout goes to the journal before its
outcome goes to the search.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Unpack

from s2r_spec.backend import Backend, HasRecordings, is_exclusive
from s2r_spec.base.distribution import version
from s2r_spec.base.errors import UsageError
from s2r_spec.certify.arguments import as_backend, as_spec, name_of, options_from
from s2r_spec.certify.from_spec import only_requirement, search_for
from s2r_spec.certify.options import (
    RunKeywords,
    RunOptions,
    refuse_rule,
    require_begun,
    run_folder,
    with_rule,
    with_seed,
)
from s2r_spec.certify.result.check_result import CheckResult, conclude
from s2r_spec.certify.result.search_result import rho_unit
from s2r_spec.certify.result.voids import machine_fields
from s2r_spec.certify.search.experiments import Rollouts, run_search
from s2r_spec.certify.search.observers import Phase
from s2r_spec.certify.search.recorded import Design, RecordedExperiment, fixed_design, observe
from s2r_spec.certify.search.search import Search
from s2r_spec.machine.attendance import refuse_terms
from s2r_spec.machine.machine_runner import runner_for
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.spec_files import open_journal
from s2r_spec.runs.stop_rule import DECIDED, EPSILON, header_fields
from s2r_spec.spec import Spec

__all__ = ["CheckResult", "check", "check_with"]


def check(
    spec: Spec | Path | str,
    backend: Backend | str,
    folder: Path | str | None = None,
    **keywords: Unpack[RunKeywords],
) -> CheckResult:
    """Certify the worst expected robustness of one requirement over the spec's test space.

    Args:
        spec: a specification with a test space and a certify line, or its file.
        backend: a backend object, or the name of an installed one. Every worker process has its own copy.
        folder: the folder of the journal and the traces; by default a new one in ``s2r-runs``.
        keywords: see :class:`~s2r_spec.certify.options.RunOptions`; all of them may be left out.

    Raises:
        UsageError: the spec, the backend and the folder do not fit together, or there is no run to resume.
        BackendError: a rollout raised; every rollout before it is in the journal.
    """
    options = options_from(RunOptions, keywords)
    spec, backend = as_spec(spec), as_backend(backend)
    requirement = options.requirement or only_requirement(spec)
    with run_folder(folder, f"{Path(spec.name).stem}-{name_of(backend)}", options) as run:
        if options.resume:
            require_begun([run], run)
        search_for(spec, requirement, options)  # refuses a line without settings before the backend is opened
        scorer = Scorer.for_spec(spec, requirement, backend)
        # Recordings are used all at once, so no rule ends their search.
        usual = EPSILON if isinstance(scorer.backend, HasRecordings) else DECIDED
        options = with_seed(with_rule(options, run, usual=usual), run)
        search = search_for(spec, requirement, options)
        return check_with(search, spec, requirement, scorer, run, options)


def check_with(
    search: Search, spec: Spec, requirement: str, scorer: Scorer, folder: Path, options: RunOptions
) -> CheckResult:
    """Run a search for the worst expected robustness to its end; see :func:`check`."""
    refuse_terms(scorer.backend, options.terms)
    design = _design(search, spec, requirement, scorer)
    provenance: dict[str, Any] = {
        "s2r": version(),
        "spec": Path(spec.name).name,
        "spec_hash": spec.hash,
        "requirement": requirement,
        "backend": scorer.name,
        "model_hash": scorer.backend.model_hash,
        "duration": scorer.backend.duration,
        "seed": options.fixed_seed,
        "settings": search.certificate().settings,
    }
    provenance |= header_fields(search.settings.stop)
    if design is not None:
        provenance["recorded"] = list(design.notes)
    provenance |= machine_fields(scorer, options.terms.void)
    journal = open_journal(folder, provenance, spec, options.resume)
    unit, settings = rho_unit(spec, requirement), search.settings if design is None else None
    about = unit, scorer.name, spec.space.units, search.budget, is_exclusive(scorer.backend), settings
    options.watching.begin(Phase("ρ", *about))
    if design is not None:
        observe(search, design, RecordedExperiment(design, scorer, journal), options.watching)
    else:
        with (
            options.runner(scorer.passed) as pool,
            runner_for(pool, scorer.backend, journal, options.terms, search.budget) as runner,
        ):
            run_search(search, Rollouts(scorer, options.fixed_seed, journal, runner), options.watching)
    return conclude(spec, search, journal, provenance)


def _design(search: Search, spec: Spec, requirement: str, scorer: Scorer) -> Design | None:
    """Return the recorded tests of a backend of recordings, None for one that runs; refuse options that do not fit."""
    if not isinstance(scorer.backend, HasRecordings):
        search.refuse_hopeless()
        return None
    if search.budget is not None:
        raise UsageError(f"a budget does not apply to {scorer.name}: s2r uses all of its recordings")
    refuse_rule(search.settings.stop, scorer.name)
    return fixed_design(spec, requirement, scorer.backend, scorer.backend.recordings)
