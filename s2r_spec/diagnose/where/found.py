"""Where the gap lies: in the test space, and, at its worst test, in time, channels and formula."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from s2r_spec.backend import HasResiduals
from s2r_spec.diagnose.design import unit_box
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.diagnose.where.attribution import Attribution, attribute
from s2r_spec.diagnose.where.body import FEWEST, Body, Residuals, body
from s2r_spec.diagnose.where.foretell import foretell
from s2r_spec.diagnose.where.gaps import GapAt
from s2r_spec.diagnose.where.space import MOST_AXES, InSpace, in_space
from s2r_spec.documentation import page
from s2r_spec.errors import TraceError
from s2r_spec.rollouts.seeds import Stream, rollout_seed
from s2r_spec.space import key_of
from s2r_spec.spec import Spec
from s2r_spec.trace import Trace

NOT_ASKED = "no simulator with residuals was given, so the gap cannot be traced to parts of the machine"
WINDOWS = 6
"""Equal windows of time over which Δρ is summed."""


@dataclass(frozen=True, eq=False)
class Where:
    """Where the gap lies.

    Attributes:
        space: over the test space; None where the spec sweeps no parameter, or more than four.
        test: the test with the largest mean gap, of those that were run.
        pair: Δρ of a real and a simulated rollout there, taken apart.
        body: which parts of the machine do what their model does not explain; None where it cannot be said.
        no_body: why not, in a sentence; "" where it is said.
    """

    space: InSpace | None
    test: Mapping[str, float]
    pair: Attribution
    body: Body | None = None
    no_body: str = NOT_ASKED

    def windows(self) -> list[dict[str, float]]:
        """Return begin, end [s] and share of Δρ of equal windows of time."""
        edges = np.linspace(self.pair.times[0], self.pair.times[-1], WINDOWS + 1)
        place = np.clip(np.searchsorted(edges, self.pair.times, side="right") - 1, 0, WINDOWS - 1)
        sums = np.bincount(place, weights=self.pair.over_time, minlength=WINDOWS)
        return [
            {"begin": float(low), "end": float(high), "delta": float(amount)}
            for low, high, amount in zip(edges[:-1], edges[1:], sums, strict=True)
        ]

    @property
    def window(self) -> dict[str, float] | None:
        """The one of these in which most of Δρ lies; None where more lies in how a trace ended, which no window has."""
        most = max(self.windows(), key=lambda each: abs(each["delta"]))
        return most if abs(most["delta"]) >= abs(self.pair.ended) else None

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        apart = self.pair.to_json()
        return {
            "space": None if self.space is None else self.space.to_json(),
            "test": dict(self.test),
            "delta": apart["delta"],
            "time": self.windows(),
            "formula": apart["parts"],
            "channels": apart["channels"],
            "ended": apart["ended"],
            "switch": apart["switch"],
            "trace": self.pair.binned(),
            "body": None if self.body is None else self.body.to_json(),
            "no_body": self.no_body or None,
        }


def where(
    spec: Spec,
    requirement: str,
    tests: Sequence[Mapping[str, float]],
    real: Sequence[tuple[Trace, float]],
    simulated: Sequence[tuple[Trace, float]],
    seed: int = 0,
    bench: Bench | None = None,
    improved: Mapping[str, Mapping[str, float]] | None = None,
    executor: Callable[[], Executor] | None = None,
) -> Where:
    """Return where the gap lies.

    Args:
        spec: the specification.
        requirement: one of its requirements.
        tests: n of them, some alike.
        real: (trace, ρ) of the real rollout of each.
        simulated: the same of a simulated one.
        seed: of what is sampled.
        bench: the simulator, for the parts of the machine; each test is then simulated once more.
        improved: effects with which the simulator is nearer to the machine, to say where the gap is largest
            between the tests that were run.
        executor: makes a pool for the simulations of that; None runs them here.
    """
    places: dict[tuple[tuple[str, float], ...], list[int]] = {}
    for i, test in enumerate(tests):
        places.setdefault(key_of(test), []).append(i)
    gaps = tuple(
        GapAt(dict(key), np.array([real[i][1] for i in mine]), np.array([simulated[i][1] for i in mine]))
        for key, mine in places.items()
    )
    space = None
    if 1 <= spec.space.dim <= MOST_AXES:
        at = [gap.params for gap in gaps]
        foretold = foretell(bench, improved, at, seed, executor) if bench and improved else None
        space = in_space(spec.space, gaps, spec.unit(requirement), seed=seed, foretold=foretold)
    worst = max(gaps, key=lambda gap: abs(gap.signed))
    first = places[key_of(worst.params)][0]
    pair = attribute(spec, requirement, real[first][0], simulated[first][0], dict(worst.params))
    found, why = (None, NOT_ASKED) if bench is None else body_of(bench, tests, real, simulated, seed)
    return Where(space, dict(worst.params), pair, found, why)


def body_of(
    bench: Bench,
    tests: Sequence[Mapping[str, float]],
    real: Sequence[tuple[Trace, float]],
    simulated: Sequence[tuple[Trace, float]],
    seed: int,
) -> tuple[Body | None, str]:
    """Return which parts of the machine do what their model does not explain, or None and why that cannot be said.

    Arguments are those of :func:`where`.
    """
    backend = bench.backend
    if not isinstance(backend, HasResiduals):
        return None, (
            f"the backend {backend.name!r} computes no residuals, so the gap cannot be traced to parts of the "
            f"machine; see {page('how-to/effects')}"
        )

    def unexplained(trace: Trace, test: Mapping[str, float]) -> Residuals:
        return Residuals(backend.residuals(trace, bench.matched.to_backend(test)), trace)

    own, other, at = [], [], []
    said = ""
    for number, (test, (trace, _), (first, _)) in enumerate(zip(tests, real, simulated, strict=True)):
        again = bench.run({}, test, rollout_seed(seed, number, 1, Stream.CHECK))
        try:
            three = [unexplained(one, test) for one in (trace, first, again)]
        except TraceError as error:
            said = str(error)
            continue
        own.append(three[0])
        other.append(three[1:])
        at.append(test)
    if len(own) < FEWEST:
        few = f"residuals exist for only {len(own)} real rollouts, and at least {FEWEST} are needed"
        return None, f"{few}: {said}" if said else few
    found = body(unit_box(bench.spec.space, at), own, other, bench.backend.duration)
    if not found.asked:
        return None, f"no window of time has residuals of {FEWEST} real rollouts"
    return found, ""
