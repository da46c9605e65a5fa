"""Which loop of code around a controller do tests show, where recordings lack the state for a replay?

Data: observables of the real runs of T tests. Unknown: the loop s, that of the files or one with a mistake, and the
sizes θ (K,) of the effects. Model: that of :mod:`.inference.prediction` with the simulator of loop s for F. Responses
to effects are those of the loop of the files; the simulator of a loop runs at its own estimates.

Estimator: every loop is simulated at every test. The loops whose tests are predicted best by themselves are fitted with
effects, as that of the files is. The weight of a loop is that of its sets: P(s) Σ_A P(A) exp Σ_t w_t ℓ_t(s, A), over
Bayesian bootstrap weights w of the tests. Before, the loop of the files is as likely as all others together. A loop
whose simulator never stands at a test as long as the machine does is none that the machine has.

Units: ℓ in nats. Shapes: T tests, K parameters. Source: see :mod:`.inference.prediction`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from s2r_spec.backend import Backend, HasLoop, LoopMistake
from s2r_spec.base.arrays import FloatArray
from s2r_spec.diagnose.candidates import Predicted, predicted
from s2r_spec.diagnose.inference.model_search import Set
from s2r_spec.diagnose.inference.prediction import DRAWS, Candidate, fitted
from s2r_spec.diagnose.inference.prior import SizePrior
from s2r_spec.diagnose.inference.recorded import Recorded
from s2r_spec.diagnose.quality.loop import Loop, words_of
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.library import place_of, runs_of
from s2r_spec.diagnose.simulator.response import Response, ResponseLibrary, replicates
from s2r_spec.trace import Trace
from s2r_spec.workers.pools import ExecutorFactory

CLEAR = 0.5
"""Level: part of what the loop of the files leaves with its best effects that another loop may leave, to be named. The
laws of effects are not exact, so a smaller difference is no sign of a mistake."""
FITTED = 4
"""Budget: loops that are fitted with effects."""


def rival_loops(
    bench: Bench,
    library: ResponseLibrary,
    tests: Mapping[Experiment, Sequence[Trace]],
    prior: SizePrior,
    cache: Cache,
    progress: Callable[[str, int, int], None],
) -> Loop | None:
    """Return the loop that tests show; None where the files state none, or where there are too few tests."""
    backend, executor = bench.backend, bench.pool
    if not isinstance(backend, HasLoop) or not (mistakes := backend.mistakes()):
        return None
    tests = {e: [e.with_residuals(run, backend) for run in runs] for e, runs in tests.items()}
    found = predicted(backend, library, tests, prior, executor)
    if found is None:
        return None
    data = Recorded.of(backend, library, tests)
    # So that the densities of two loops are of the same numbers.
    numbers = [one.effective for one in data.observations]
    responses = [one.response for one in data.observations]
    alone: dict[LoopMistake, float] = {}
    runs: dict[LoopMistake, list[FloatArray]] = {}
    for number, (mistake, other) in enumerate(mistakes.items()):
        progress("simulating mistakes of the loop", number, len(mistakes))
        rows = _standing(data, _rows(other, responses, executor, cache))
        if rows is not None:
            runs[mistake] = rows
            near = data.near(np.zeros(prior.low.size), rows)
            one = fitted(near, data.background, np.zeros(prior.low.size), prior, ())
            alone[mistake] = float(one.score.sum())
    scores: dict[tuple[LoopMistake, ...], FloatArray] = {(): _scores(found.candidates, prior)}
    left: dict[tuple[LoopMistake, ...], float] = {(): _left(found)}
    for mistake in sorted(alone, key=lambda one: -alone[one])[:FITTED]:
        progress("fitting mistakes of the loop", 0, 0)
        near_it = _library_of(library, responses, runs[mistake])
        own = predicted(mistakes[mistake], near_it, tests, prior, executor, numbers=numbers)
        assert own is not None
        scores[mistake,], left[mistake,] = _scores(own.candidates, prior), _left(own)
    logs = {
        loop: values + np.log(0.5 if not loop else 0.5 / len(mistakes)) for loop, values in scores.items()
    }
    loop = _loop(logs)
    return replace(loop, explained=not loop.mistakes or left[loop.mistakes] <= CLEAR * left[()])


def _left(found: Predicted) -> float:
    """Return the mean square that the best set of a loop leaves, in units of scatter and background."""
    best = max(found.candidates.values(), key=lambda one: float(one.score.sum()))
    return float(best.energy.mean())


def _loop(logs: Mapping[tuple[LoopMistake, ...], FloatArray]) -> Loop:
    """Return the most probable loop, from (draws,) log weights of each."""
    each = np.array([*logs.values()])
    chance = np.exp(each - each.max(axis=0))
    probability = (chance / chance.sum(axis=0)).mean(axis=1)
    order = np.argsort(-probability, kind="stable")
    loops = [*logs]
    first = loops[order[0]]
    rivals = tuple((words_of(loops[k]), float(probability[k])) for k in order[1:])
    words = f"Of {len(loops)} loops that were fitted with effects, this one predicts the tests best."
    return Loop(first, float(probability[order[0]]), rivals, words if first else "")


def _scores(candidates: Mapping[Set, Candidate], prior: SizePrior) -> FloatArray:
    """Return (draws,) log Σ_A P(A) exp Σ_t w_t ℓ_t(A) for bootstrap weights of the tests, the same for every loop."""
    each = np.array([one.score for one in candidates.values()])
    tests = each.shape[1]
    weights = tests * np.random.default_rng(np.random.SeedSequence(0)).dirichlet(np.ones(tests), DRAWS)
    logs = weights @ each.T + [prior.log_odds(members) for members in candidates]
    return np.asarray(np.logaddexp.reduce(logs, axis=1))


def _rows(
    backend: Backend, responses: Sequence[Response], executor: ExecutorFactory | None, cache: Cache
) -> list[FloatArray]:
    """Return (R, m) observables of every test by a loop, from the cache where it has them."""

    def save(rows: list[FloatArray], path: Path) -> None:
        np.savez(path, *rows)

    def load(path: Path) -> list[FloatArray]:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            rows = [arrays[name] for name in arrays.files]
        if [row.shape for row in rows] != [
            (replicates(one.experiment), one.nominal.size) for one in responses
        ]:
            raise ValueError("rows of other observables")
        return rows

    place = place_of(backend, tuple(one.experiment for one in responses), "loops")
    return cache.kept(place, load, lambda: runs_of(backend, responses, executor), save)


def _library_of(
    library: ResponseLibrary, responses: Sequence[Response], rows: Sequence[FloatArray]
) -> ResponseLibrary:
    """Return the library with (R, m) nominal runs of another loop; the responses to effects stay those of its own."""
    own = {
        one.experiment: replace(one, nominal=row.mean(axis=0), reference=row.mean(axis=0), runs=row)
        for one, row in zip(responses, rows, strict=True)
    }
    return replace(library, responses=tuple(own.get(one.experiment, one) for one in library.responses))


def _standing(data: Recorded, rows: Sequence[FloatArray]) -> list[FloatArray] | None:
    """Return the runs of a loop that have every observable of the real runs; None where a test has no such run."""
    found = [
        own[np.isfinite(own[:, one.kept]).all(axis=1)]
        for one, own in zip(data.observations, rows, strict=True)
    ]
    return found if all(map(len, found)) else None
