"""The response library: what every effect does to the observables of every experiment, simulated once and kept.

Of an experiment it holds the nominal mean (m,), the scatter (m,) of one run, and the response to every parameter at a
few coordinates, with its scatter from run to run. A response is a difference of runs with equal seeds. It also holds
the response to every variant of the simulator. *Practice machines* are the simulator with random sizes of all effects
and a random variant. Their runs show how well the sum of responses predicts a machine.

A parameter that does nothing while the rest of its effect is nominal, such as the place of a payload, is *dependent*:
its response was simulated with the first parameter of the effect at its typical size, and grows in proportion to it.

Units: parameters are in coordinates, distances from nominal in units of the typical size (see :mod:`..axes`).
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from s2r_spec.backend import Backend, HasEffects, HasVariants
from s2r_spec.backend.effects import catalogue_of
from s2r_spec.base.errors import BackendError
from s2r_spec.diagnose.inference.prior import BACKGROUND
from s2r_spec.diagnose.simulator.axes import EffectAxis, effect_axes, effect_axis
from s2r_spec.diagnose.simulator.cache import Cache, source_of
from s2r_spec.diagnose.simulator.curve import ResponseCurve, Turn
from s2r_spec.diagnose.simulator.experiments import RESIDUAL, Experiment
from s2r_spec.diagnose.simulator.observables import ObservableGroup, Observables, ObservedQuantity
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import in_this_process

FloatArray = NDArray[np.float64]
Values = Mapping[str, Mapping[str, float]]
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
REPLICATES = {"test": 2, "protocol": 1}
"""Budget: runs of a response. A test's controller has a clock of its own, so that its runs differ more."""
SEED = 1_000
"""Definition: seed of the first run; no rollout of a certificate has it."""
VERSION = 3
"""Definition: of the arrays; a change makes every library again."""


@dataclass(frozen=True)
class Dependence:
    """Which responses are in proportion to another parameter.

    Attributes:
        base: (K,) this parameter; −1 for a response that stands alone.
        at: (K,) its coordinate at which the response was simulated.
    """

    base: NDArray[np.int64]
    at: FloatArray

    @classmethod
    def of(cls, parameters: Sequence[EffectAxis]) -> Dependence:
        """Return that of a catalogue's parameters."""
        base, at = np.full(len(parameters), -1), np.ones(len(parameters))
        for k, axis in enumerate(parameters):
            if axis.base:
                base[k] = next(j for j, p in enumerate(parameters) if p.effect == axis.effect and not p.base)
                at[k] = parameters[base[k]].coordinate(parameters[base[k]].at_typical())
        return cls(base, at)

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """(dependent parameter, its base) of every dependent one."""
        return [(int(k), int(self.base[k])) for k in np.flatnonzero(self.base >= 0)]

    def factors(self, theta: FloatArray) -> FloatArray:
        """Return (K,) what every response is multiplied by at (K,) coordinates."""
        return np.where(self.base >= 0, theta[self.base] / self.at, 1.0)


@dataclass(frozen=True)
class Practice:
    """Runs of random machines.

    Attributes:
        theta: (M, K) their coordinates.
        variant: (M, V) 1 for the variant that each machine has.
        values: (M, m) the observables of one run of each.
    """

    theta: FloatArray
    variant: FloatArray
    values: FloatArray


@dataclass(frozen=True, eq=False)
class Response:
    """What the simulator knows of one experiment.

    Attributes:
        experiment: see there.
        observables: of its traces.
        nominal: (m,) mean of the nominal runs.
        scatter: (m,) standard deviation of one run.
        reference: (m,) mean of the nominal runs with the seeds of the responses.
        curves: the response to every parameter.
        spread: (K, m) variance of the response from run to run, for a coordinate of 1; it grows with its square.
        variants: (V, m) responses to the simulator's variants.
        practice: runs of practice machines.
    """

    experiment: Experiment
    observables: Observables
    nominal: FloatArray
    scatter: FloatArray
    reference: FloatArray
    curves: tuple[ResponseCurve, ...]
    spread: FloatArray
    variants: FloatArray
    practice: Practice

    @property
    def groups(self) -> tuple[ObservableGroup, ...]:
        """The groups of the observables."""
        return self.observables.groups

    def groups_of(self, measured: NDArray[np.bool_]) -> tuple[ObservableGroup, ...]:
        """Return the groups to use of (m,) observables that were measured.

        Where every residual was measured, the channels themselves are left out: they show the same causes through the
        machine's closed loop.
        """
        residuals = [g for g in self.groups if g.quantity.startswith(RESIDUAL)]
        whole = all(
            measured[g.start : g.stop].any()
            for g in residuals
            if np.isfinite(self.nominal[g.start : g.stop]).any()
        )
        return tuple(residuals) if residuals and whole else self.groups

    @property
    def bins(self) -> NDArray[np.int64]:
        """Places of the means over parts of the trace; they have values as long as a run lasts."""
        places = [np.arange(g.start, g.stop) for g in self.groups if g.statistic in ("bin", "mean")]
        bins = np.concatenate(places) if places else np.zeros(0, dtype=np.int64)
        return bins[np.isfinite(self.nominal[bins])]

    @property
    def replicates(self) -> int:
        """Number of runs of a response."""
        return len(_seeds(self.experiment))


@dataclass(frozen=True)
class ResponseLibrary:
    """Responses of every experiment to every parameter of the catalogue.

    Attributes:
        parameters: of the catalogue, in its order.
        responses: one for each experiment.
    """

    parameters: tuple[EffectAxis, ...]
    responses: tuple[Response, ...]

    @cached_property
    def dependence(self) -> Dependence:
        """Which responses are in proportion to another parameter."""
        return Dependence.of(self.parameters)

    def response(self, experiment: Experiment) -> Response:
        """Return the response of an experiment.

        Raises:
            KeyError: the library does not have it.
        """
        return {each.experiment: each for each in self.responses}[experiment]

    def values(self, theta: FloatArray) -> dict[str, dict[str, float]]:
        """Return effect → parameter → value at (K,) coordinates, without parameters at nominal."""
        values: dict[str, dict[str, float]] = {}
        for axis, coordinate in zip(self.parameters, theta, strict=True):
            if coordinate:
                values.setdefault(axis.effect, {})[axis.parameter] = axis.value(float(coordinate))
        return values

    def coordinates(self, values: Values) -> FloatArray:
        """Return (K,) the coordinates of values; a parameter without a value is nominal."""
        return np.array(
            [
                axis.coordinate(values[axis.effect][axis.parameter])
                if axis.parameter in values.get(axis.effect, {})
                else 0.0
                for axis in self.parameters
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
    cache = Cache.usual() if cache is None else cache
    parameters = effect_axes(catalogue_of(backend), _cached_parameters(backend, experiments, cache))
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


def most_rollouts(
    backend: Backend, experiments: Sequence[Experiment], cache: Cache | None = None
) -> dict[Experiment, int]:
    """Return experiment → largest number of rollouts that its response takes; 0 where the cache has it.

    Runs nothing. Which parameters act alone is known only after :func:`acting_parameters`, so without its result in
    the cache every parameter counts, and no response is taken from the cache.
    """
    cache = Cache.usual() if cache is None else cache
    effects = catalogue_of(backend)
    tried = (cache.folder / f"acting/{_key(backend, tuple(experiments), ())}.npz").is_file()
    parameters = (
        effect_axes(effects, _cached_parameters(backend, experiments, cache))
        if tried
        else effect_axes(effects)
    )
    probes = 0 if tried else 1 + sum(len(e.parameters) for e in effects if len(e.parameters) > 1)
    machines = _machines(parameters, list(backend.variants()) if isinstance(backend, HasVariants) else [])

    def rollouts(experiment: Experiment) -> int:
        if tried and (cache.folder / f"responses/{_key(backend, experiment, parameters)}.npz").is_file():
            return 0
        return (
            probes + PILOT + sum(len(job.seeds) for job in _jobs(backend, experiment, parameters, machines))
        )

    return {experiment: rollouts(experiment) for experiment in experiments}


def _cached_parameters(
    backend: Backend, experiments: Sequence[Experiment], cache: Cache
) -> dict[str, frozenset[str]]:
    def save(parameters: dict[str, frozenset[str]], path: Path) -> None:
        np.savez(path, names=np.array(json.dumps({e: sorted(names) for e, names in parameters.items()})))

    def load(path: Path) -> dict[str, frozenset[str]]:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return {e: frozenset(names) for e, names in json.loads(str(arrays["names"])).items()}

    place = f"acting/{_key(backend, tuple(experiments), ())}.npz"
    return cache.kept(place, load, lambda: acting_parameters(backend, experiments), save)


def _make(
    backend: Backend,
    experiments: Sequence[Experiment],
    parameters: Sequence[EffectAxis],
    executor: Callable[[], Executor] | None,
    progress: Progress,
) -> dict[Experiment, Response]:
    if not experiments:
        return {}
    observables = {e: Observables.of_nominal(list(_nominal(backend, e))) for e in experiments}
    machines = _machines(parameters, list(backend.variants()) if isinstance(backend, HasVariants) else [])
    jobs = list(dict.fromkeys(job for e in experiments for job in _jobs(backend, e, parameters, machines)))
    # The longest jobs first, so that no worker waits for the last one.
    jobs.sort(key=lambda job: -observables[job.experiment].duration * len(job.seeds))
    runs: dict[_Job, NDArray[np.float32]] = {}
    with (executor or in_this_process)() as pool:
        pending = {pool.submit(vectors, backend, job, observables[job.experiment]): job for job in jobs}
        try:
            for done, future in enumerate(as_completed(pending), 1):
                runs[pending[future]] = future.result()
                progress("simulating every effect", done, len(jobs))
        except BrokenExecutor:
            raise BackendError(
                f"a worker died while it simulated effects on backend {backend.name!r}; run it again with --workers 1 "
                f"to see the experiment that kills it"
            ) from None
        finally:
            for future in pending:
                future.cancel()
    return {e: _response(backend, e, observables[e], parameters, machines, runs) for e in experiments}


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
class _Machine:
    """A practice machine: its (K,) coordinates, and the name of its variant; "" for none."""

    theta: FloatArray
    variant: str


def _machines(parameters: Sequence[EffectAxis], variants: Sequence[str]) -> list[_Machine]:
    """Return the practice machines; the same for every experiment."""
    return [_machine(parameters, sorted(variants), number) for number in range(MACHINES)]


def _machine(parameters: Sequence[EffectAxis], variants: Sequence[str], number: int) -> _Machine:
    """Return a practice machine. Every parameter has a stream of its own, so that their order changes nothing."""

    def stream(name: str) -> np.random.Generator:
        return np.random.default_rng(
            np.random.SeedSequence(SEED, spawn_key=(number, zlib.crc32(name.encode())))
        )

    theta, turn = np.zeros(len(parameters)), np.ones(len(parameters))
    sizes = np.zeros(len(parameters))
    for k, axis in enumerate(parameters):
        random = stream(axis.name)
        low, high = sorted((axis.coordinate(axis.low), axis.coordinate(axis.high)))
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
    return _Machine(theta, str(random.choice(["", *variants])))


def _jobs(
    backend: Backend, experiment: Experiment, parameters: Sequence[EffectAxis], machines: Sequence[_Machine]
) -> Iterator[_Job]:
    yield _nominal_job(experiment)
    for axis in parameters:
        for coordinate in _points(axis):
            yield _point_job(experiment, axis, coordinate)
    for name in backend.variants() if isinstance(backend, HasVariants) else ():
        yield _Job(experiment, (), name, _seeds(experiment))
    for number, machine in enumerate(machines):
        yield _practice_job(experiment, parameters, machine, number)


def _nominal_job(experiment: Experiment) -> _Job:
    return _Job(experiment, (), "", tuple(range(SEED, SEED + NOMINAL)))


def _point_job(experiment: Experiment, axis: EffectAxis, coordinate: float) -> _Job:
    """Return the runs of one point; at a coordinate of ±1 there are two, which show the scatter of the response."""
    seeds = (SEED, SEED + 1) if abs(coordinate) == _middle_size(axis, coordinate) else _seeds(experiment)
    return _Job(experiment, _freeze(axis.at(axis.value(coordinate))), "", seeds)


def _practice_job(
    experiment: Experiment, parameters: Sequence[EffectAxis], machine: _Machine, number: int
) -> _Job:
    values = ResponseLibrary(tuple(parameters), ()).values(machine.theta)
    return _Job(experiment, _freeze(values), machine.variant, (SEED + NOMINAL + number,))


def _points(axis: EffectAxis) -> list[float]:
    """Return the coordinates of a response, rising, without 0; of an angle that may be any, the quarters of a turn."""
    if axis.is_phase:
        return [-0.5, 0.5, 1.0]
    ends = [axis.coordinate(axis.low), axis.coordinate(axis.high)]
    points = set()
    for sign in (-1.0, 1.0):
        reach = max((sign * end for end in ends), default=0.0)
        points |= {sign * min(point, reach) for point in POINTS if reach > 1e-9 and point < 1.5 * reach}
    return sorted(points)


def _middle_size(axis: EffectAxis, coordinate: float) -> float:
    """Return the size nearest to 1 of all points on the same side."""
    side = [abs(c) for c in _points(axis) if c * coordinate > 0.0]
    return min(side, key=lambda size: abs(size - 1.0))


def _response(
    backend: Backend,
    experiment: Experiment,
    observables: Observables,
    parameters: Sequence[EffectAxis],
    machines: Sequence[_Machine],
    runs: Mapping[_Job, NDArray[np.float32]],
) -> Response:
    nominal = runs[_nominal_job(experiment)].astype(float)
    reference = nominal[: len(_seeds(experiment))].mean(axis=0)
    curves, spread = [], np.zeros((len(parameters), reference.size))
    for k, axis in enumerate(parameters):
        # A dependent parameter's response is that beside the first parameter of its effect.
        before = nominal
        if axis.base:
            first = next(p for p in parameters if p.effect == axis.effect and not p.base)
            at = first.coordinate(first.at_typical())
            before = runs[_point_job(experiment, first, min(_points(first), key=lambda c: abs(c - at)))]
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
        curves.append(kind(np.array(order), np.array([points[c] for c in order])))
        spread[k] = np.mean(scatter, axis=0) if scatter else 0.0
    names = list(backend.variants()) if isinstance(backend, HasVariants) else []
    variants = [
        runs[_Job(experiment, (), name, _seeds(experiment))].mean(axis=0) - reference for name in names
    ]
    practice = Practice(
        np.array([machine.theta for machine in machines]),
        np.array([[float(machine.variant == name) for name in names] for machine in machines]),
        np.array(
            [runs[_practice_job(experiment, parameters, m, n)][0] for n, m in enumerate(machines)],
            dtype=float,
        ),
    )
    return Response(
        experiment,
        observables,
        nominal.mean(axis=0),
        _single_precision(nominal.std(axis=0, ddof=1)),
        reference,
        tuple(replace(curve, values=_single_precision(curve.values)) for curve in curves),
        _single_precision(spread),
        _single_precision(np.array(variants).reshape(len(names), reference.size)),
        practice,
    )


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


def simulated_mean(
    backend: Backend, observables: Observables, experiment: Experiment, values: Values
) -> FloatArray:
    """Return (m,) the mean of an experiment with these effects, in the observables and with the seeds of a response."""
    job = _Job(experiment, _freeze(values), "", _seeds(experiment))
    return np.asarray(vectors(backend, job, observables).astype(float).mean(axis=0))


def acting_parameters(backend: Backend, experiments: Sequence[Experiment]) -> dict[str, frozenset[str]]:
    """Return effect → parameters that change some experiment while the effect's others are nominal.

    Only an effect of several parameters is tried; without a parameter that acts alone it is left out.
    """
    parameters = {}
    nominal: dict[Experiment, Trace] = {}
    for effect in catalogue_of(backend):
        if len(effect.parameters) < 2:
            continue
        able = set()
        for parameter in effect.parameters:
            one = effect_axis(effect, parameter)
            assert isinstance(backend, HasEffects)
            changed = backend.with_effects(one.at(one.at_typical()))
            for experiment in experiments:
                if experiment not in nominal:
                    nominal[experiment] = experiment.run(backend, SEED)
                if not _is_same(experiment.run(changed, SEED), nominal[experiment]):
                    able.add(parameter.name)
                    break
        if able:
            parameters[effect.name] = frozenset(able)
    return parameters


def _is_same(a: Trace, b: Trace) -> bool:
    return len(a) == len(b) and all(np.array_equal(a[name], b[name], equal_nan=True) for name in b.channels)


def _freeze(values: Values) -> tuple[tuple[str, tuple[tuple[str, float], ...]], ...]:
    return tuple((effect, tuple(sorted(numbers.items()))) for effect, numbers in sorted(values.items()))


def _seeds(experiment: Experiment) -> tuple[int, ...]:
    return tuple(range(SEED, SEED + REPLICATES["protocol" if experiment.protocol else "test"]))


def _key(backend: Backend, experiment: object, parameters: Sequence[EffectAxis]) -> str:
    """Return a hash of everything that a response depends on.

    A model's hash says what its rollouts are. Its residuals and variants are of other source, and the observables are
    of ours, so the sources of both count, too.
    """
    what = (
        (VERSION, BACKGROUND),
        (backend.name, backend.model_hash, backend.duration),
        source_of(type(backend)),
        [path.read_text() for path in sorted(Path(__file__).parent.glob("*.py"))],
        experiment,
        [asdict(axis) for axis in parameters],
    )
    return hashlib.sha256(repr(what).encode()).hexdigest()[:24]


def _save(response: Response, path: Path) -> None:
    o = response.observables
    header = {
        "protocol": response.experiment.protocol,
        "params": response.experiment.params,
        "duration": o.duration,
        "flags": o.flags,
        "clocked": o.clocked,
        "turns": [isinstance(curve, Turn) for curve in response.curves],
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
        spread=response.spread.astype(np.float32),
        variants=response.variants.astype(np.float32),
        theta=response.practice.theta,
        variant=response.practice.variant,
        practice=response.practice.values.astype(np.float32),
    )


def _load(path: Path) -> Response:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        header = json.loads(str(arrays["header"]))
        edges = np.cumsum(arrays["sizes"])[:-1]
        observables = Observables(
            float(header["duration"]),
            tuple(
                ObservedQuantity(name, channel, minus, np.array(scale))
                for name, channel, minus, scale in header["quantities"]
            ),
            tuple((name, int(width)) for name, width in header["flags"]),
            bool(header["clocked"]),
        )
        response = Response(
            Experiment(header["protocol"], tuple((name, value) for name, value in header["params"])),
            observables,
            arrays["nominal"],
            arrays["scatter"].astype(float),
            arrays["reference"],
            tuple(
                (Turn if turn else ResponseCurve)(*points)
                for turn, *points in zip(
                    header["turns"],
                    np.split(arrays["coordinates"], edges),
                    np.split(arrays["values"].astype(float), edges),
                    strict=True,
                )
            ),
            arrays["spread"].astype(float),
            arrays["variants"].astype(float),
            Practice(arrays["theta"], arrays["variant"], arrays["practice"].astype(float)),
        )
    size, parameters = observables.groups[-1].stop, len(response.curves)
    rows = (response.nominal, response.scatter, response.reference, *response.spread, *response.variants)
    practice = response.practice
    whole = all(row.shape == (size,) for row in (*rows, *practice.values))
    whole &= all(c.values.shape == (c.coordinates.size, size) for c in response.curves)
    whole &= len(response.spread) == practice.theta.shape[1] == parameters
    whole &= len(practice.theta) == len(practice.variant) == len(practice.values)
    if not (whole and practice.variant.shape[1] == len(response.variants)):
        raise ValueError("the arrays do not fit the observables")
    return response
