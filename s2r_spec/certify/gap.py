"""Search 2: how much worse than simulated the real machine can be.

The gap is signed: Δ(d) = ρ_real − ρ_sim, from independent rollouts of machine and simulator. The paper bounds
E|Δ|, which is positive even for two identical noisy systems (2s/√π for noise of deviation s). The result has it
as an estimate.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

from s2r_spec.backend import Backend, is_exclusive
from s2r_spec.base.distribution import version
from s2r_spec.base.errors import UsageError
from s2r_spec.certify.arguments import as_backend, as_spec, name_of, options_from
from s2r_spec.certify.from_spec import of_gap, only_requirement, search_for
from s2r_spec.certify.options import (
    RunKeywords,
    RunOptions,
    refuse_rule,
    require_begun,
    run_folder,
    with_rule,
    with_seed,
)
from s2r_spec.certify.result.gap_result import GapResult, conclude_gap
from s2r_spec.certify.result.search_result import rho_unit
from s2r_spec.certify.result.voids import machine_fields
from s2r_spec.certify.search.experiments import OutcomeSource, Pairs, Rollouts, run_search
from s2r_spec.certify.search.observers import Phase
from s2r_spec.certify.search.pairing import SIMULATED_PER_REAL, Pairing
from s2r_spec.certify.search.recorded import RecordedExperiment, observe
from s2r_spec.certify.search.search import Search
from s2r_spec.machine.attendance import refuse_terms
from s2r_spec.machine.machine_runner import runner_for
from s2r_spec.runs.layout import SYSTEMS
from s2r_spec.runs.seeds import SeedStream
from s2r_spec.runs.spec_files import open_journal
from s2r_spec.runs.stop_rule import DECIDED, EPSILON, header_fields
from s2r_spec.spec import Spec


def gap_search(
    spec: Spec, requirement: str, options: RunOptions, per_real: int = SIMULATED_PER_REAL
) -> Search:
    """Return search 2, which the spec's certify line declares like search 1; see :func:`of_gap`."""
    if (line := spec.certify.get(requirement)) is not None:
        spec = replace(spec, certify={**spec.certify, requirement: of_gap(line, per_real)})
    return search_for(spec, requirement, options)


def gap(
    spec: Spec | Path | str,
    sim: Backend | str,
    real: Backend | str,
    folder: Path | str | None = None,
    **keywords: Unpack[RunKeywords],
) -> GapResult:
    """Bound the signed gap between two backends over the spec's test space.

    Args:
        spec: a specification with a test space and a certify line, or its file.
        sim: the simulator: a backend object, or the name of an installed one.
        real: the real machine, as an object or a name: a robot, its logs, a twin. Every recording inside the test space
            counts once, and the simulator runs at the same tests (or its own logs are read). The search then chooses
            no test.
        folder: the folder of the journals and traces of both backends; by default a new one in ``s2r-runs``.
        keywords: see :class:`~s2r_spec.certify.options.RunOptions`; all of them may be left out.

    Raises:
        UsageError: spec, backends and folder do not fit together, or there is no run to resume.
        BackendError: a rollout raised; every rollout before it is in the journals.
    """
    options = options_from(RunOptions, keywords)
    spec = as_spec(spec)
    sim, real = as_backend(sim, "sim"), as_backend(real, "real")
    requirement = options.requirement or only_requirement(spec)
    name = f"gap-{Path(spec.name).stem}-{name_of(sim)}-{name_of(real)}"
    with run_folder(folder, name, options) as run:
        if options.resume:
            require_begun([run / side for side in SYSTEMS], run)
        places = [run / side for side in SYSTEMS]
        options = with_seed(with_rule(options, *places), *places)
        if options.stop == DECIDED:
            raise UsageError(
                "a gap has no verdict that stop = 'decided' could wait for; use 'epsilon' or 'budget', or run certify"
            )
        if options.repeats:
            raise UsageError("a gap alone has no verdict after which tests could be repeated; run certify")
        pairing = Pairing.for_spec(spec, requirement, sim, real, options.budget)
        search = gap_search(spec, requirement, options, pairing.per_real)
        return gap_with(search, spec, requirement, pairing, run, options)


def gap_with(
    search: Search, spec: Spec, requirement: str, pairing: Pairing, folder: Path, options: RunOptions
) -> GapResult:
    """Run a search for the gap to its end; see :func:`gap`."""
    terms, machine = options.terms, pairing.real.backend
    refuse_terms(machine, terms)
    if pairing.recorded is None:
        search.refuse_hopeless()
    else:
        refuse_rule(search.settings.stop, pairing.real.name)
    provenance: dict[str, Any] = {
        "s2r": version(),
        "spec": Path(spec.name).name,
        "spec_hash": spec.hash,
        "requirement": requirement,
        "seed": options.fixed_seed,
        "simulated_per_real": pairing.per_real,
        "settings": search.certificate().settings,
    }
    provenance |= header_fields(search.settings.stop)
    for side, scorer in pairing.scorers.items():
        provenance[side] = {"backend": scorer.name, "model_hash": scorer.backend.model_hash}
        provenance[side] |= machine_fields(scorer, terms.void)
    if pairing.recorded is not None:
        provenance["recorded"] = list(pairing.notes)
    journals = {}
    for side, scorer in pairing.scorers.items():
        header = provenance | {"side": side, "backend": scorer.name, "duration": scorer.backend.duration}
        journals[side] = open_journal(folder / side, header, spec, options.resume)
    # From these settings an observer may forecast the end; the verdict of certify ends it earlier.
    settings = replace(search.settings, stop=EPSILON) if search.settings.stop == DECIDED else search.settings
    counted, forecast = (pairing.real, settings) if pairing.recorded is None else (pairing.sim, None)
    about = counted.name, spec.space.units, search.budget, is_exclusive(machine), forecast
    options.watching.begin(Phase("Δ", rho_unit(spec, requirement), *about))
    with (
        options.runner(pairing.sim.passed, pairing.real.passed) as runner,
        runner_for(runner, machine, journals["real"], terms, search.budget) as attended,
    ):
        simulated: OutcomeSource = Rollouts(
            pairing.sim, options.fixed_seed, journals["sim"], runner, SeedStream.GAP_SIM, SIMULATED_PER_REAL
        )
        if pairing.recorded is None:
            real = Rollouts(pairing.real, options.fixed_seed, journals["real"], attended, SeedStream.GAP_REAL)
            run_search(search, Pairs(simulated, real), options.watching)
        else:
            if (design := pairing.simulated) is not None:
                simulated = RecordedExperiment(design, pairing.sim, journals["sim"], SIMULATED_PER_REAL)
            recorded = RecordedExperiment(pairing.recorded, pairing.real, journals["real"])
            pairs = Pairs(simulated, recorded, watched="simulated")
            observe(search, pairing.recorded, pairs, options.watching)
    return conclude_gap(spec, search, journals, provenance, folder)
