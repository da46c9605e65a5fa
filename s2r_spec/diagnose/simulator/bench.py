"""Rollouts for the diagnosis: many machines, many tests, reduced to numbers where they are made."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.backend import Backend, Effect, HasDuration, HasEffects, HasVariants, is_exclusive, load_backend
from s2r_spec.backend.effects import catalogue_of
from s2r_spec.backend.files import pack
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.documentation import page
from s2r_spec.base.errors import BackendError, UsageError
from s2r_spec.diagnose.simulator.axes import Values
from s2r_spec.diagnose.simulator.experiments import with_residuals
from s2r_spec.diagnose.simulator.runs import each
from s2r_spec.runs.compatibility import Interface, check_compatibility
from s2r_spec.runs.scorer import adapt_to_spec
from s2r_spec.runs.seeds import SeedStream, rollout_seed
from s2r_spec.space import Key, key_of
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import ExecutorFactory

Test = Mapping[str, float]
TestRun = tuple[Test, Trace]
Progress = Callable[[int, int], None]
"""Called with how many jobs are done, and of how many."""


@dataclass(frozen=True)
class Bench:
    """A simulator with a spec set up on it, and where its rollouts run.

    Attributes:
        backend: nominal.
        spec, requirement: what is required of it.
        matched: how the spec's tests become the backend's.
        pool: of the rollouts; None runs them in this process.
        progress: of their jobs; without it, :data:`WATCH` counts rollouts.
    """

    backend: Backend
    spec: Spec
    requirement: str
    matched: Interface
    pool: ExecutorFactory | None = None
    progress: Progress | None = None

    @classmethod
    def of(cls, spec: Spec, requirement: str, simulator: Backend | str) -> Bench:
        """Set a spec up on a simulator.

        Raises:
            UsageError: the simulator declares no effects, or lacks what the spec needs.
            BackendError: two of its effects have one name.
        """
        backend = load_backend(simulator) if isinstance(simulator, str) else simulator
        refuse_machine(backend)
        horizon = spec.horizon(requirement)
        if isinstance(backend, HasDuration) and math.isfinite(horizon) and horizon > 0:
            backend = backend.with_duration(horizon)
        _refuse_same_names(backend.name, catalogue_of(backend))
        backend = adapt_to_spec(backend, spec, requirement)
        return cls(backend, spec, requirement, check_compatibility(spec, requirement, backend))

    def with_effects(self, values: Values) -> Backend:
        """Return the backend with these effects; the same one for none."""
        if not values:
            return self.backend
        if not isinstance(self.backend, HasEffects):
            raise UsageError(
                f"the backend {self.backend.name!r} declares no effects, so no cause can be found; see "
                f"{page('how-to/effects')}"
            )
        patched: Backend = self.backend.with_effects(values)
        return patched

    def run(self, values: Values, test: Test, seed: int) -> Trace:
        """Run one test with these effects added.

        Raises:
            BackendError: the backend raised; the sentence names the effects and the test.
        """
        with name_rollout(self, values, test, seed):
            return self.with_effects(values).rollout(self.matched.to_backend(test), seed)

    def rho(self, trace: Trace, test: Test) -> float:
        """Return ρ; a trace that failed has the value that the spec declares for it."""
        return float(self.spec.robustness(trace, params=dict(test), only=self.requirement)[self.requirement])

    def seen(self, trace: Trace, test: Test) -> Trace:
        """Return the trace with the residuals of the nominal model beside its channels."""
        return with_residuals(trace, self.backend, self.matched.to_backend(test))


def places_of(tests: Sequence[Test]) -> dict[Key, list[int]]:
    """Return the places of every different test, in the order of the first of each."""
    places: dict[Key, list[int]] = {}
    for place, test in enumerate(tests):
        places.setdefault(key_of(test), []).append(place)
    return places


def evenly(count: int, most: int) -> list[int]:
    """Return at most so many places of ``count``, evenly from the first to the last."""
    places: list[int] = np.linspace(0, count - 1, min(most, count)).round().astype(int).tolist()
    return places


def refuse_machine(backend: object) -> None:
    """Refuse a machine whose rollouts need an operator, by a UsageError."""
    if is_exclusive(backend):
        name = getattr(backend, "name", "this backend")
        raise UsageError(
            f"{name} is a machine, and its rollouts need an operator; diagnose its recordings with --real log:FOLDER"
        )


def _refuse_same_names(backend: str, effects: Sequence[Effect]) -> None:
    named = {"effects": [effect.name for effect in effects]}
    for effect in effects:
        named[f"parameters of the effect {effect.name!r}"] = [p.name for p in effect.parameters]
    for what, among in named.items():
        if twice := [name for n, name in enumerate(among) if name in among[:n]]:
            raise BackendError(
                f"backend {backend!r} has two {what} named {twice[0]!r}; give each its own name"
            )


@dataclass(frozen=True)
class Job:
    """Rollouts of one modified simulator."""

    values: Values
    runs: tuple[tuple[Test, int], ...]
    """(test, seed) each."""
    variant: str = ""
    """Of the simulator, where it is not the simulator itself that runs."""


WATCH: ContextVar[Callable[[int], None]] = ContextVar("watch", default=lambda rollouts: None)
"""Definition: what counts the rollouts that are run for a stage with no count of its own."""

Read = Callable[[Bench, Trace, Test], FloatArray]
"""From a rollout to one row of numbers."""


def rho_and_end(bench: Bench, trace: Trace, test: Test) -> FloatArray:
    """Return (2,): ρ, and whether the rollout ended early."""
    return np.array([bench.rho(trace, test), float(trace.failure is not None)])


def run_job(bench: Bench, job: Job, read: Read = rho_and_end) -> FloatArray:
    """Return (runs, n) the row of each rollout.

    Raises:
        BackendError: the backend raised; the sentence names the effects and the test.
    """
    backend = bench.with_effects(job.values)
    if job.variant:
        assert isinstance(bench.backend, HasVariants)
        backend = bench.backend.variants()[job.variant]
    rows = []
    for test, seed in job.runs:
        with name_rollout(bench, job.values, test, seed):
            rows.append(read(bench, backend.rollout(bench.matched.to_backend(test), seed), test))
    return np.array(rows)


@contextmanager
def name_rollout(bench: Bench, values: Values, test: Test, seed: int) -> Iterator[None]:
    """Say which rollout it was that raised.

    Raises:
        BackendError: in place of any error; the sentence names the effects and the test.
    """
    try:
        yield
    except Exception as error:
        raise BackendError(
            f"backend {bench.backend.name!r} with {dict(values)}, at {dict(test)}, seed {seed}: {error}; "
            f"end a rollout that cannot continue with meta['failure'], or narrow the effect's range "
            f"({page('how-to/effects')})"
        ) from None


def _numbered(bench: Bench, number: int, job: Job, read: Read) -> FloatArray:
    del number
    return run_job(bench, job, read)


def run_jobs(bench: Bench, jobs: Sequence[Job], read: Read = rho_and_end) -> list[FloatArray]:
    """Return :func:`run_job` of each job, in their order; ``read`` is a function that another process can be sent.

    Raises:
        BackendError: a rollout raised, or a worker died.
    """
    results: dict[int, FloatArray] = {}
    pool = bench.pool if len(jobs) > 1 else None
    numbered = {index: (job, read) for index, job in enumerate(jobs)}
    what = f"simulated effects on backend {bench.backend.name!r}"
    for index, rows in each(replace(bench, pool=None, progress=None), _numbered, numbered, pool, what):
        results[index] = rows
        if bench.progress is not None:
            bench.progress(len(results), len(jobs))
        else:
            WATCH.get()(len(jobs[index].runs))
    return [results[index] for index in range(len(jobs))]


def with_seeds(
    tests: Sequence[Test], seed: int, stream: SeedStream, shots: int = 1
) -> tuple[tuple[Test, int], ...]:
    """Return (test, seed) of so many rollouts of every test, one test after the other."""
    every = [(n, test, shot) for n, test in enumerate(tests) for shot in range(shots)]
    return tuple((test, rollout_seed(seed, n, shot, stream)) for n, test, shot in every)


def table(bench: Bench, machines: Sequence[Values], runs: Sequence[tuple[Test, int]]) -> FloatArray:
    """Return (2, machines, runs) ρ and whether it ended early, of every machine in every run, a job each."""
    rows = run_jobs(bench, [Job(values, (run,)) for values in machines for run in runs])
    return np.array(rows).reshape(len(machines), len(runs), -1).transpose(2, 0, 1)


def travels(bench: Bench) -> bool:
    """Return whether another process can be sent the simulator."""
    try:
        pack(replace(bench, pool=None, progress=None))
    except Exception:
        return False
    return True
