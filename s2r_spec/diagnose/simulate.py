"""Rollouts for the diagnosis: many effects, many tests, reduced to numbers where they are made."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, as_completed
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasEffects, HasVariants
from s2r_spec.diagnose.axes import Values
from s2r_spec.diagnose.equations import Instruments
from s2r_spec.diagnose.features import Features
from s2r_spec.diagnose.simulator.experiments import with_residuals
from s2r_spec.documentation import page
from s2r_spec.errors import BackendError, UsageError
from s2r_spec.rollouts.compatibility import Interface
from s2r_spec.space import key_of
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Test = Mapping[str, float]

INSTRUMENT_SEEDS = (2_000_003, 2_000_004, 2_000_005)
"""Of rollouts that are instruments: no other rollout of a simulator has these."""

A_READING = 3e-4
"""[s] of one core that the residuals of a rollout take, about. They are asked for once, and once for every effect."""


class _Kept(dict[tuple[tuple[str, float], ...], Instruments | None]):
    """Instruments that were made in this process; they are not sent to another."""

    def __reduce__(self) -> tuple[type[_Kept], tuple[()]]:
        return _Kept, ()


@dataclass(frozen=True)
class Bench:
    """A simulator with a spec set up on it: all that a worker needs.

    Attributes:
        backend: nominal.
        spec: with the requirement.
        requirement: its name.
        matched: how the spec's tests become the backend's.
        features: what is computed from a trace; None for ρ alone.
    """

    backend: Backend
    spec: Spec
    requirement: str
    matched: Interface
    features: Features | None = None
    _kept: _Kept = field(default_factory=_Kept, init=False, repr=False, compare=False)

    @property
    def cost(self) -> float:
        """Expected time on one core [s] of a rollout, as the backend has it, and of what is measured of it."""
        readings = 0 if self.features is None else 1 + len(self.features.probes)
        return max(float(self.backend.cost), 1e-4) + A_READING * readings

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

    def with_variant(self, name: str) -> Backend:
        """Return the same simulator, computed otherwise."""
        assert isinstance(self.backend, HasVariants)
        return self.backend.variants()[name]

    def run(self, values: Values, test: Test, seed: int) -> Trace:
        """Run one test with these effects added."""
        return self.with_effects(values).rollout(self.matched.to_backend(test), seed)

    def rho(self, trace: Trace, test: Test) -> float:
        """Return ρ; a trace that failed has the value that the spec declares for it."""
        return float(self.spec.robustness(trace, params=dict(test), only=self.requirement)[self.requirement])

    def seen(self, trace: Trace, test: Test) -> Trace:
        """Return the trace with the residuals of the nominal model beside its channels."""
        return with_residuals(trace, self.backend, self.matched.to_backend(test))

    def measure(self, trace: Trace, test: Test, extra: Test | None = None) -> FloatArray:
        """Return (p + 1,): ρ, then the features.

        Args:
            trace: a rollout.
            test: in the spec's units.
            extra: parameters of the backend that the spec does not sweep, in its units, where they were not usual.
        """
        rho = self.rho(trace, test)
        if self.features is None:
            return np.array([rho])
        params = {**self.matched.to_backend(test), **(extra or {})}
        equations = self.features.equations(trace, self.backend, params, self.instruments(test))
        seen = with_residuals(trace, self.backend, params)
        return np.concatenate([[rho], self.features.vector(seen), equations])

    def unexplained(self, trace: Trace, test: Test) -> float:
        """Return the mean square that no effect's equations explain of the nominal residuals; NaN if none is asked."""
        if self.features is None or not self.features.probes:
            return float("nan")
        asked = self.features.asked(self.backend)
        return asked.unexplained(trace, self.matched.to_backend(test), self.instruments(test))

    def instruments(self, test: Test) -> Instruments | None:
        """Return the instruments at a test, made once in a process; None where they are not used."""
        if self.features is None or not self.features.instrumented:
            return None
        place = key_of(test)
        if place not in self._kept:
            self._kept[place] = self.nominal_motion(self.features, test)
        return self._kept[place]

    def weights(self, tests: Sequence[Test]) -> FloatArray:
        """Return (tests, p, p) by which coordinates that the equations ask for count; 1 where all count alike."""
        probes = () if self.features is None else self.features.probes
        found = [self.instruments(test) for test in tests]
        return np.array([np.eye(len(probes)) if each is None else each.weight for each in found])

    def nominal_motion(self, features: Features, test: Test) -> Instruments | None:
        """Return the regressors of the nominal simulator at a test."""
        traces = []
        for seed in INSTRUMENT_SEEDS:
            with blamed(self, {}, test, seed):
                traces.append(self.run({}, test, seed))
        return features.asked(self.backend).instruments(traces, self.matched.to_backend(test))


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
"""What is kept of a rollout: one row of numbers."""


def run_job(bench: Bench, job: Job, read: Read = Bench.measure) -> FloatArray:
    """Return (runs, p + 1) of :meth:`Bench.measure`, or what else is read of each rollout.

    Raises:
        BackendError: the backend raised; the sentence names the effects and the test.
    """
    backend = bench.with_variant(job.variant) if job.variant else bench.with_effects(job.values)
    rows = []
    for test, seed in job.runs:
        with blamed(bench, job.values, test, seed):
            rows.append(read(bench, backend.rollout(bench.matched.to_backend(test), seed), test))
    return np.array(rows)


@contextmanager
def blamed(bench: Bench, values: Values, test: Test, seed: int) -> Iterator[None]:
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


def _run_pickled(bench: bytes, job: Job, read: Read) -> FloatArray:
    """In a worker: the bench is unpickled once, and known by its bytes."""
    return run_job(_unpickled(bench), job, read)


_KNOWN: dict[bytes, Bench] = {}


def _unpickled(bench: bytes) -> Bench:
    if bench not in _KNOWN:
        _KNOWN.clear()
        _KNOWN[bench] = pickle.loads(bench)
    return _KNOWN[bench]


def run_jobs(
    bench: Bench,
    jobs: Sequence[Job],
    executor: Callable[[], Executor] | None = None,
    progress: Callable[[int, int], None] | None = None,
    read: Read = Bench.measure,
) -> list[FloatArray]:
    """Return :func:`run_job` of each job, in their order.

    Args:
        bench: see there.
        jobs: see there.
        executor: makes a pool; None runs everything in this process.
        progress: called with how many jobs are done, and of how many; if not given, :data:`WATCH` counts rollouts.
        read: see there; a function that another process can be sent.

    Raises:
        BackendError: a rollout raised, or a worker died.
    """
    results: dict[int, FloatArray] = {}
    for index, rows in _outcomes(bench, jobs, executor, read):
        results[index] = rows
        if progress is not None:
            progress(len(results), len(jobs))
        else:
            WATCH.get()(len(jobs[index].runs))
    return [results[index] for index in range(len(jobs))]


def _outcomes(
    bench: Bench, jobs: Sequence[Job], executor: Callable[[], Executor] | None, read: Read
) -> Iterator[tuple[int, FloatArray]]:
    pickled = None if executor is None else _pickled(bench)
    if executor is None or pickled is None or len(jobs) < 2:
        for index, job in enumerate(jobs):
            yield index, run_job(bench, job, read)
        return
    with executor() as pool:
        futures = {pool.submit(_run_pickled, pickled, job, read): index for index, job in enumerate(jobs)}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenExecutor:
            raise BackendError(
                f"a worker died while it simulated effects on backend {bench.backend.name!r}; "
                f"run it again with --workers 1 to see the test that kills it"
            ) from None
        finally:
            for future in futures:
                future.cancel()


def _pickled(bench: Bench) -> bytes | None:
    """Return the bench as bytes; None for a backend that only lives in this process."""
    try:
        return pickle.dumps(bench)
    except Exception:
        return None
