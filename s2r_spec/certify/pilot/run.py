"""Run a pilot: rollouts that no certificate uses, from which a ``certify`` line is proposed.

The rollouts have seeds of their own (``SeedStream.PILOT``) and a journal like those of any run. A pilot of a gap has
one journal for each system, and runs ``SIMULATED_PER_REAL`` simulated rollouts for each real one, as the gap does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from s2r_spec.backend import Backend, HasRecordings, is_exclusive
from s2r_spec.base.distribution import version
from s2r_spec.base.errors import UsageError
from s2r_spec.base.json_types import Failures, Magnitude
from s2r_spec.base.json_values import Shown
from s2r_spec.certify.arguments import as_backend, as_spec, name_of, options_from
from s2r_spec.certify.from_spec import only_requirement, require_space
from s2r_spec.certify.options import Execution, ExecutionKeywords, require_begun, run_folder, with_seed
from s2r_spec.certify.pilot.design import PilotDesign, design
from s2r_spec.certify.pilot.proposal import Evidence, Outcomes, Proposal, propose, propose_fall
from s2r_spec.certify.result.search_result import by_query, rho_unit
from s2r_spec.certify.result.voids import machine_fields
from s2r_spec.certify.search.experiments import Rollouts
from s2r_spec.certify.search.observers import Phase
from s2r_spec.certify.search.pairing import SIMULATED_PER_REAL, Pairing
from s2r_spec.lang.certify_line import certify_line
from s2r_spec.machine.attendance import Terms, refuse_terms
from s2r_spec.machine.machine_runner import runner_for
from s2r_spec.runs.journal import Journal, Record
from s2r_spec.runs.layout import SYSTEMS
from s2r_spec.runs.scorer import Scorer
from s2r_spec.runs.seeds import SeedStream
from s2r_spec.runs.spec_files import PILOT, open_journal, with_fall
from s2r_spec.spec import CertifySettings, Spec

PLACEHOLDER = -1.0
"""Definition: ρ that the journal has for a failed rollout, if the spec declares none; the proposal replaces it."""


class PilotKeywords(ExecutionKeywords, total=False):
    """Keywords of :func:`pilot`; :class:`PilotOptions` describes them and has their defaults."""

    real: Backend | str | None
    requirement: str | None
    budget: int | None


@dataclass(frozen=True, kw_only=True)
class PilotOptions(Execution):
    """Options of a pilot, in addition to :class:`~s2r_spec.certify.options.Execution`.

    Args:
        real: the real machine, for a pilot of the gap; None for one backend alone.
        requirement: the name of the requirement; None if the specification has only one.
        budget: most rollouts, of the real machine in a gap; None for as many as the usual grid takes.
    """

    real: Backend | str | None = None
    requirement: str | None = None
    budget: int | None = None


@dataclass(frozen=True)
class PilotResult(Shown):
    """The result of a pilot.

    Attributes:
        requirement: the name of the requirement.
        line: the proposed certify line, as a specification has it.
        proposal: its settings and their reasons.
        unit: the unit of ρ; "" if it has none, or margins do not compare.
        backends: the name of the backend; of a gap, simulator and machine.
        layout: the layout of the tests.
        tests: the number of tests.
        rollouts: the number of rollouts, of all backends.
        failures: word for a failure → number of rollouts that ended with it.
        seconds: wall time of the rollouts [s].
        folder: the folder of the rollouts.
    """

    requirement: str
    line: str
    proposal: Proposal
    unit: str
    backends: tuple[str, ...]
    layout: str
    tests: int
    rollouts: int
    failures: Failures
    seconds: Magnitude
    folder: Path

    JSON = (
        "requirement line proposal unit backends layout tests rollouts failures seconds folder=folder.__str__"
    )


def pilot(
    spec: Spec | Path | str,
    backend: Backend | str,
    folder: Path | str | None = None,
    **keywords: Unpack[PilotKeywords],
) -> PilotResult:
    """Run a pilot over the spec's test space, and propose a certify line.

    Args:
        spec: a specification with a test space, or its file. Of its certify line only ``delta`` and ``fall`` are read.
        backend: a backend object, or the name of an installed one; the simulator of a gap.
        folder: the folder of the rollouts; by default a new one in ``s2r-runs``.
        keywords: see :class:`PilotOptions`; all of them may be left out.

    Raises:
        UsageError: spec and backends do not fit together, the budget is too small, or there is no run to resume.
        BackendError: a rollout raised; every rollout before it is on disk.
    """
    options = options_from(PilotOptions, keywords)
    spec, backend = as_spec(spec), as_backend(backend, "backend")
    real = None if options.real is None else as_backend(options.real, "real")
    requirement = options.requirement or only_requirement(spec)
    require_space(spec, requirement)
    names = [name_of(one) for one in (backend, real) if one is not None]
    with run_folder(folder, "-".join(["pilot", Path(spec.name).stem, *names]), options) as run:
        places = [run] if real is None else [run / side for side in SYSTEMS]
        if options.resume:
            require_begun(places, run)
        options = _resumed(with_seed(options, *places), places)
        tests = design(spec.space, options.budget)
        declared = spec.certify.get(requirement, CertifySettings())
        job = _Job(with_fall(spec, requirement, PLACEHOLDER), requirement, run, options, tests)
        journals = job.alone(backend) if real is None else job.paired(backend, real)
        return _conclude(job, declared, journals)


@dataclass(frozen=True)
class _Job:
    spec: Spec
    requirement: str
    folder: Path
    options: PilotOptions
    tests: PilotDesign

    def alone(self, backend: Backend | str) -> dict[str, Journal]:
        """Run the tests on one backend; return "" → its journal."""
        scorer = Scorer.for_spec(self.spec, self.requirement, backend)
        _refuse_recordings(scorer)
        header = self._header() | _system(scorer) | machine_fields(scorer, Terms().void)
        journal = open_journal(self.folder, header, self.spec, self.options.resume)
        self._run(scorer, journal, SeedStream.PILOT)
        return {"": journal}

    def paired(self, sim: Backend | str, real: Backend | str) -> dict[str, Journal]:
        """Run the tests on machine and simulator; return "sim" and "real" → their journals."""
        pairing = Pairing.for_spec(self.spec, self.requirement, sim, real, None)
        for scorer in pairing.scorers.values():
            _refuse_recordings(scorer)
        header = self._header() | {"simulated_per_real": SIMULATED_PER_REAL}
        for side, scorer in pairing.scorers.items():
            own = _system(scorer)
            header[side] = {key: own[key] for key in ("backend", "model_hash")}
            header[side] |= machine_fields(scorer, Terms().void)
        journals = {}
        for side, scorer in pairing.scorers.items():
            own = {"side": side, "backend": scorer.name, "duration": scorer.backend.duration}
            journals[side] = open_journal(self.folder / side, header | own, self.spec, self.options.resume)
        self._run(pairing.real, journals["real"], SeedStream.PILOT_REAL)
        self._run(pairing.sim, journals["sim"], SeedStream.PILOT, SIMULATED_PER_REAL)
        return journals

    def _header(self) -> dict[str, Any]:
        return {
            "s2r": version(),
            "spec": Path(self.spec.name).name,
            "spec_hash": self.spec.hash,
            "requirement": self.requirement,
            "seed": self.options.fixed_seed,
            PILOT: {"budget": self.options.budget, "fall": self.spec.certify[self.requirement].fall},
        }

    def _run(self, scorer: Scorer, journal: Journal, stream: SeedStream, each: int = 1) -> None:
        refuse_terms(scorer.backend, Terms())
        queries = self.tests.queries(self.spec.space)
        most = each * sum(query.replicates for query in queries)
        attended, watching = is_exclusive(scorer.backend), self.options.watching
        unit = rho_unit(self.spec, self.requirement)
        watching.begin(Phase("ρ", unit, scorer.name, self.spec.space.units, most, attended))
        with (
            self.options.runner(scorer.passed) as pool,
            runner_for(pool, scorer.backend, journal, Terms(), most) as runner,
        ):
            rollouts = Rollouts(scorer, self.options.fixed_seed, journal, runner, stream, each)
            rollouts.outcomes(queries, watching)


def _resumed(options: PilotOptions, places: Sequence[Path]) -> PilotOptions:
    """Return options with the budget of a resumed pilot; a UsageError refuses another one."""
    for place in places if options.resume else ():
        about = Journal.header_in(place).get(PILOT)
        if isinstance(about, dict):
            budget = about.get("budget")
            if options.budget not in (None, budget):
                raise UsageError(f"the pilot in {place} has the budget {budget}; leave the budget out")
            return replace(options, budget=budget)
    return options


def _refuse_recordings(scorer: Scorer) -> None:
    if isinstance(scorer.backend, HasRecordings):
        raise UsageError(
            f"{scorer.name} has recordings, and a pilot needs tests of its own: give a backend that runs rollouts"
        )


def _system(scorer: Scorer) -> dict[str, Any]:
    return {
        "backend": scorer.name,
        "model_hash": scorer.backend.model_hash,
        "duration": scorer.backend.duration,
    }


def _conclude(job: _Job, declared: CertifySettings, journals: Mapping[str, Journal]) -> PilotResult:
    records = {side: by_query(journal.records()) for side, journal in journals.items()}
    every = [record for groups in records.values() for group in groups for record in group]
    seen = np.array([record.rho for record in every if record.failure is None])
    fall = propose_fall(declared.fall, seen)
    unit = rho_unit(job.spec, job.requirement)
    names = {side: str(journal.header["backend"]) for side, journal in journals.items()}
    evidence = _evidence(job, {side: _outcomes(groups, fall) for side, groups in records.items()}, names)
    proposal = propose(evidence, declared, fall)
    params = [job.spec.params[name] for name in job.spec.space.names]
    units = [param.measure.difference.text for param in params]
    return PilotResult(
        job.requirement,
        certify_line(job.requirement, proposal.settings, units),
        proposal,
        unit,
        tuple(names.values()),
        job.tests.layout,
        len(job.tests.points),
        len(every),
        dict(Counter(record.failure for record in every if record.failure is not None)),
        sum(record.seconds for record in every),
        job.folder,
    )


def _evidence(job: _Job, outcomes: Mapping[str, Outcomes], names: Mapping[str, str]) -> Evidence:
    space, tests, unit = job.spec.space, job.tests, rho_unit(job.spec, job.requirement)
    if "" in outcomes:
        return Evidence(space, tests.points, tests.spacing, {"ρ": outcomes[""]}, None, unit)
    sim, real = outcomes["sim"], outcomes["real"]
    gaps = Outcomes(
        tuple(
            own - others.reshape(len(own), SIMULATED_PER_REAL).mean(axis=1)
            for own, others in zip(real.groups, sim.groups, strict=True)
        )
    )
    systems = {f"ρ of {names['sim']}": sim, f"ρ of {names['real']}": real}
    return Evidence(space, tests.points, tests.spacing, systems, gaps, unit)


def _outcomes(groups: Sequence[Sequence[Record]], fall: float) -> Outcomes:
    return Outcomes(
        tuple(np.array([one.rho if one.failure is None else fall for one in group]) for group in groups),
        sum(record.failure is not None for group in groups for record in group),
    )
