"""Where the gap lies: in the test space, and, at its worst test, in time, channels and formula."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from s2r_spec.attribution.attribute import Attribution, attribute
from s2r_spec.backend import HasResiduals
from s2r_spec.diagnose.gap.body import FEWEST, Body, Residuals, shifts
from s2r_spec.diagnose.gap.materiality import RolloutsAtTest
from s2r_spec.diagnose.gap.predicted import predict
from s2r_spec.diagnose.gap.surface import GapSurface, gap_surface
from s2r_spec.diagnose.gap.test_space import COUNTS, in_cube
from s2r_spec.diagnose.simulate import Bench, places_of
from s2r_spec.documentation import page
from s2r_spec.errors import TraceError
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.space import key_of
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

NO_SIMULATOR = "no simulator with residuals was given, so the gap cannot be traced to parts of the machine"


@dataclass(frozen=True, eq=False)
class Where:
    """Where the gap lies.

    Attributes:
        space: over the test space; None if the spec sweeps no parameter, or more than four.
        test: the test with the largest mean gap, of those that were run.
        pair: Δρ of a real and a simulated rollout of this test, in parts.
        body: the parts of the machine with motion that their model does not explain; None if residuals are missing.
        no_body: why ``body`` is missing, in a sentence; "" if it is there.
    """

    space: GapSurface | None
    test: Mapping[str, float]
    pair: Attribution
    body: Body | None = None
    no_body: str = NO_SIMULATOR

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        apart = self.pair.to_json()
        return {
            "space": None if self.space is None else self.space.to_json(),
            "test": dict(self.test),
            "delta": apart["delta"],
            "time": [asdict(window) for window in self.pair.windows()],
            "formula": apart["parts"],
            "channels": apart["channels"],
            "ended": apart["ended"],
            "switch": apart["switch"],
            "trace": self.pair.binned(),
            "body": None if self.body is None else self.body.to_json(),
            "no_body": self.no_body or None,
        }


@dataclass(frozen=True)
class Pairs:
    """n real rollouts, and a simulated one beside each.

    Attributes:
        tests: n tests; several may be equal.
        real: n pairs of a trace and its ρ.
        simulated: the same of the nominal simulator at the same tests.
    """

    tests: Sequence[Mapping[str, float]]
    real: Sequence[tuple[Trace, float]]
    simulated: Sequence[tuple[Trace, float]]


def where(
    spec: Spec,
    requirement: str,
    pairs: Pairs,
    seed: int = 0,
    bench: Bench | None = None,
    improved: Mapping[str, Mapping[str, float]] | None = None,
    executor: Callable[[], Executor] | None = None,
) -> Where:
    """Return where the gap lies.

    Args:
        spec: the specification.
        requirement: one of its requirements.
        pairs: the rollouts.
        seed: of the random numbers.
        bench: the simulator, for the parts of the machine; it simulates each test once more.
        improved: effects of an improved simulator, which predicts the gap between the tests that were run.
        executor: makes a pool for these simulations; None runs them here.
    """
    places = places_of(pairs.tests)
    real, simulated = (np.array([rho for _, rho in side]) for side in (pairs.real, pairs.simulated))
    gaps = tuple(RolloutsAtTest(dict(key), real[at], simulated[at]) for key, at in places.items())
    space = None
    if spec.space.dim in COUNTS:
        at = [gap.params for gap in gaps]
        predicted = predict(bench, improved, at, seed, executor) if bench and improved else None
        space = gap_surface(spec.space, gaps, spec.unit(requirement), seed=seed, predicted=predicted)
    worst = max(gaps, key=lambda gap: abs(gap.gap))
    first = places[key_of(worst.params)][0]
    pair = attribute(spec, requirement, pairs.real[first][0], pairs.simulated[first][0], dict(worst.params))
    body, no_body = (None, NO_SIMULATOR) if bench is None else body_of(bench, pairs, seed)
    return Where(space, dict(worst.params), pair, body, no_body)


def body_of(bench: Bench, pairs: Pairs, seed: int) -> tuple[Body | None, str]:
    """Return the parts of the machine with motion that their model does not explain, or None and the reason in words.

    Each test is simulated once more, with a seed that follows from ``seed``.
    """
    backend = bench.backend
    if not isinstance(backend, HasResiduals):
        return None, (
            f"the backend {backend.name!r} computes no residuals, so the gap cannot be traced to parts of the "
            f"machine; see {page('how-to/effects')}"
        )

    def unexplained(trace: Trace, test: Mapping[str, float]) -> Residuals:
        return Residuals(backend.residuals(trace, bench.matched.to_backend(test)), trace)

    real, simulated, tests = [], [], []
    refused = ""
    for number, (test, (own, _), (first, _)) in enumerate(
        zip(pairs.tests, pairs.real, pairs.simulated, strict=True)
    ):
        again = bench.run({}, test, rollout_seed(seed, number, 1, Stream.CHECK))
        try:
            residuals = [unexplained(trace, test) for trace in (own, first, again)]
        except TraceError as error:
            refused = str(error)
            continue
        real.append(residuals[0])
        simulated.append(residuals[1:])
        tests.append(test)
    if len(real) < FEWEST:
        few = f"residuals exist for only {len(real)} real rollouts, and at least {FEWEST} are needed"
        return None, f"{few}: {refused}" if refused else few
    space = bench.spec.space
    places = np.array([[test[name] for name in space.names] for test in tests])
    body = shifts(in_cube(space, places), real, simulated, bench.backend.duration)
    if not body.asked:
        return None, f"no window of time has residuals of {FEWEST} real rollouts"
    return body, ""
