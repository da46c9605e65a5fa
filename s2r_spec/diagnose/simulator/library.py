"""The response library: what every effect does to the observables of every experiment, simulated once and kept.

Of an experiment it holds the nominal mean (m,), the scatter (m,) of one run, the response to every parameter at a few
coordinates, and the response to every variant of the simulator. A response is a difference of runs with equal seeds.

Units: parameters are in coordinates, distances from nominal in units of the typical size (see :mod:`..axes`).
Between its points a response is interpolated linearly, and beyond them extrapolated. Responses of several parameters
add up; :mod:`..estimation` corrects the sum by runs at the estimate itself.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasEffects, HasVariants
from s2r_spec.diagnose.axes import Line, lines
from s2r_spec.diagnose.cache import Cache, source_of
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.observables import Group, Observables, Quantity
from s2r_spec.effects import catalogue_of
from s2r_spec.errors import BackendError
from s2r_spec.rollouts.pools import in_this_process
from s2r_spec.trace import Trace

FloatArray = NDArray[np.float64]
Values = Mapping[str, Mapping[str, float]]
Progress = Callable[[str, int, int], None]
"""Called with stage, number of jobs done, and number of jobs."""

POINTS = (0.3, 1.0, 2.0)
"""Definition: coordinates of a response on either side, as far as the range reaches. An effect with a threshold between
two of them is interpolated; more points cost a run of every experiment each."""
NOMINAL = 8
"""Budget: nominal runs of an experiment, from which its scatter is known to 27 %. Twice as many: 18 %."""
REPLICATES = {"test": 2, "protocol": 1}
"""Budget: runs of a response. A test's controller has a clock of its own, so that its runs differ more."""
SEED = 1_000
"""Definition: seed of the first run; no rollout of a certificate has it."""
VERSION = 1
"""Definition: of the arrays; a change makes every library again."""


@dataclass(frozen=True)
class Curve:
    """The response to one parameter: linear between its points, extrapolated beyond them.

    Attributes:
        coordinates: (p,) rising; 0 is among them.
        values: (p, m) the response at each.
    """

    coordinates: FloatArray
    values: FloatArray

    def at(self, coordinate: float) -> FloatArray:
        """Return (m,) the response."""
        place = self._place(coordinate)
        return np.asarray(
            self.values[place] + self.slope(coordinate) * (coordinate - self.coordinates[place])
        )

    def slope(self, coordinate: float) -> FloatArray:
        """Return (m,) the derivative; at nominal, that of the upper side if there is one."""
        c, v, place = self.coordinates, self.values, self._place(coordinate)
        return np.zeros_like(v[0]) if c.size < 2 else (v[place + 1] - v[place]) / (c[place + 1] - c[place])

    def _place(self, coordinate: float) -> int:
        last = max(self.coordinates.size - 2, 0)
        return min(max(int(np.searchsorted(self.coordinates, coordinate, side="right")) - 1, 0), last)


@dataclass(frozen=True)
class Response:
    """What the simulator knows of one experiment.

    Attributes:
        experiment: see there.
        observables: of its traces.
        nominal: (m,) mean of the nominal runs.
        scatter: (m,) standard deviation of one run.
        reference: (m,) mean of the nominal runs with the seeds of the responses.
        curves: the response to every parameter.
        variants: (V, m) responses to the simulator's variants.
    """

    experiment: Experiment
    observables: Observables
    nominal: FloatArray
    scatter: FloatArray
    reference: FloatArray
    curves: tuple[Curve, ...]
    variants: FloatArray

    @property
    def groups(self) -> tuple[Group, ...]:
        """The groups of the observables."""
        return self.observables.groups

    @property
    def bins(self) -> NDArray[np.int64]:
        """Places of the means over parts of the trace; they have values as long as a run lasts."""
        places = [np.arange(g.start, g.stop) for g in self.groups if g.statistic == "bin"]
        bins = np.concatenate(places) if places else np.zeros(0, dtype=np.int64)
        return bins[np.isfinite(self.nominal[bins])]

    def mean(self, theta: FloatArray) -> FloatArray:
        """Return (m,) the mean of the observables at (K,) coordinates, as the sum of responses."""
        moved = [self.curves[k].at(float(theta[k])) for k in np.flatnonzero(theta)]
        return self.nominal + np.sum(moved, axis=0) if moved else self.nominal


@dataclass(frozen=True)
class ResponseLibrary:
    """Responses of every experiment to every parameter of the catalogue.

    Attributes:
        parameters: of the catalogue, in its order.
        responses: one for each experiment.
    """

    parameters: tuple[Line, ...]
    responses: tuple[Response, ...]

    def response(self, experiment: Experiment) -> Response:
        """Return the response of an experiment.

        Raises:
            KeyError: the library does not have it.
        """
        return {each.experiment: each for each in self.responses}[experiment]

    def values(self, theta: FloatArray) -> dict[str, dict[str, float]]:
        """Return effect → parameter → value at (K,) coordinates, without parameters at nominal."""
        found: dict[str, dict[str, float]] = {}
        for line, coordinate in zip(self.parameters, theta, strict=True):
            if coordinate:
                found.setdefault(line.effect, {})[line.parameter] = line.value(float(coordinate))
        return found

    def coordinates(self, values: Values) -> FloatArray:
        """Return (K,) the coordinates of values; a parameter without a value is nominal."""
        return np.array(
            [
                line.coordinate(values[line.effect][line.parameter])
                if line.parameter in values.get(line.effect, {})
                else 0.0
                for line in self.parameters
            ]
        )


@dataclass(frozen=True)
class _Job:
    """Runs of one experiment on one machine, reduced to a mean where they are made."""

    experiment: Experiment
    values: tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
    variant: str
    seeds: tuple[int, ...]


def library(
    backend: Backend,
    experiments: Sequence[Experiment],
    executor: Callable[[], Executor] | None = None,
    progress: Progress = lambda stage, done, of: None,
    cache: Cache | None = None,
) -> ResponseLibrary:
    """Return the responses of a simulator, from the cache where they are there.

    Raises:
        UsageError: the backend declares no effects.
        BackendError: a nominal run fails, or responses to a variant are no numbers.
    """
    parameters = lines(catalogue_of(backend))
    cache = Cache.usual() if cache is None else cache
    places = {e: f"responses/{_key(backend, e, parameters)}.npz" for e in experiments}
    missing = [e for e, place in places.items() if not (cache.folder / place).is_file()]
    # All missing experiments share one pool; a damaged file is made again alone.
    made = _make(backend, missing, parameters, executor, progress)

    def make(experiment: Experiment) -> Response:
        if experiment in made:
            return made[experiment]
        return _make(backend, [experiment], parameters, executor, progress)[experiment]

    responses = [cache.kept(place, _load, partial(make, e), _save) for e, place in places.items()]
    return ResponseLibrary(parameters, tuple(responses))


def _make(
    backend: Backend,
    experiments: Sequence[Experiment],
    parameters: Sequence[Line],
    executor: Callable[[], Executor] | None,
    progress: Progress,
) -> dict[Experiment, Response]:
    if not experiments:
        return {}
    observables = {e: Observables.of_nominal(list(_nominal(backend, e))) for e in experiments}
    jobs = [job for e in experiments for job in _jobs(backend, e, parameters)]
    # The longest jobs first, so that no worker waits for the last one.
    jobs.sort(key=lambda job: -_duration(job, observables))
    means: dict[_Job, FloatArray] = {}
    with (executor or in_this_process)() as pool:
        pending = {pool.submit(mean_of_runs, backend, job, observables[job.experiment]): job for job in jobs}
        for done, future in enumerate(as_completed(pending), 1):
            means[pending[future]] = future.result()
            progress("simulating every effect", done, len(jobs))
    return {e: _response(backend, e, observables[e], parameters, means) for e in experiments}


def _nominal(backend: Backend, experiment: Experiment) -> Iterator[Trace]:
    for k in range(2):
        trace = experiment.run(backend, SEED + k)
        if trace.failure:
            raise BackendError(
                f"the simulator {backend.name!r} fails in {experiment}: {trace.failure}; a diagnosis needs a nominal "
                "simulator that passes it"
            )
        yield experiment.with_residuals(trace, backend)


def _jobs(backend: Backend, experiment: Experiment, parameters: Sequence[Line]) -> Iterator[_Job]:
    for seed in range(SEED, SEED + NOMINAL):
        yield _Job(experiment, (), "", (seed,))
    seeds = _seeds(experiment)
    for line in parameters:
        for coordinate in _points(line):
            value = line.at(line.value(coordinate))
            yield _Job(experiment, _frozen(value), "", seeds)
    for name in backend.variants() if isinstance(backend, HasVariants) else ():
        yield _Job(experiment, (), name, seeds)


def _points(line: Line) -> list[float]:
    """Return the coordinates of a response, rising, without 0."""
    ends = [line.coordinate(line.low), line.coordinate(line.high)]
    found = set()
    for sign in (-1.0, 1.0):
        reach = max((sign * end for end in ends), default=0.0)
        found |= {sign * min(point, reach) for point in POINTS if reach > 1e-9 and point < 1.5 * reach}
    return sorted(found)


def _response(
    backend: Backend,
    experiment: Experiment,
    observables: Observables,
    parameters: Sequence[Line],
    means: Mapping[_Job, FloatArray],
) -> Response:
    seeds = _seeds(experiment)
    runs = np.array([means[_Job(experiment, (), "", (seed,))] for seed in range(SEED, SEED + NOMINAL)])
    reference = runs[: len(seeds)].mean(axis=0)
    curves = []
    for line in parameters:
        points = {0.0: np.zeros_like(reference)}
        for coordinate in _points(line):
            value = line.value(coordinate)
            moved = means[_Job(experiment, _frozen(line.at(value)), "", seeds)] - reference
            if np.isfinite(moved).any():  # a machine that fell at once shows nothing
                points[line.coordinate(value)] = moved
        order = sorted(points)
        curves.append(Curve(np.array(order), np.array([points[c] for c in order])))
    names = list(backend.variants()) if isinstance(backend, HasVariants) else []
    variants = [means[_Job(experiment, (), name, seeds)] - reference for name in names]
    return Response(
        experiment,
        observables,
        runs.mean(axis=0),
        runs.std(axis=0, ddof=1),
        reference,
        tuple(curves),
        np.array(variants).reshape(len(names), reference.size),
    )


def mean_of_runs(backend: Backend, job: _Job, observables: Observables) -> FloatArray:
    """Return (m,) the mean observables of a job's runs; NaN where a run ended before."""
    machine: Any = backend
    if job.variant:
        assert isinstance(backend, HasVariants)
        machine = backend.variants()[job.variant]
    if job.values:
        assert isinstance(machine, HasEffects)
        machine = machine.with_effects({effect: dict(values) for effect, values in job.values})
    vectors = [
        observables.vector(job.experiment.with_residuals(job.experiment.run(machine, seed), backend))
        for seed in job.seeds
    ]
    return np.asarray(np.mean(vectors, axis=0))


def simulated(backend: Backend, response: Response, values: Values) -> FloatArray:
    """Return (m,) the mean observables of a simulator with these effects, with the seeds of the responses."""
    job = _Job(response.experiment, _frozen(values), "", _seeds(response.experiment))
    return mean_of_runs(backend, job, response.observables)


def nominal(backend: Backend, response: Response, experiment: Experiment) -> FloatArray:
    """Return (m,) the nominal mean of another experiment, in the observables and with the seeds of a response."""
    return mean_of_runs(backend, _Job(experiment, (), "", _seeds(experiment)), response.observables)


def _frozen(values: Values) -> tuple[tuple[str, tuple[tuple[str, float], ...]], ...]:
    return tuple((effect, tuple(sorted(numbers.items()))) for effect, numbers in sorted(values.items()))


def _seeds(experiment: Experiment) -> tuple[int, ...]:
    return tuple(range(SEED, SEED + REPLICATES["protocol" if experiment.protocol else "test"]))


def _duration(job: _Job, observables: Mapping[Experiment, Observables]) -> float:
    return observables[job.experiment].duration * len(job.seeds)


def _key(backend: Backend, experiment: Experiment, parameters: Sequence[Line]) -> str:
    """Return a hash of everything that a response depends on.

    A model's hash says what its rollouts are. Its residuals and variants are of other source, and the observables are
    of ours, so the sources of both count, too.
    """
    what = (
        VERSION,
        (backend.name, backend.model_hash, backend.duration),
        source_of(type(backend)),
        [path.read_text() for path in sorted(Path(__file__).parent.glob("*.py"))],
        experiment,
        [asdict(line) for line in parameters],
    )
    return hashlib.sha256(repr(what).encode()).hexdigest()[:24]


def _save(response: Response, path: Path) -> None:
    o = response.observables
    header = {
        "protocol": response.experiment.protocol,
        "params": response.experiment.params,
        "duration": o.duration,
        "flags": o.flags,
        "quantities": [(q.name, q.channel, q.minus, q.scale.tolist()) for q in o.quantities],
    }
    sizes = [curve.coordinates.size for curve in response.curves]
    np.savez_compressed(
        path,
        header=np.array(json.dumps(header)),
        nominal=response.nominal,
        scatter=response.scatter.astype(np.float32),
        reference=response.reference,
        sizes=np.array(sizes),
        coordinates=np.concatenate([curve.coordinates for curve in response.curves]),
        values=np.concatenate([curve.values for curve in response.curves]).astype(np.float32),
        variants=response.variants.astype(np.float32),
    )


def _load(path: Path) -> Response:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        header = json.loads(str(arrays["header"]))
        edges = np.cumsum(arrays["sizes"])[:-1]
        observables = Observables(
            float(header["duration"]),
            tuple(
                Quantity(name, channel, minus, np.array(scale))
                for name, channel, minus, scale in header["quantities"]
            ),
            tuple((name, int(width)) for name, width in header["flags"]),
        )
        response = Response(
            Experiment(header["protocol"], tuple((name, value) for name, value in header["params"])),
            observables,
            arrays["nominal"],
            arrays["scatter"].astype(float),
            arrays["reference"],
            tuple(
                Curve(*points)
                for points in zip(
                    np.split(arrays["coordinates"], edges),
                    np.split(arrays["values"].astype(float), edges),
                    strict=True,
                )
            ),
            arrays["variants"].astype(float),
        )
    if response.nominal.size != observables.groups[-1].stop:
        raise ValueError("the arrays do not fit the observables")
    return response
