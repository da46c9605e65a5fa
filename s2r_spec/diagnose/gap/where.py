"""Where the gap lies: in the test space, and, at its worst test, in time, channels and formula."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from s2r_spec.attribution.attribute import Attribution, attribute
from s2r_spec.backend import Backend, HasResiduals
from s2r_spec.base.documentation import page
from s2r_spec.base.errors import TraceError
from s2r_spec.base.json_values import Shown
from s2r_spec.diagnose.gap import FEWEST
from s2r_spec.diagnose.gap.materiality import RolloutsAtTest
from s2r_spec.diagnose.gap.surface import COUNTS, GapSurface, Predicted, gap_surface, grid_of, in_cube
from s2r_spec.diagnose.residuals.shifts import Body, Residuals, shifts
from s2r_spec.diagnose.simulator.axes import Values
from s2r_spec.diagnose.simulator.bench import Bench, Test, TestRun, places_of, table, with_seeds
from s2r_spec.runs.seeds import SeedStream, rollout_seed
from s2r_spec.space import key_of
from s2r_spec.trace import Trace

SECONDS = 10.0
"""Budget: time of one core [s] for both simulators over the test space. Three tests along each axis are run in any
case."""
PLACES = 400
"""Budget: the most tests over the space."""


@dataclass(frozen=True, eq=False)
class WorstPair:
    """The traces behind the attribution, for pictures.

    Attributes:
        backend: the simulator.
        params: the test in the simulator's units.
        real: the real rollout.
        simulated: the simulated rollout.
    """

    backend: Backend
    params: Mapping[str, float]
    real: Trace
    simulated: Trace


@dataclass(frozen=True, eq=False)
class Where(Shown):
    """Where the gap lies.

    Attributes:
        space: the gap over the test space; None if the spec sweeps no parameter, or more than four.
        test: the worst of the tests that were run; the fields below describe a pair of rollouts at this test.
        pair: the pair, with Δρ in parts.
        delta: Δρ = ρ_real − ρ_sim.
        time: the contributions of equal windows of time to Δρ.
        formula: the contributions of the sub-formulas, in written order.
        ended: part of Δρ that the common samples do not show.
        switch: the critical predicates of both traces; None if ρ depends on no predicate.
        body: the parts of the machine whose motion their model does not explain; None if this is unknown.
        no_body: the reason why body is null, in a sentence; None if there is a body.
        traces: both rollouts at the worst test; None without a simulator. They are not in the JSON object.
    """

    space: GapSurface | None
    test: Mapping[str, float]
    pair: Attribution
    body: Body | None = None
    no_body: str | None = None
    traces: WorstPair | None = None

    JSON = (
        "space test delta=pair.delta time=pair.windows formula=pair.parts channels=pair.channels ended=pair.ended "
        "switch=pair.switch body no_body"
    )


def locate(
    bench: Bench,
    rollouts: Sequence[TestRun],
    improved: Values,
    seed: int = 0,
    progress: Callable[[str, int, int], None] = lambda stage, done, of: None,
) -> Where:
    """Return where the gap lies, from real rollouts and as many of the nominal simulator.

    The ``improved`` simulator predicts the gap between the tests that were run.
    """
    tests, simulated = [test for test, _ in rollouts], []
    for number, test in enumerate(tests):
        simulated.append((test, bench.run({}, test, rollout_seed(seed, number, 0, SeedStream.CHECK))))
        progress("where", number + 1, len(rollouts))
    progress("where in the machine and between the tests", 0, 0)
    real, other = (
        np.array([bench.rho(trace, test) for test, trace in side]) for side in (rollouts, simulated)
    )
    spec, places = bench.spec, places_of(tests)
    gaps = tuple(RolloutsAtTest(dict(key), real[at], other[at]) for key, at in places.items())
    space = None
    if spec.space.dim in COUNTS:
        predicted = predict(bench, improved, [gap.params for gap in gaps], seed) if improved else None
        space = gap_surface(spec.space, gaps, spec.unit(bench.requirement), seed=seed, predicted=predicted)
    worst = dict(max(gaps, key=lambda gap: abs(gap.gap)).params)
    first = places[key_of(worst)][0]
    shown = rollouts[first][1], simulated[first][1]
    pair = attribute(spec, bench.requirement, *shown, worst)
    traces = WorstPair(bench.backend, bench.matched.to_backend(worst), *shown)
    return Where(space, worst, pair, *body_of(bench, rollouts, simulated, seed), traces)


def predict(bench: Bench, values: Values, tests: Sequence[Test], seed: int) -> Predicted:
    """Simulate ρ with and without effects, at the tests that were run and over the test space, with the same seeds."""
    from scipy.interpolate import RBFInterpolator

    space = bench.spec.space
    grid = grid_of(space)
    able = min(SECONDS / (2.0 * max(float(bench.backend.cost), 1e-4)), PLACES, len(grid))
    places = space.grid((max(int(able ** (1.0 / space.dim) + 1e-9), 3),) * space.dim)
    every = [*tests, *map(space.point, places)]
    nominal, improved = table(bench, [{}, values], with_seeds(every, seed, SeedStream.FORETELL))[0]
    gap = improved - nominal
    between = RBFInterpolator(in_cube(space, places), gap[len(tests) :], kernel="linear", degree=1)
    return Predicted(gap[: len(tests)], between(in_cube(space, grid)))


def body_of(
    bench: Bench, rollouts: Sequence[TestRun], simulated: Sequence[TestRun], seed: int
) -> tuple[Body | None, str | None]:
    """Return the parts of the machine with motion that their model does not explain, or None and the reason."""
    backend, space = bench.backend, bench.spec.space
    if not isinstance(backend, HasResiduals):
        return None, (
            f"the backend {backend.name!r} computes no residuals, so the gap cannot be traced to parts of the "
            f"machine; see {page('how-to/effects')}"
        )
    tests, residuals, refused = [], [], ""
    for number, ((test, own), (_, first)) in enumerate(zip(rollouts, simulated, strict=True)):
        again, params = (
            bench.run({}, test, rollout_seed(seed, number, 1, SeedStream.CHECK)),
            bench.matched.to_backend(test),
        )
        try:
            residuals.append([Residuals(backend.residuals(one, params), one) for one in (own, first, again)])
            tests.append([test[name] for name in space.names])
        except TraceError as error:
            refused = f": {error}"
    if len(residuals) < FEWEST:
        count = f"only {len(residuals)}" if residuals else "no"
        return None, f"{count} real rollouts have residuals, and at least {FEWEST} are needed{refused}"
    at = in_cube(space, np.array(tests))
    body = shifts(at, [own for own, *_ in residuals], [other for _, *other in residuals], backend.duration)
    return (
        (body, None) if body.asked else (None, f"no window of time has residuals of {FEWEST} real rollouts")
    )
