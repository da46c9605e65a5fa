"""The response library: what every effect does in every experiment, simulated once and kept (:mod:`.response`)."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasEffects, HasVariants
from s2r_spec.backend.effects import catalogue_of
from s2r_spec.backend.files import pack, unpack
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import BackendError
from s2r_spec.diagnose.inference.prior import BACKGROUND
from s2r_spec.diagnose.simulator.axes import EffectAxis, Values, effect_axes, effect_axis
from s2r_spec.diagnose.simulator.cache import Cache, source_of
from s2r_spec.diagnose.simulator.curve import ResponseCurve, Turn
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.observables import ObservableGroup, Observables
from s2r_spec.diagnose.simulator.response import Practice, Response, ResponseLibrary, replicates, values_at
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import ExecutorFactory, in_this_process

Progress = Callable[[str, int, int], None]
"""Called with stage, number of jobs done, and number of jobs."""

POINTS = (0.3, 1.0, 2.0)
"""Definition: coordinates of a response on either side, as far as the range reaches. An effect with a threshold between
two of them is interpolated; more points cost a run of every experiment each."""
MACHINES = 24
"""Budget: practice machines; the error of a sum of responses is then known to 15 %."""
CAUSES = 3
"""Definition: a practice machine has 0 to 3 causes, of a quarter of the typical size to all of it. More causes make
sums of responses look worse."""
NOMINAL = 8
"""Budget: nominal runs of an experiment, from which its scatter is known to 27 %."""
PILOT = 4
"""Budget: nominal runs that decide which observables there are. With two, a gait may agree in time by chance."""
SEED = 1_000
"""Definition: seed of the first run; no rollout of a certificate has it."""
VERSION = 3
"""Definition: of the arrays; a change makes every library again."""


@dataclass(frozen=True)
class _Job:
    """Runs of one experiment on one machine, reduced to a mean where they are made."""

    experiment: Experiment
    values: tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
    variant: str
    seeds: tuple[int, ...]

    @classmethod
    def of(cls, experiment: Experiment, values: Values, variant: str = "", runs: int = 0) -> _Job:
        frozen = tuple((effect, tuple(sorted(own.items()))) for effect, own in sorted(values.items()))
        return cls(experiment, frozen, variant, tuple(range(SEED, SEED + (runs or replicates(experiment)))))


Runs = Mapping[_Job, NDArray[np.float32]]
"""(seeds, m) observables of every job."""


def library(
    backend: Backend,
    experiments: Sequence[Experiment],
    executor: ExecutorFactory | None = None,
    progress: Progress = lambda stage, done, of: None,
    cache: Cache | None = None,
) -> ResponseLibrary:
    """Return the responses of a simulator, from the cache where they are there.

    Raises:
        UsageError: the backend declares no effects.
        BackendError: a nominal run fails, or responses to a variant are no numbers.
    """
    cache = Cache.usual() if cache is None else cache
    design = _Design.of(backend, _cached_parameters(backend, experiments, cache))
    places = {e: _place(backend, e, design.parameters) for e in experiments}
    missing = [e for e, place in places.items() if not (cache.folder / place).is_file()]
    # All missing experiments share one pool; a damaged file is made again alone.
    made = _make(backend, missing, design, executor, progress)

    def make(experiment: Experiment) -> Response:
        return made.get(experiment) or _make(backend, [experiment], design, executor, progress)[experiment]

    responses = [cache.kept(p, Response.load, partial(make, e), Response.save) for e, p in places.items()]
    return ResponseLibrary(design.parameters, tuple(responses))


def most_rollouts(
    backend: Backend, experiments: Sequence[Experiment], cache: Cache | None = None
) -> dict[Experiment, int]:
    """Return experiment → largest number of rollouts that its response takes; 0 where the cache has it.

    Runs nothing. Which parameters act alone is known only after :func:`acting_parameters`, so without its result in
    the cache every parameter counts, and no response is taken from the cache.
    """
    cache = Cache.usual() if cache is None else cache
    tried = (cache.folder / _place(backend, tuple(experiments))).is_file()
    design = _Design.of(backend, _cached_parameters(backend, experiments, cache) if tried else None)
    several = [e.parameters for e in catalogue_of(backend) if len(e.parameters) > 1]
    probes = 0 if tried else 1 + sum(map(len, several))

    def rollouts(experiment: Experiment) -> int:
        if tried and (cache.folder / _place(backend, experiment, design.parameters)).is_file():
            return 0
        return probes + PILOT + sum(len(job.seeds) for job in design.jobs(experiment))

    return {experiment: rollouts(experiment) for experiment in experiments}


def _cached_parameters(
    backend: Backend, experiments: Sequence[Experiment], cache: Cache
) -> dict[str, frozenset[str]]:
    def save(parameters: dict[str, frozenset[str]], path: Path) -> None:
        np.savez(path, names=np.array(json.dumps({e: sorted(names) for e, names in parameters.items()})))

    def load(path: Path) -> dict[str, frozenset[str]]:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return {e: frozenset(names) for e, names in json.loads(str(arrays["names"])).items()}

    place = _place(backend, tuple(experiments))
    return cache.kept(place, load, lambda: acting_parameters(backend, experiments), save)


def _make(
    backend: Backend,
    experiments: Sequence[Experiment],
    design: _Design,
    executor: ExecutorFactory | None,
    progress: Progress,
) -> dict[Experiment, Response]:
    if not experiments:
        return {}
    observables = {e: Observables.of_nominal(list(_nominal(backend, e))) for e in experiments}
    jobs = list(dict.fromkeys(job for e in experiments for job in design.jobs(e)))
    # The longest jobs first, so that no worker waits for the last one.
    jobs.sort(key=lambda job: -observables[job.experiment].duration * len(job.seeds))
    what, tell = (
        f"simulated effects on backend {backend.name!r}",
        partial(progress, "simulating every effect"),
    )
    runs = _run(backend, {job: observables[job.experiment] for job in jobs}, executor, what, tell)
    return {e: design.response(e, observables[e], runs) for e in experiments}


def _run(
    backend: Backend,
    jobs: Mapping[_Job, Observables],
    executor: ExecutorFactory | None,
    what: str,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Runs:
    runs = {}
    call = partial(vectors, backend) if executor is None else partial(_vectors_of_copy, pack(backend))
    with (executor or in_this_process)() as pool:
        pending = {pool.submit(call, job, own): job for job, own in jobs.items()}
        try:
            for done, future in enumerate(as_completed(pending), 1):
                runs[pending[future]] = future.result()
                progress(done, len(jobs))
        except BrokenExecutor:
            raise BackendError(
                f"a worker died while it {what}; run it again with --workers 1 to see the experiment that kills it"
            ) from None
        finally:
            for future in pending:
                future.cancel()
    return runs


_unpack = lru_cache(1)(unpack)


def _vectors_of_copy(backend: bytes, job: _Job, observables: Observables) -> NDArray[np.float32]:
    return vectors(_unpack(backend), job, observables)


def _nominal(backend: Backend, experiment: Experiment) -> Iterator[Trace]:
    for k in range(PILOT):
        trace = experiment.run(backend, SEED + k)
        if trace.failure:
            raise BackendError(
                f"the simulator {backend.name!r} fails in {experiment}: {trace.failure}; a diagnosis needs a nominal "
                "simulator that passes it"
            )
        yield experiment.with_residuals(trace, backend)


@dataclass(frozen=True)
class _Design:
    """The runs of every experiment, and the response that they give."""

    parameters: tuple[EffectAxis, ...]
    variants: tuple[str, ...]

    @classmethod
    def of(cls, backend: Backend, acts: Mapping[str, frozenset[str]] | None) -> _Design:
        variants = backend.variants() if isinstance(backend, HasVariants) else ()
        return cls(effect_axes(catalogue_of(backend), acts), tuple(variants))

    @cached_property
    def machines(self) -> list[tuple[FloatArray, str]]:
        """(K,) coordinates and variant of every practice machine; the same for every experiment."""
        return [self._machine(number) for number in range(MACHINES)]

    def _machine(self, number: int) -> tuple[FloatArray, str]:
        """Return a practice machine. Every parameter has a stream of its own, so that their order changes nothing."""

        def stream(name: str) -> np.random.Generator:
            return np.random.default_rng(
                np.random.SeedSequence(SEED, spawn_key=(number, zlib.crc32(name.encode())))
            )

        theta, sizes, turn = (np.zeros(len(self.parameters)) for _ in range(3))
        for k, axis in enumerate(self.parameters):
            random = stream(axis.name)
            low, high = axis.ends
            # A dependent parameter may have any value: where a load lies is no sign of its mass.
            if axis.is_phase:
                theta[k] = random.uniform(low, high)
            else:
                theta[k] = np.clip((1.0 if axis.base else BACKGROUND) * random.normal(), low, high)
            sign = 1.0 if low > -1e-9 or (high > 1e-9 and random.uniform() < 0.5) else -1.0
            sizes[k] = np.clip(sign * random.uniform(0.25, 1.0), low, high)
            turn[k] = np.inf if axis.base else random.uniform()
        random = stream("")
        causes = np.argsort(turn)[: min(int(random.integers(CAUSES + 1)), int(np.isfinite(turn).sum()))]
        theta[causes] = sizes[causes]
        return theta, str(random.choice(["", *sorted(self.variants)]))

    def jobs(self, experiment: Experiment) -> Iterator[_Job]:
        yield _Job.of(experiment, {}, runs=NOMINAL)
        for axis in self.parameters:
            for coordinate in _points(axis):
                yield _point_job(experiment, axis, coordinate)
        for name in self.variants:
            yield _Job.of(experiment, {}, name)
        yield from self._practice_jobs(experiment)

    def _practice_jobs(self, experiment: Experiment) -> list[_Job]:
        jobs = [_Job.of(experiment, values_at(self.parameters, at), name) for at, name in self.machines]
        return [replace(job, seeds=(SEED + NOMINAL + number,)) for number, job in enumerate(jobs)]

    def response(self, experiment: Experiment, observables: Observables, runs: Runs) -> Response:
        nominal = runs[_Job.of(experiment, {}, runs=NOMINAL)].astype(float)
        reference = nominal[: replicates(experiment)].mean(axis=0)
        curves, spread = [], np.zeros((len(self.parameters), reference.size))
        for k, axis in enumerate(self.parameters):
            before = nominal
            if axis.base:
                # A dependent parameter's response is that beside the first parameter of its effect.
                first = next(p for p in self.parameters if p.effect == axis.effect and not p.base)
                at = first.coordinate(first.at_typical())
                near = min(_points(first), key=lambda c: abs(c - at))
                before = runs[_point_job(experiment, first, near)]
            points, scatter = {0.0: np.zeros_like(reference)}, []
            for coordinate in _points(axis):
                moved = runs[_point_job(experiment, axis, coordinate)].astype(float)
                moved = moved - before[: len(moved)]
                if np.isfinite(moved).any():  # a machine that fell at once shows nothing
                    at = axis.coordinate(axis.value(coordinate))
                    points[at] = moved.mean(axis=0)
                    if len(moved) > 1:
                        scatter.append(_scatter(moved, observables.groups) / at**2)
            order = sorted(points)
            kind = Turn if axis.is_phase else ResponseCurve
            curves.append(kind(np.array(order), _single_precision(np.array([points[c] for c in order]))))
            spread[k] = np.mean(scatter, axis=0) if scatter else 0.0
        variants = [runs[_Job.of(experiment, {}, name)].mean(axis=0) - reference for name in self.variants]
        return Response(
            experiment,
            observables,
            nominal.mean(axis=0),
            _single_precision(nominal.std(axis=0, ddof=1)),
            reference,
            tuple(curves),
            _single_precision(spread),
            _single_precision(np.array(variants).reshape(len(self.variants), reference.size)),
            Practice(
                np.array([theta for theta, _ in self.machines]),
                np.array([[float(own == name) for name in self.variants] for _, own in self.machines]),
                np.array([runs[job][0] for job in self._practice_jobs(experiment)], dtype=float),
            ),
        )


def _point_job(experiment: Experiment, axis: EffectAxis, coordinate: float) -> _Job:
    """Return the runs of one point; nearest to ±1 there are two, which show the scatter of the response."""
    side = [abs(c) for c in _points(axis) if c * coordinate > 0.0]
    middle = abs(coordinate) == min(side, key=lambda size: abs(size - 1.0))
    return _Job.of(experiment, axis.at(axis.value(coordinate)), runs=2 if middle else 0)


def _points(axis: EffectAxis) -> list[float]:
    """Return the coordinates of a response, rising, without 0; of an angle that may be any, the quarters of a turn."""
    if axis.is_phase:
        return [-0.5, 0.5, 1.0]
    points = set()
    for sign in (-1.0, 1.0):
        reach = max(sign * end for end in axis.ends)
        points |= {sign * min(point, reach) for point in POINTS if reach > 1e-9 and point < 1.5 * reach}
    return sorted(points)


def _single_precision(values: FloatArray) -> FloatArray:
    """Return values in single precision, as the cache keeps them: so the first answer is the same as later ones."""
    return values.astype(np.float32).astype(float)


def _scatter(moved: FloatArray, groups: Sequence[ObservableGroup]) -> FloatArray:
    """Return (m,) the variance of a response from (runs, m), half of it spread over each group: two runs say little.

    An observable that a run lacks, since it ended early, scatters by as much as it moves.
    """
    variance = moved.var(axis=0, ddof=1)
    variance = np.where(
        np.isfinite(variance), variance, np.nan_to_num(np.nanmax(np.nan_to_num(moved) ** 2, axis=0))
    )
    for group in groups:
        part = variance[group.start : group.stop]
        variance[group.start : group.stop] = 0.5 * (part + part.mean())
    return np.asarray(variance)


def vectors(backend: Backend, job: _Job, observables: Observables) -> NDArray[np.float32]:
    """Return (seeds, m) the observables of a job's runs; NaN where a run ended before."""
    machine: Any = backend
    if job.variant:
        assert isinstance(backend, HasVariants)
        machine = backend.variants()[job.variant]
    if job.values:
        assert isinstance(machine, HasEffects)
        machine = machine.with_effects({effect: dict(values) for effect, values in job.values})
    runs = (job.experiment.run(machine, seed) for seed in job.seeds)
    rows = [observables.vector(job.experiment.with_residuals(run, backend)) for run in runs]
    return np.array(rows, dtype=np.float32)


def simulated_means(
    backend: Backend, responses: Sequence[Response], values: Values, executor: ExecutorFactory | None = None
) -> list[FloatArray]:
    """Return (m,) the mean of every experiment with these effects, with the observables and seeds of its response."""
    jobs = {_Job.of(one.experiment, values): one.observables for one in responses}
    runs = _run(backend, jobs, executor, f"ran backend {backend.name!r} with {values}")
    return [np.asarray(runs[job].astype(float).mean(axis=0)) for job in jobs]


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


def _place(backend: Backend, of: object, parameters: Sequence[EffectAxis] = ()) -> str:
    """Return the file of the response of an experiment, or of the acting parameters of several.

    A model's hash says what its rollouts are. Its residuals and variants are of other source, and the observables are
    of ours, so the sources of both count, too.
    """
    what = (
        (VERSION, BACKGROUND),
        (backend.name, backend.model_hash, backend.duration),
        source_of(type(backend)),
        [path.read_text() for path in sorted(Path(__file__).parent.glob("*.py"))],
        of,
        [asdict(axis) for axis in parameters],
    )
    folder = "responses" if isinstance(of, Experiment) else "acting"
    return f"{folder}/{hashlib.sha256(repr(what).encode()).hexdigest()[:24]}.npz"
