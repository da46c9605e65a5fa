"""Before the data: which effects a plan of runs identifies, which only together, and which further run would.

Data: none; the plan has n_p runs of experiment p. Model: that of :mod:`.experiment_design.identifiability`, for a
machine that scatters as the simulator does and has parameter k alone at its typical size, all others within σ_bg:

    L_k = B (1 + S B)⁻¹,   B = Σ_p B_p at e_k       information about θ; S is the error that all groups share
    D²_k(A) = e_kᵀ (L_k⁻¹ + P_A)⁻¹ e_k              squared distance of the data from what the set A explains

P_A is the variance of every size given A: σ_bg², or for a member max(e, σ_slab)² with e the larger end of its range,
and σ_slab² if that is infinite. k is *not seen* if D_k(∅) < 3, *only together* with every j of D_k({j}) < 3, else
identified *alone*. Pairs are no rivals: the prior makes them twenty times as rare. A parameter that acts only beside
another is free in the effects of A and of k. The half-width of k is 1.645 √[(L_k + P⁻¹)⁻¹]_kk, with σ_slab² for k.

Units: θ in typical sizes, D in standard deviations. Shapes: K parameters.
Source: Ljung, *System Identification* (1999), ch. 13 (informative experiments).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Literal

import numpy as np

from s2r_spec.backend import Backend, load_backend
from s2r_spec.backend.protocols import protocol_of
from s2r_spec.base.arrays import FloatArray
from s2r_spec.base.errors import UsageError
from s2r_spec.base.json_values import DIGITS, Shown
from s2r_spec.certify.arguments import as_simulator, as_spec
from s2r_spec.diagnose.data.cost import Cost, of_library
from s2r_spec.diagnose.data.protocols import allowed_experiments, with_protocols_of
from s2r_spec.diagnose.data.rollouts import as_experiment
from s2r_spec.diagnose.data.space_filling import star
from s2r_spec.diagnose.estimation import size_prior
from s2r_spec.diagnose.experiment_design.identifiability import APART, Candidate, information
from s2r_spec.diagnose.inference.estimates import COVER
from s2r_spec.diagnose.inference.hierarchical import shared_error
from s2r_spec.diagnose.inference.observation import Observation
from s2r_spec.diagnose.inference.prior import SLAB
from s2r_spec.diagnose.run import HERE
from s2r_spec.diagnose.simulator.axes import EffectAxis
from s2r_spec.diagnose.simulator.bench import Bench
from s2r_spec.diagnose.simulator.cache import Cache
from s2r_spec.diagnose.simulator.library import library, most_rollouts
from s2r_spec.diagnose.simulator.response import ResponseLibrary
from s2r_spec.diagnose.simulator.score import Score
from s2r_spec.diagnose.watched import Progress, Watched
from s2r_spec.spec import Spec
from s2r_spec.workers.pools import ExecutorFactory, keep_open
from s2r_spec.workers.threads import one_thread

RUNS = 2
"""Definition: runs of every experiment of a plan, as in the screen of a campaign."""


class Identified(Enum):
    """Whether a plan identifies a parameter."""

    ALONE = "alone"
    TOGETHER = "only together"
    UNSEEN = "not seen"


@dataclass(frozen=True)
class Foreseen(Shown):
    """What a plan would say of one parameter of an effect at its typical size.

    Attributes:
        status: whether the plan identifies it alone, only together with others, or does not see it.
        rivals: the parameters that the plan does not tell from it, nearest first.
        sigma: distance from a machine without the effect, in standard deviations.
        half_width: of the 90 % interval of its size where no other effect is large, in typical sizes.
        run: the cheapest experiment of the plan that identifies it alone by itself, or if the plan does not identify it
            the cheapest further run after which it does; None if there is none.
    """

    axis: EffectAxis
    status: Identified
    rivals: tuple[str, ...]
    sigma: float = field(metadata={DIGITS: 2})
    half_width: float = field(metadata={DIGITS: 3})
    run: str | None

    JSON = (
        "effect=axis.effect parameter=axis.parameter unit=axis.unit typical=axis.at_typical interval status rivals "
        "sigma half_width run"
    )

    @property
    def interval(self) -> tuple[float, float]:
        """Expected 90 % interval of the typical value, in the unit."""
        at = self.axis.coordinate(self.axis.at_typical())
        _, low, high = self.axis.interval(at, at - self.half_width, at + self.half_width)
        return min(low, high), max(low, high)


@dataclass(frozen=True)
class BeforeData(Shown):
    """What a plan of runs would say about every effect, before any of them.

    Attributes:
        schema: name and version of this object.
        backend: name of the simulator.
        plan: its experiments, each with :data:`RUNS` runs.
        effects: one for each parameter that acts alone.
    """

    backend: str
    plan: tuple[str, ...]
    effects: tuple[Foreseen, ...]
    schema: Literal["s2r.before/1"] = "s2r.before/1"

    JSON = "schema backend plan effects"


@one_thread()
def before_data(
    spec: Spec | Path | str,
    sim: Backend | str,
    requirement: str | None = None,
    *,
    executor: ExecutorFactory | None = None,
    progress: Progress = lambda stage, done, of: None,
    protocols: Sequence[str] | None = None,
    open_loop: bool = False,
) -> BeforeData:
    """Return what runs at the middle and the ends of the test space, and of protocols, would say about every effect.

    Args as of :func:`.run.diagnose`. Protocols that are not among ``protocols`` are further experiments. With
    ``open_loop`` the plan has no tests, since only a log has the commands to play.

    Raises:
        UsageError: the simulator declares no effects, or the plan is empty.
    """
    spec, sim = as_spec(spec), as_simulator(sim)
    backend, score = load_backend(sim) if isinstance(sim, str) else sim, None
    candidates = []
    if not open_loop:
        bench = Bench.of(spec, requirement or spec.requirements[0], backend)
        backend, score = bench.backend, Score(spec, bench.requirement, bench.matched)
        tests = {as_experiment(bench, test): test for test in star(spec.space)}
        candidates = [Candidate(one, backend.duration, True, RUNS, test) for one, test in tests.items()]
    planned, _ = allowed_experiments(backend, backend, protocols)
    for one in with_protocols_of(backend, planned):
        able = one in planned
        candidates.append(Candidate(one, protocol_of(backend, one.protocol).duration, able, RUNS * able))
    if not any(one.allowed for one in candidates):
        raise UsageError(f"no test and no protocol of {backend.name} is planned, so nothing is identified")
    experiments, cache = [one.experiment for one in candidates], Cache.usual()

    def cost() -> Cost:
        progress("timing a rollout of the simulator", 0, 0)
        most = most_rollouts(backend, experiments, cache, score)
        return Cost(None, of_library(backend, most), None)

    Watched(progress).expect(cost)
    with keep_open(executor if backend.cost > HERE else None) as pool:
        known = library(backend, experiments, pool, progress, cache, score)
    progress("what the runs would say", 0, 0)
    responses = [known.response(one.experiment) for one in candidates]
    nominal = [Observation.of(one, [one.nominal], known.dependence) for one in responses]
    effects = tuple(_foreseen(known, candidates, nominal, k) for k in size_prior(known).causes.tolist())
    return BeforeData(backend.name, tuple(str(one.shown) for one in candidates if one.allowed), effects)


def _foreseen(
    known: ResponseLibrary, candidates: Sequence[Candidate], nominal: Sequence[Observation], k: int
) -> Foreseen:
    """Return what a plan with the ``runs`` of every candidate would say of parameter k."""
    axes, prior = known.parameters, size_prior(known)
    slopes = np.array([0.0 if one.base else one.coordinate(one.at_typical()) for one in axes])
    sizes = np.where(np.arange(len(axes)) == k, slopes, 0.0)

    def gained(runs: Sequence[int]) -> FloatArray:
        some = [one.of_runs(n) for one, n in zip(nominal, runs, strict=True) if n]
        total = np.sum([information(one, sizes, np.abs(sizes), slopes) for one in some], axis=0)
        shared = shared_error(sizes, np.ones_like(sizes))
        return np.asarray(np.linalg.solve(np.eye(len(sizes)) + total * shared, total))

    plan = [one.runs for one in candidates]
    whole = gained(plan)
    sigma, rivals = _apart(known, whole, k)
    alone = sigma >= APART and not rivals
    able = []
    for number, one in enumerate(candidates):
        own = [n * (place == number) if alone else n + (place == number) for place, n in enumerate(plan)]
        if sum(own) and (found := _apart(known, gained(own), k))[0] >= APART and not found[1]:
            able.append((one.cost, number))
    free = [n for n, one in enumerate(axes) if not one.base or one.stands_beside(axes[k])]
    precision = (whole + np.diag(1.0 / prior.deviation((k,)) ** 2))[np.ix_(free, free)]
    half = COVER * float(np.sqrt(np.linalg.inv(precision)[free.index(k), free.index(k)]))
    run = str(candidates[min(able)[1]].shown) if able else None
    if sigma < APART:
        return Foreseen(axes[k], Identified.UNSEEN, (), sigma, half, run)
    status = Identified.TOGETHER if rivals else Identified.ALONE
    return Foreseen(axes[k], status, tuple(axes[j].name for j in rivals), sigma, half, run)


def _apart(known: ResponseLibrary, information: FloatArray, k: int) -> tuple[float, list[int]]:
    """Return D_k(∅) for (K, K) L_k, and the j whose D_k({j}) is below :data:`APART`, nearest first."""
    axes, prior = known.parameters, size_prior(known)
    absent = np.array([bool(one.base) and not one.stands_beside(axes[k]) for one in axes])
    variance = np.where(absent, 0.0, prior.deviation() ** 2)
    inside = np.linalg.solve(np.eye(len(axes)) + information * variance, information)
    reach = np.maximum(np.abs(prior.low), np.abs(prior.high))
    wide = np.where(np.isfinite(reach), np.maximum(reach, SLAB), SLAB) ** 2
    square = {}
    for j in prior.causes[prior.causes != k].tolist():
        own = [j, *(n for n, one in enumerate(axes) if one.stands_beside(axes[j]) and absent[n])]
        damping = np.diag(1.0 / (wide - variance)[own]) + inside[np.ix_(own, own)]
        square[j] = inside[k, k] - inside[k, own] @ np.linalg.solve(damping, inside[own, k])
    rivals = sorted((j for j, each in square.items() if each < APART**2), key=square.__getitem__)
    return float(np.sqrt(max(inside[k, k], 0.0))), rivals
