"""The response library: what every effect does in every experiment, simulated once and kept (:mod:`.response`)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from s2r_spec.backend import Backend, HasVariants
from s2r_spec.backend.effects import catalogue_of
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.inference.prior import BACKGROUND
from s2r_spec.diagnose.simulator.axes import EffectAxis, Values, effect_axes
from s2r_spec.diagnose.simulator.cache import Cache, source_of
from s2r_spec.diagnose.simulator.curve import ResponseCurve, Turn
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.observables import ObservableGroup
from s2r_spec.diagnose.simulator.points import all_points, curved, most_visible, points_of, to_refine
from s2r_spec.diagnose.simulator.practice import MACHINES, practice_machine
from s2r_spec.diagnose.simulator.response import (
    Practice,
    Response,
    ResponseLibrary,
    RobustnessCurve,
    replicates,
    values_at,
)
from s2r_spec.diagnose.simulator.runs import (
    HEALTHY,
    NOMINAL_PILOT,
    PILOT,
    Job,
    Runs,
    acting_parameters,
    each,
    kept,
    simulate,
    vectors,
)
from s2r_spec.diagnose.simulator.score import Score
from s2r_spec.workers.pools import ExecutorFactory

Progress = Callable[[str, int, int], None]
"""Called with stage, number of jobs done, and number of jobs."""

NOMINAL = 8
"""Budget: nominal runs of an experiment, from which its scatter is known to 27 %."""
NOMINAL_REST = Job.of({}, NOMINAL - PILOT, first=PILOT)
"""Definition: the nominal runs beside those that decide the observables."""
CHEAP = 5.0
"""Budget: declared time of all rollouts of a library [s], below which every parameter has all points."""
VERSION = 4
"""Definition: of the arrays; a change makes every library again."""


def library(
    backend: Backend,
    experiments: Sequence[Experiment],
    executor: ExecutorFactory | None = None,
    progress: Progress = lambda stage, done, of: None,
    cache: Cache | None = None,
    score: Score | None = None,
) -> ResponseLibrary:
    """Return the responses of a simulator, as far as possible from runs of the cache.

    Every parameter has its first points; one whose response is no straight line has all of them (:mod:`.points`). With
    a score, the tests have ρ beside every size.

    Raises:
        UsageError: the backend declares no effects.
        BackendError: a nominal run fails, or responses to a variant are no numbers.
    """
    cache = Cache.usual() if cache is None else cache
    acts = _cached_parameters(backend, experiments, cache)
    axes = effect_axes(catalogue_of(backend), acts)
    some, whole = (_Design.of(backend, axes, names) for names in ((), {axis.name for axis in axes}))
    jobs = [job for experiment in experiments for job in whole.jobs(experiment)]
    quick = backend.cost * sum(len(job.seeds) for job in jobs) < CHEAP
    tell = partial(progress, "simulating every effect")
    designs = dict.fromkeys(experiments, whole if quick else some)
    simulated = _responses(backend, designs, executor, tell, cache, score)
    first = ResponseLibrary(some.parameters, simulated, score)
    if quick:
        return first
    tell = partial(progress, "simulating small sizes")
    bent = curved(refined(backend, first, most_visible(first), executor, tell, cache))
    if not bent:
        return first
    tell = partial(progress, "simulating all sizes of some effects")
    return refined(backend, first, dict.fromkeys(experiments, bent), executor, tell, cache)


def refined(
    backend: Backend,
    first: ResponseLibrary,
    wanted: Mapping[Experiment, Collection[str]],
    executor: ExecutorFactory | None,
    progress: Callable[[int, int], None],
    cache: Cache,
) -> ResponseLibrary:
    """Return a library with all points of further parameters: experiment → their names (:mod:`.points`).

    Raises:
        BackendError: a worker dies.
    """
    every = {
        experiment: frozenset(names) | all_points(first.parameters, first.response(experiment))
        for experiment, names in wanted.items()
    }
    made = {names: _Design.of(backend, first.parameters, names) for names in set(every.values())}
    designs = {experiment: made[names] for experiment, names in every.items()}
    finer = _responses(backend, designs, executor, progress, cache, first.score)
    own = {one.experiment: one for one in (*first.responses, *finer)}
    return replace(first, responses=tuple(own[e] for e in first.experiments))


def refined_at(
    backend: Backend,
    first: ResponseLibrary,
    executor: ExecutorFactory | None,
    progress: Progress,
    cache: Cache,
    mean: FloatArray,
    deviation: FloatArray,
) -> ResponseLibrary | None:
    """Return a library with all points of the parameters that may be large, by (K,) mean ± deviation; None for none."""
    names = to_refine(first.parameters, mean, deviation)
    if all(names <= all_points(first.parameters, response) for response in first.responses):
        return None
    tell = partial(progress, "simulating more sizes")
    finer = refined(backend, first, dict.fromkeys(first.experiments, names), executor, tell, cache)
    progress("estimating sizes again", 0, 0)
    return finer


def _responses(
    backend: Backend,
    designs: Mapping[Experiment, _Design],
    executor: ExecutorFactory | None,
    progress: Callable[[int, int], None],
    cache: Cache,
    score: Score | None,
) -> tuple[Response, ...]:
    wanted = {experiment: design.jobs(experiment) for experiment, design in designs.items()}
    places = {experiment: place_of(backend, experiment) for experiment in designs}
    runs = simulate(backend, wanted, places, cache, executor, progress, score)
    return tuple(
        replace(design.response(e, runs[e]), robustness=design.robustness(e, runs[e], score))
        for e, design in designs.items()
    )


def most_rollouts(
    backend: Backend,
    experiments: Sequence[Experiment],
    cache: Cache,
    score: Score | None = None,
) -> dict[Experiment, int]:
    """Return experiment → largest number of rollouts that its response takes; 0 where the cache has the first points.

    Runs nothing. Which parameters need all points is known only later, so all count. Which act alone is known only
    after :func:`acting_parameters`; without its result in the cache every parameter counts, and no run of the cache.
    """
    tried = (cache.folder / place_of(backend, tuple(experiments))).is_file()
    acts = _cached_parameters(backend, experiments, cache) if tried else None
    axes = effect_axes(catalogue_of(backend), acts)
    first, every = (_Design.of(backend, axes, names) for names in ((), {axis.name for axis in axes}))
    several = [e.parameters for e in catalogue_of(backend) if len(e.parameters) > 1]
    probes = 0 if tried else 1 + sum(map(len, several))
    have = kept(cache, {e: place_of(backend, e) for e in experiments}) if tried else {}

    def rollouts(experiment: Experiment) -> int:
        runs, needed = have.get(experiment), None if experiment.protocol else score

        def missing(design: _Design) -> int:
            jobs = design.jobs(experiment)
            count = sum(len(job.seeds) for job in jobs if runs is None or runs.lacks(job, needed))
            return count + (HEALTHY if runs is None else 0)

        return probes + missing(every) if missing(first) else 0

    return {experiment: rollouts(experiment) for experiment in experiments}


def _cached_parameters(
    backend: Backend, experiments: Sequence[Experiment], cache: Cache
) -> dict[str, frozenset[str]]:
    def save(parameters: dict[str, frozenset[str]], path: Path) -> None:
        np.savez(path, names=np.array(json.dumps({e: sorted(names) for e, names in parameters.items()})))

    def load(path: Path) -> dict[str, frozenset[str]]:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            return {e: frozenset(names) for e, names in json.loads(str(arrays["names"])).items()}

    place = place_of(backend, tuple(experiments))
    return cache.kept(place, load, lambda: acting_parameters(backend, experiments), save)


@dataclass(frozen=True)
class _Design:
    """The runs of every experiment, and the response that they give."""

    parameters: tuple[EffectAxis, ...]
    variants: tuple[str, ...]
    points: tuple[tuple[float, ...], ...]
    """Coordinates of the response to every parameter."""

    @classmethod
    def of(cls, backend: Backend, parameters: Sequence[EffectAxis], refined: Collection[str] = ()) -> _Design:
        variants = backend.variants() if isinstance(backend, HasVariants) else ()
        points = tuple(points_of(axis, axis.name in refined) for axis in parameters)
        return cls(tuple(parameters), tuple(variants), points)

    @cached_property
    def machines(self) -> list[tuple[FloatArray, str]]:
        """(K,) coordinates and variant of every practice machine; the same for every experiment."""
        return [practice_machine(self.parameters, self.variants, number) for number in range(MACHINES)]

    def jobs(self, experiment: Experiment) -> list[Job]:
        """Return all runs of an experiment."""
        points = [
            _point_job(experiment, axis, coordinate)
            for axis, coordinates in zip(self.parameters, self.points, strict=True)
            for coordinate in coordinates
        ]
        others = [*self._variant_jobs(experiment), *self._practice_jobs()]
        return list(dict.fromkeys([NOMINAL_PILOT, NOMINAL_REST, *points, *others]))

    def _variant_jobs(self, experiment: Experiment) -> list[Job]:
        """Return the runs of the variants: those of all nominal seeds, where a motion scatters."""
        number = replicates(experiment) if experiment.protocol else NOMINAL
        return [Job.of({}, number, name) for name in self.variants]

    def _practice_jobs(self) -> list[Job]:
        return [
            Job.of(values_at(self.parameters, at), 1, name, NOMINAL + number)
            for number, (at, name) in enumerate(self.machines)
        ]

    def robustness(
        self, experiment: Experiment, runs: Runs, score: Score | None
    ) -> dict[int, RobustnessCurve]:
        """Return ρ of a test over every parameter that acts alone, by its place; none of a protocol."""
        scores = {} if score is None else runs.scores.get(score.key, {})
        curves = {}
        for k, axis in enumerate(self.parameters if scores else ()):
            if not axis.base:
                jobs = {
                    axis.coordinate(axis.value(at)): _point_job(experiment, axis, at) for at in self.points[k]
                }
                nominal = scores[NOMINAL_PILOT][: replicates(experiment)]
                curves[k] = RobustnessCurve.of({0.0: nominal} | {at: scores[job] for at, job in jobs.items()})
        return curves

    def response(self, experiment: Experiment, runs: Runs) -> Response:
        """Return the response of an experiment from its runs."""
        observables, rows = runs.observables, runs.rows
        nominal = np.vstack([rows[NOMINAL_PILOT], rows[NOMINAL_REST]]).astype(float)
        reference = nominal[: replicates(experiment)].mean(axis=0)
        curves, spread = [], np.zeros((len(self.parameters), reference.size))
        for k, axis in enumerate(self.parameters):
            before = nominal
            if axis.base:
                # A dependent parameter's response is that beside the first parameter of its effect.
                first = next(p for p in self.parameters if axis.stands_beside(p))
                at = first.coordinate(first.at_typical())
                near = min(points_of(first), key=lambda c: abs(c - at))
                before = rows[_point_job(experiment, first, near)]
            each = {
                axis.coordinate(axis.value(at)): rows[_point_job(experiment, axis, at)].astype(float)
                for at in self.points[k]
            }
            typical = [axis.coordinate(axis.value(at)) for at in points_of(axis)]
            curve, spread[k] = _curve(each, before, typical, observables.groups)
            curves.append(Turn(curve.coordinates, curve.values, curve.noise) if axis.is_phase else curve)
        variants = [
            _curve({1.0: rows[job].astype(float)}, nominal, [1.0], observables.groups)[0]
            for job in self._variant_jobs(experiment)
        ]
        return Response(
            experiment,
            observables,
            nominal.mean(axis=0),
            nominal.std(axis=0, ddof=1),
            reference,
            tuple(curves),
            spread,
            tuple(variants),
            Practice(
                np.array([theta for theta, _ in self.machines]),
                np.array([[float(own == name) for name in self.variants] for _, own in self.machines]),
                np.array([rows[job][0] for job in self._practice_jobs()], dtype=float),
            ),
            nominal,
        )


def _point_job(experiment: Experiment, axis: EffectAxis, coordinate: float) -> Job:
    """Return the runs of one point; of the first points there are two, which show the scatter of the response."""
    return Job.of(
        axis.at(axis.value(coordinate)), 2 if coordinate in points_of(axis) else replicates(experiment)
    )


def _curve(
    runs: Mapping[float, FloatArray],
    before: FloatArray,
    first: Sequence[float],
    groups: Sequence[ObservableGroup],
) -> tuple[ResponseCurve, FloatArray]:
    """Return the response from coordinate → (runs, m), and (m,) its variance from run to run for a coordinate of 1.

    This variance is that of the ``first`` coordinates. A point with one run has it, too. ``before`` has the runs with
    the same seeds from which the response is measured.
    """
    moved = {at: own - before[: len(own)] for at, own in runs.items()}
    moved = {
        at: own for at, own in moved.items() if np.isfinite(own).any()
    }  # one that fell at once shows nothing
    scatter = {at: _scatter(own, groups) for at, own in moved.items() if len(own) > 1}
    known = {at: scatter[at] for at in first if at in scatter}
    zero = np.zeros(before.shape[1])
    values, noise = {0.0: zero}, {0.0: zero}
    for at, own in moved.items():
        same_side = [one for side, one in known.items() if side * at > 0.0]
        values[at] = own.mean(axis=0)
        noise[at] = scatter.get(at, [*same_side, *known.values(), zero][0]) / len(own)
    order = sorted(values)
    points = (np.array([of[at] for at in order]) for of in (values, noise))
    curve = ResponseCurve(np.array(order), *points)
    return curve, np.sum([*known.values()], axis=0) / sum(at**2 for at in known) if known else zero


def _scatter(moved: FloatArray, groups: Sequence[ObservableGroup]) -> FloatArray:
    """Return (m,) the variance of a response from (runs, m), half of it spread over each group: two runs say little.

    An observable that a run lacks, since it ended early, scatters by as much as it moves.
    """
    variance = moved.var(axis=0, ddof=1)
    there = np.isfinite(variance)
    if not there.all():
        variance = np.where(there, variance, np.nan_to_num(np.nanmax(np.nan_to_num(moved) ** 2, axis=0)))
    for group in (one for one in groups if one.start < one.stop):
        part = variance[group.start : group.stop]
        variance[group.start : group.stop] = 0.5 * (part + part.mean())
    return np.asarray(variance)


def simulated_rows(
    backend: Backend,
    responses: Sequence[Response],
    values: Values,
    executor: ExecutorFactory | None = None,
    runs: int = 0,
) -> list[FloatArray]:
    """Return (runs, m) observables of every experiment with these effects; without a number, those of its response."""
    number = [runs or replicates(one.experiment) for one in responses]
    if not values and all(count <= len(one.runs) for one, count in zip(responses, number, strict=True)):
        return [one.runs[:count] for one, count in zip(responses, number, strict=True)]
    return runs_of(backend, responses, executor, values, number)


def runs_of(
    backend: Backend,
    responses: Sequence[Response],
    executor: ExecutorFactory | None = None,
    values: Values | None = None,
    number: Sequence[int] = (),
) -> list[FloatArray]:
    """Return (runs, m) observables of new runs of every experiment, whose backend may be another one."""
    values, counts = values or {}, number or [replicates(one.experiment) for one in responses]
    wanted = {
        (one.experiment, Job.of(values, count)): (one.observables,)
        for one, count in zip(responses, counts, strict=True)
    }
    rows = dict(each(backend, vectors, wanted, executor, f"ran backend {backend.name!r} with {values}"))
    return [rows[key].astype(float) for key in wanted]


def place_of(backend: Backend, of: object, folder: str = "acting") -> str:
    """Return the file of the runs of an experiment, or in another folder what is known of several.

    A model's hash says what its rollouts are. Its residuals and variants are of other source, and the observables are
    of ours, so the sources of both count, too.
    """
    what = (
        (VERSION, BACKGROUND),
        (backend.name, backend.model_hash, backend.duration),
        source_of(type(backend)),
        [path.read_text() for path in sorted(Path(__file__).parent.glob("*.py"))],
        of,
    )
    folder = "responses" if isinstance(of, Experiment) else folder
    return f"{folder}/{hashlib.sha256(repr(what).encode()).hexdigest()[:24]}.npz"
