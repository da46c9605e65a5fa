"""Runs of the simulator, reduced to observables where they are made, and kept as they end.

What is kept of an experiment is one file: its observables, and a row of them for each run, with ρ of each requirement
that was asked for (:mod:`.score`). A response is computed from rows, so a library that needs further runs finds the
earlier ones there, and so does one that was killed.

Shapes: m observables.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasEffects, HasVariants
from s2r_spec.backend.effects import catalogue_of
from s2r_spec.backend.files import pack, unpack
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import BackendError
from s2r_spec.diagnose.simulator.axes import EffectAxis, Values, effect_axes, effect_axis
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.innovations import Innovations
from s2r_spec.diagnose.simulator.observables import Observables, ObservedQuantity
from s2r_spec.diagnose.simulator.practice import healthy_machine
from s2r_spec.diagnose.simulator.response import values_at
from s2r_spec.diagnose.simulator.score import UNKNOWN, Score
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import ExecutorFactory, as_they_end

K = TypeVar("K")
T = TypeVar("T")

PILOT = 4
"""Budget: nominal runs that decide which observables there are."""
HEALTHY = 8
"""Budget: healthy machines that decide whether traces agree in time. With a few, a gait may agree by chance."""
SEED = 1_000
"""Definition: seed of the first run; no rollout of a certificate has it."""
EVERY = 20.0
"""Budget: time between two savings of an experiment's runs [s]; a killed process loses at most the runs since."""

Rows = NDArray[np.float32]
"""(runs, m) observables of runs; NaN where a run ended before."""
SCORES = "score "
"""Definition: prefix of the arrays of ρ in a file, before the key of the requirement."""


@dataclass(frozen=True)
class Job:
    """Runs of one experiment on one machine."""

    values: tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
    variant: str
    seeds: tuple[int, ...]

    @classmethod
    def of(cls, values: Values, runs: int, variant: str = "", first: int = 0) -> Job:
        """Return runs with seeds in a row; the first of all has the number 0."""
        frozen = tuple((effect, tuple(sorted(own.items()))) for effect, own in sorted(values.items()))
        return cls(frozen, variant, tuple(range(SEED + first, SEED + first + runs)))

    @property
    def alone(self) -> bool:
        """Whether it has one effect, or none."""
        return len(self.values) < 2 and not self.variant


NOMINAL_PILOT = Job.of({}, PILOT)
"""Definition: the runs that decide the observables."""


@dataclass
class Runs:
    """What was run of one experiment: its observables, and the rows of every job. It grows.

    Attributes:
        scores: key of a requirement → (runs, 2) ρ of the runs of each job, and whether they ended early.
    """

    observables: Observables
    rows: dict[Job, Rows] = field(default_factory=dict)
    scores: dict[str, dict[Job, FloatArray]] = field(default_factory=dict)

    def lacks(self, job: Job, score: Score | None = None) -> bool:
        """Return whether a job was not run, or is of one effect and was run without ρ of a requirement."""
        return job not in self.rows or (
            score is not None and job.alone and job not in self.scores.get(score.key, ())
        )

    def add(self, job: Job, rows: Rows, scores: FloatArray, score: Score | None) -> None:
        """Take the rows and the scores of a job."""
        self.rows[job] = rows
        if score is not None:
            self.scores.setdefault(score.key, {})[job] = scores

    def save(self, path: Path) -> None:
        """Write it as NPZ."""
        o = self.observables
        header = {
            "duration": o.duration,
            "flags": o.flags,
            "clocked": o.clocked,
            "quantities": [(q.name, q.channel, q.minus, q.scale.tolist()) for q in o.quantities],
            "innovations": o.innovations.to_json() if o.innovations else None,
            "jobs": [(job.values, job.variant, job.seeds) for job in self.rows],
        }
        rows = np.concatenate([*self.rows.values(), np.zeros((0, o.size), dtype=np.float32)])
        scores = {
            SCORES + key: np.concatenate([own.get(job, [UNKNOWN] * len(job.seeds)) for job in self.rows])
            for key, own in self.scores.items()
        }
        np.savez_compressed(path, header=np.array(json.dumps(header)), rows=rows, **scores)  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: Path) -> Runs:
        """Read it as data.

        Raises:
            Exception: of any kind, if it is not what :meth:`save` writes.
        """
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            header, rows = json.loads(str(arrays["header"])), np.asarray(arrays["rows"], dtype=np.float32)
            scores = {name.removeprefix(SCORES): arrays[name] for name in arrays if name.startswith(SCORES)}
        quantities = tuple(
            ObservedQuantity(name, channel, minus, np.array(scale))
            for name, channel, minus, scale in header["quantities"]
        )
        flags = tuple((name, int(width)) for name, width in header["flags"])
        stored = header["innovations"]
        innovations = Innovations.from_json(stored) if stored else None
        duration, clocked = float(header["duration"]), bool(header["clocked"])
        runs = cls(Observables(duration, quantities, flags, clocked, innovations))
        jobs = [
            Job.of({effect: dict(own) for effect, own in values}, len(seeds), variant, seeds[0] - SEED)
            for values, variant, seeds in header["jobs"]
        ]
        ends = np.cumsum([len(job.seeds) for job in jobs])
        if rows.shape != (ends[-1], runs.observables.size):
            raise ValueError("the rows do not fit the observables and the jobs")
        runs.rows = dict(zip(jobs, np.split(rows, ends[:-1]), strict=True))
        for key, values in scores.items():
            own = zip(jobs, np.split(values, ends[:-1]), strict=True)
            runs.scores[key] = {job: row for job, row in own if not np.isnan(row[:, 1]).any()}
        return runs


class NominalError(BackendError):
    """A nominal run of the simulator fails, so it has no responses.

    Attributes:
        where: the experiment and the failure, in words.
    """

    def __init__(self, message: str, where: str = "") -> None:
        super().__init__(message)
        self.where = where


def kept(cache: Cache, places: Mapping[Experiment, str]) -> dict[Experiment, Runs]:
    """Return the runs that a cache has, from experiment → file below its folder."""
    found = {experiment: cache.read(place, Runs.load) for experiment, place in places.items()}
    return {experiment: runs for experiment, runs in found.items() if runs is not None}


def simulate(
    backend: Backend,
    wanted: Mapping[Experiment, Sequence[Job]],
    places: Mapping[Experiment, str],
    cache: Cache,
    executor: ExecutorFactory | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
    score: Score | None = None,
) -> dict[Experiment, Runs]:
    """Return the runs of all wanted jobs: those that the cache has, and the rest, which runs now and is kept.

    With a score, every run has one, and a job of one effect that the cache has without it runs again.

    The experiments run one after the other, the longest first, so that most are whole early and no worker waits at the
    end.

    Raises:
        BackendError: a nominal run fails, or a worker dies.
    """
    every = kept(cache, places)
    needed = {experiment: None if experiment.protocol else score for experiment in wanted}
    missing = {
        e: [j for j in jobs if e not in every or every[e].lacks(j, needed[e])] for e, jobs in wanted.items()
    }
    new = {experiment: (needed[experiment],) for experiment in wanted if experiment not in every}
    what, of = f"simulated effects on backend {backend.name!r}", sum(map(len, missing.values()))
    done, file = 0, _Files(cache, places, every)

    def length(experiment: Experiment) -> float:
        return every[experiment].observables.duration * sum(len(job.seeds) for job in missing[experiment])

    with file.saving():
        for experiment, runs in each(backend, pilot, new, executor, what):
            every[experiment] = runs
            missing[experiment] = [job for job in missing[experiment] if job not in runs.rows]
            file.grown(experiment)
            progress(done := done + 1, of)
        jobs = {
            (e, job): (every[e].observables, needed[e])
            for e in sorted(wanted, key=length, reverse=True)
            for job in sorted(missing[e], key=lambda job: -len(job.seeds))
        }
        for (experiment, job), found in each(backend, scored, jobs, executor, what):
            every[experiment].add(job, *found, needed[experiment])
            missing[experiment].remove(job)
            file.grown(experiment, whole=not missing[experiment])
            progress(done := done + 1, of)
    return every


def acting_parameters(backend: Backend, experiments: Sequence[Experiment]) -> dict[str, frozenset[str]]:
    """Return effect → parameters that change some experiment while the effect's others are nominal.

    Only an effect of several parameters is tried; without a parameter that acts alone it is left out.
    """
    nominal: dict[Experiment, Trace] = {}

    def acts(one: EffectAxis) -> bool:
        assert isinstance(backend, HasEffects)
        changed = backend.with_effects(one.at(one.at_typical()))
        for experiment in experiments:
            if experiment not in nominal:
                nominal[experiment] = experiment.run(backend, SEED)
            if not _is_same(experiment.run(changed, SEED), nominal[experiment]):
                return True
        return False

    several = [effect for effect in catalogue_of(backend) if len(effect.parameters) > 1]
    able = {e.name: frozenset(p.name for p in e.parameters if acts(effect_axis(e, p))) for e in several}
    return {effect: names for effect, names in able.items() if names}


def _is_same(a: Trace, b: Trace) -> bool:
    return len(a) == len(b) and all(np.array_equal(a[name], b[name], equal_nan=True) for name in b.channels)


class _Files:
    """The files of runs that grow. A killed process loses at most the runs of :data:`EVERY` seconds."""

    def __init__(
        self, cache: Cache, places: Mapping[Experiment, str], runs: Mapping[Experiment, Runs]
    ) -> None:
        self._cache, self._places, self._runs = cache, places, runs
        self._unsaved: dict[Experiment, None] = {}
        self._saved_at = monotonic()

    def grown(self, experiment: Experiment, whole: bool = False) -> None:
        """Take note of new rows; write them if the experiment is whole, or if the last writing was long ago."""
        self._unsaved[experiment] = None
        if whole:
            self._save(experiment)
        if monotonic() - self._saved_at > EVERY:
            self._save(*self._unsaved)
            self._saved_at = monotonic()

    @contextmanager
    def saving(self) -> Iterator[None]:
        """Write all that is left, also after an error or an interrupt."""
        try:
            yield
        finally:
            self._save(*self._unsaved)

    def _save(self, *experiments: Experiment) -> None:
        for experiment in experiments:
            self._cache.write(self._places[experiment], self._runs[experiment].save)
            del self._unsaved[experiment]


def each(
    shared: object,
    function: Callable[..., T],
    jobs: Mapping[K, tuple[Any, ...]],
    executor: ExecutorFactory | None,
    what: str,
) -> Iterator[tuple[K, T]]:
    """Yield key and ``function(shared, key, *arguments)`` of each job, as they end; every worker gets one copy.

    Raises:
        BackendError: a worker died.
    """
    if jobs:
        call = partial(function, shared) if executor is None else partial(_of_copy, pack(shared), function)
        own = {key: (key, *arguments) for key, arguments in jobs.items()}
        yield from as_they_end(executor, call, own, what)


_unpack = lru_cache(1)(unpack)


def _of_copy(shared: bytes, function: Callable[..., T], *arguments: Any) -> T:
    return function(_unpack(shared), *arguments)


def pilot(backend: Backend, experiment: Experiment, score: Score | None = None) -> Runs:
    """Return the nominal runs that decide the observables, beside those of healthy machines.

    Raises:
        NominalError: one of them fails.
    """
    traces = []
    for seed in NOMINAL_PILOT.seeds:
        trace = experiment.run(backend, seed)
        if trace.failure:
            raise NominalError(
                f"the simulator {backend.name!r} fails in {experiment}: {trace.failure}; a diagnosis needs a nominal "
                "simulator that passes it",
                f"{experiment}: {trace.failure}",
            )
        traces.append(experiment.with_residuals(trace, backend))
    runs = Runs(Observables.of_nominal(traces, _healthy(backend, experiment)))
    runs.add(NOMINAL_PILOT, *_read(traces, experiment, runs.observables, score), score)
    return runs


def _healthy(backend: Backend, experiment: Experiment) -> list[Trace]:
    """Return whole traces of machines without causes."""
    assert isinstance(backend, HasEffects)
    axes, traces = effect_axes(catalogue_of(backend)), []
    for number in range(HEALTHY):
        machine = backend.with_effects(values_at(axes, healthy_machine(axes, number)))
        trace = experiment.run(machine, SEED + PILOT + number)
        traces += [] if trace.failure else [trace]
    return traces


def vectors(backend: Backend, what: tuple[Experiment, Job], observables: Observables) -> Rows:
    """Return (runs, m) the observables of a job's runs; NaN where a run ended before."""
    return scored(backend, what, observables)[0]


def scored(
    backend: Backend, what: tuple[Experiment, Job], observables: Observables, score: Score | None = None
) -> tuple[Rows, FloatArray]:
    """Return (runs, m) the observables of a job's runs, and (runs, 2) their scores; NaN without one."""
    experiment, job = what
    machine: Any = backend
    if job.variant:
        assert isinstance(backend, HasVariants)
        machine = backend.variants()[job.variant]
    if job.values:
        assert isinstance(machine, HasEffects)
        machine = machine.with_effects({effect: dict(values) for effect, values in job.values})
    runs = (experiment.run(machine, seed) for seed in job.seeds)
    return _read((experiment.with_residuals(run, backend) for run in runs), experiment, observables, score)


def _read(
    traces: Iterable[Trace], experiment: Experiment, observables: Observables, score: Score | None
) -> tuple[Rows, FloatArray]:
    pairs = [
        (observables.vector(trace), UNKNOWN if score is None else score.row(trace, experiment))
        for trace in traces
    ]
    rows, scores = zip(*pairs, strict=True)
    return np.array(rows, dtype=np.float32), np.array(scores)
