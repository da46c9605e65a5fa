"""Search 1: a certified bound on the worst expected robustness over the test space.

The search maximises −ρ; what it asks for goes to the backend, every rollout goes
to the journal first, and only then to the search.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np

from s2r_spec.backend import HasRecordings, Operator, is_exclusive
from s2r_spec.certify.certificate import Certificate, Label
from s2r_spec.certify.drive import Observer, Phase, Rollouts, drive
from s2r_spec.certify.given import given_folder, given_name, given_spec, must_be_begun
from s2r_spec.certify.kernels import Kernel
from s2r_spec.certify.outward import at_most
from s2r_spec.certify.recorded import Recorded, fixed_design, left_open, observe
from s2r_spec.certify.search import Search
from s2r_spec.certify.voids import about, assumed, counted, is_machine, with_voids, without_too_many
from s2r_spec.errors import UsageError, one_of
from s2r_spec.rollouts.attempts import AGAIN
from s2r_spec.rollouts.attendance import Terms, refuse_terms, terms_of
from s2r_spec.rollouts.attended import attending
from s2r_spec.rollouts.journal import Journal, Record
from s2r_spec.rollouts.kept import files_of
from s2r_spec.rollouts.pools import ExecutorFactory, process_pool
from s2r_spec.rollouts.rig import Rig
from s2r_spec.rollouts.runner import Runner
from s2r_spec.spec import CertifySettings, Spec


class Verdict(Enum):
    """What a check found; the value is the word, the exit code follows the command line's contract."""

    HOLDS = "holds"
    VIOLATED = "violated"
    UNKNOWN = "unknown"

    @property
    def exit_code(self) -> Literal[0, 1, 3]:
        """0 holds, 1 violated, 3 unknown."""
        return 0 if self is Verdict.HOLDS else 1 if self is Verdict.VIOLATED else 3


@dataclass(frozen=True)
class Tested:
    """All rollouts at one test point."""

    params: dict[str, float]
    rollouts: int
    mean: float
    lowest: float
    highest: float


@dataclass(frozen=True)
class CheckResult:
    """The worst expected robustness ρ̂* = min over D of E ρ lies in [lower, upper] with probability ≥ 1 − δ.

    Attributes:
        requirement: its name in the spec.
        verdict: see :class:`Verdict`; never HOLDS or VIOLATED for a refused certificate.
        reason: one sentence for the verdict.
        lower: certified lower bound, in ``unit``.
        upper: certified upper bound.
        unit: of ρ; "" when the requirement mixes units.
        worst: the tested point nearest to the one that bounds the worst expected ρ from above.
        lowest: the rollout of the smallest ρ.
        failures: how often the robot fell or the worker died, by word.
        assumptions: each in one sentence.
        certificate: of the search, which maximises −ρ.
        provenance: version, spec and model hashes, seed.
        folder: where the rollouts lie.
        seconds: that the rollouts took, all workers and all resumed processes added up.
        voids: of a machine, how many rollouts were void, by word; None of what is none.
    """

    requirement: str
    verdict: Verdict
    reason: str
    lower: float
    upper: float
    unit: str
    worst: Tested
    lowest: Record
    failures: dict[str, int]
    assumptions: tuple[str, ...]
    certificate: Certificate
    provenance: dict[str, Any]
    folder: Path
    seconds: float
    voids: dict[str, int] | None = None


def search_for(
    spec: Spec,
    requirement: str,
    *,
    seed: int,
    budget: int | None,
    mode: str,
    engine: str,
    noise: float = 1.0,
) -> Search:
    """Build the search that the spec's certify line declares; ``noise`` multiplies its R.

    Raises:
        UsageError: the requirement is unknown, or its certify line lacks a setting.
    """
    if requirement not in spec.requirements:
        raise UsageError(
            f"{spec.name} has no requirement {requirement!r}; it has {one_of(spec.requirements)}"
        )
    if not spec.space.dim:
        raise UsageError(
            f"{spec.name} has no test space: declare a parameter with a range, "
            f"for example  param vd {{m/s}} in [-0.2, 0.3]"
        )
    settings = spec.certify.get(requirement, CertifySettings())
    delta, epsilon, B, R = settings.delta, settings.epsilon, settings.B, settings.R
    kernel = settings.kernel
    if delta is None or epsilon is None or B is None or R is None or kernel is None or settings.fall is None:
        wanted = ("delta", "epsilon", "B", "R", "kernel", "fall")
        lacking = [name for name in wanted if getattr(settings, name) is None]
        raise UsageError(
            f"the certificate of {requirement!r} needs {', '.join(lacking)}, declared before the data "
            f"in a line 'certify {requirement}: {lacking[0]} = …' of {spec.name}"
        )
    return Search(
        spec.space,
        kernel=Kernel(kernel.name, kernel.lengthscales),
        B=B,
        R=R * noise,
        delta=delta,
        epsilon=epsilon,
        seed=seed,
        budget=budget,
        mode=mode,
        engine=engine,
        unit=rho_unit(spec, requirement),
    )


def rho_unit(spec: Spec, requirement: str) -> str:
    """Return the unit of ρ, "" when the requirement mixes margins that do not compare."""
    unit = spec.unit(requirement)
    return "" if unit == "mixed" else unit


def check(
    spec: Spec,
    backend: str,
    folder: Path | str,
    *,
    requirement: str | None = None,
    seed: int = 0,
    budget: int | None = None,
    mode: str = "rigorous",
    engine: str = "spectral",
    executor: ExecutorFactory | None = None,
    timeout: float | None = None,
    resume: bool = False,
    observer: Observer | None = None,
    void: str = AGAIN,
    operator: Operator | None = None,
) -> CheckResult:
    """Certify the worst expected robustness of one requirement over the spec's test space.

    Args:
        spec: with a test space and a certify line.
        backend: its name; it is opened in every worker.
        folder: of the journal and the traces.
        requirement: may be left out when the spec has one.
        seed: of the whole run.
        budget: most rollouts; None for as many as the spec's ε takes.
        mode: of the confidence set, see :class:`Search`.
        engine: of the Gaussian process, see :class:`Search`.
        executor: makes the pool; two local processes by default.
        timeout: a rollout that takes longer is ended, and counts as a crash [s]; ``inf`` for never, None for
            :func:`s2r_spec.rollouts.rig.default_timeout`.
        resume: go on with the run in ``folder``.
        observer: is told of batches and rollouts.
        void: of a machine, what becomes of a rollout that the robot did not end: "again" for the same test once
            more, "fall" to count it as a fall.
        operator: of a machine, who is asked; the person at this process's terminal if None.

    Raises:
        UsageError: the spec, the backend and the folder do not fit together, or there is no run to resume.
        BackendError: a rollout raised; all that came before is in the journal.
    """
    spec, backend, folder = given_spec(spec), given_name(backend), given_folder(folder)
    requirement = requirement or only_requirement(spec)
    if resume:
        must_be_begun([folder], folder)
    search = search_for(spec, requirement, seed=seed, budget=budget, mode=mode, engine=engine)
    terms = terms_of(void, operator)
    return check_with(
        search, spec, requirement, backend, folder, seed, executor, timeout, resume, observer, terms
    )


def check_with(
    search: Search,
    spec: Spec,
    requirement: str,
    backend: str,
    folder: Path,
    seed: int,
    executor: ExecutorFactory | None,
    timeout: float | None,
    resume: bool,
    observer: Observer | None,
    terms: Terms | None = None,
) -> CheckResult:
    """Run a search for the worst expected robustness to its end; see :func:`check`."""
    rig, terms = Rig.for_spec(spec, requirement, backend), terms or Terms()
    refuse_terms(rig.backend, terms)
    design = None
    if isinstance(rig.backend, HasRecordings):
        if search.budget is not None:
            raise UsageError(f"a budget does not apply to {backend}: it has the recordings that it has")
        design = fixed_design(spec, requirement, rig.backend, rig.backend.recordings)
    else:
        search.refuse_hopeless()
    provenance = {
        "s2r": version("s2r"),
        "spec": Path(spec.name).name,
        "spec_hash": spec.hash,
        "requirement": requirement,
        "backend": backend,
        "model_hash": rig.backend.model_hash,
        "duration": rig.backend.duration,
        "seed": seed,
        "settings": search.certificate().settings,
    }
    if design is not None:
        provenance["recorded"] = list(design.notes)
    provenance |= about(rig.backend, terms.void)
    if resume and Journal.begun(folder):
        journal = Journal.resume(folder, provenance)
    else:
        journal = Journal.create(folder, provenance, files_of(spec))
    if observer is not None:
        unit = rho_unit(spec, requirement)
        attended = is_exclusive(rig.backend)
        observer.begin(Phase("ρ", unit, backend, spec.space.units, search.budget, attended))
    if design is not None:
        observe(search, design, Recorded(design, rig, journal), observer)
    else:
        with (
            Runner(executor or process_pool(2), timeout) as pool,
            attending(pool, rig.backend, journal, terms, search.budget) as runner,
        ):
            drive(search, Rollouts(rig, seed, journal, runner), observer)
    result = conclude(spec, requirement, rig.fall, search.certificate(), journal, provenance)
    return result if design is None else of_recordings(result, design.notes, search)


def only_requirement(spec: Spec) -> str:
    """Return the spec's one requirement, or say that a name is needed."""
    if len(spec.requirements) != 1:
        raise UsageError(f"{spec.name} has several requirements ({one_of(spec.requirements)}): name one")
    return spec.requirements[0]


def conclude(
    spec: Spec,
    requirement: str,
    fall: float,
    certificate: Certificate,
    journal: Journal,
    provenance: dict[str, Any],
) -> CheckResult:
    """Return what a search that was told all of a journal means for the requirement."""
    records, backend = journal.records(), provenance["backend"]
    certificate = without_too_many(certificate, backend, journal)
    failures = Counter(record.failure for record in records if record.failure is not None)
    lower, upper = -certificate.upper, -certificate.lower
    unit = rho_unit(spec, requirement)
    verdict, reason = _judge(certificate, lower, upper)
    assumptions = (
        *(
            with_voids(text.replace("the expected outcome", "the expected robustness E ρ"), provenance)
            for text in certificate.assumptions
        ),
        f"a rollout that falls or crashes counts as ρ = {fall:g} {unit}".rstrip() + ", as the spec declares",
        *assumed(backend, provenance, journal),
        "the statement is about this machine's expected ρ, as it was during these rollouts"
        if is_machine(provenance)
        else "the statement is about this backend's expected ρ over its own noise; the real machine is search 2",
    )
    return CheckResult(
        requirement=requirement,
        verdict=verdict,
        reason=reason,
        lower=lower,
        upper=upper,
        unit=unit,
        worst=min(tested(records), key=lambda test: distance(spec, test.params, certificate.worst)),
        lowest=min(records, key=lambda record: record.rho),
        failures=dict(failures),
        assumptions=assumptions,
        certificate=certificate,
        provenance=provenance,
        folder=journal.folder,
        seconds=sum(record.seconds for record in records),
        voids=counted(journal) if is_machine(provenance) else None,
    )


def of_recordings(result: CheckResult, notes: Sequence[str], search: Search) -> CheckResult:
    """Say what a result of recordings rests on, and what the recorded tests cannot certify.

    Args:
        result: from :func:`conclude`.
        notes: of the :class:`Design`.
        search: that was told them.
    """
    certificate, reason = result.certificate, result.reason
    if result.verdict is Verdict.UNKNOWN and certificate.label is not Label.REFUSED:
        reason = f"the interval contains 0 after {certificate.rollouts} recorded rollouts"
    if certificate.label is Label.BUDGET:
        where = ", ".join(f"{name} = {value:.4g}" for name, value in search.suggestion.items())
        reason += (
            f"; the recorded tests certify no more than an interval {at_most(certificate.epsilon)} wide "
            f"(ε = {certificate.target:g} was asked), and a further test would tell most at {where}"
        )
    *assumptions, _ = result.assumptions
    about = "the statement is about the machine as it was when it was recorded"
    notes = [*notes, *left_open(search, "E ρ")]
    return replace(result, reason=reason, assumptions=(*assumptions, about, *notes))


def tested(records: Sequence[Record]) -> list[Tested]:
    """Group rollouts by test point."""
    groups: dict[tuple[float, ...], list[Record]] = {}
    for record in records:
        groups.setdefault(tuple(record.params.values()), []).append(record)
    return [
        Tested(
            params=group[0].params,
            rollouts=len(group),
            mean=float(np.mean([record.rho for record in group])),
            lowest=min(record.rho for record in group),
            highest=max(record.rho for record in group),
        )
        for group in groups.values()
    ]


def distance(spec: Spec, left: Mapping[str, float], right: Mapping[str, float]) -> float:
    """Distance of two tests as a share of the test space's width, on the axis where it is largest."""
    return max(abs(left[axis.name] - right[axis.name]) / axis.width for axis in spec.space.axes)


def _judge(certificate: Certificate, lower: float, upper: float) -> tuple[Verdict, str]:
    if not certificate.label.bounds:
        return Verdict.UNKNOWN, f"no certificate: {certificate.reason}"
    if lower >= 0:
        return Verdict.HOLDS, "the worst expected robustness is not negative"
    if upper < 0:
        return Verdict.VIOLATED, "the worst expected robustness is negative"
    way = "a larger budget" if certificate.label is Label.BUDGET else "a smaller epsilon in its certify line"
    return Verdict.UNKNOWN, (
        f"the interval contains 0 after {certificate.rollouts} rollouts; {way} may decide it"
    )
