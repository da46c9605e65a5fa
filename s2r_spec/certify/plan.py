"""What can a budget certify, and what can no budget? Before a robot is switched on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist, median

import numpy as np
from numpy.typing import ArrayLike, NDArray

from s2r_spec.certify import confidence
from s2r_spec.certify.certificate import Certificate
from s2r_spec.certify.coverage import log_rollouts, tests_apart
from s2r_spec.certify.kernels import Kernel
from s2r_spec.certify.pairing import SIMULATED_PER_REAL
from s2r_spec.certify.sample_complexity import minimax, sequential_lower_bound
from s2r_spec.certify.search import Search
from s2r_spec.errors import UsageError
from s2r_spec.magnitude import whole
from s2r_spec.space import Space

FloatArray = NDArray[np.float64]

# Norm of the random functions that stand in for the unknown objective, as shares of B, which is declared
# with a margin. A flat objective costs most: every test is nearly the worst one, and none can be left out.
PEAKED, FLAT = 0.3, 0.03
SECTIONS = 12


@dataclass(frozen=True)
class Plan:
    """What is to be expected of a search.

    Attributes:
        floor: rollouts below which no method can make the claim.
        minimax: rollouts for one known point; no search is faster.
        peaked: median rollouts of simulated searches, on functions of norm 0.3 B; None if one gave up.
        flat: the same on functions of norm 0.03 B.
        reachable: (rollouts, median ε on flat functions) for each budget that was asked for.
        runs: how many searches were simulated for each number.
        gaps: the same as ``reachable`` for the search of a gap, whose budget is of real rollouts.
    """

    floor: float
    minimax: float
    peaked: int | None
    flat: int | None
    reachable: tuple[tuple[int, float], ...]
    runs: int
    gaps: tuple[tuple[int, float], ...] = ()


def plan(
    space: Space,
    *,
    kernel: Kernel,
    B: float,
    R: float,
    delta: float,
    epsilon: float,
    mode: str = "rigorous",
    budgets: tuple[int, ...] = (),
    real: tuple[int, ...] = (),
    runs: int = 3,
    most: int = 2_000_000,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Plan:
    """Simulate the search on random functions of norm 0.3 B and 0.03 B, with Gaussian noise at the proxy.

    Args:
        space: the test space.
        kernel: and every setting that follows: see :class:`Search`.
        B: bound on the RKHS norm.
        R: sub-Gaussian proxy.
        delta: 1 − probability.
        epsilon: width of the interval that is wanted.
        mode: of the confidence set.
        budgets: rollouts for which the reachable ε is wanted.
        real: real rollouts for which the reachable ε of a gap is wanted.
        runs: simulated searches; the medians are reported, or None as soon as one of them gives up.
        most: rollouts after which a search to ε is given up.
        seed: of the simulation.
        progress: is told (stage, searches that are done, of) now and then.
    """
    # It refuses bad settings; a budget, since too small an ε is an answer of a plan.
    tried = Search(space, kernel=kernel, B=B, R=R, delta=delta, epsilon=epsilon, mode=mode, budget=most)
    tried.refuse_hopeless()
    for budget in (*budgets, *real):
        if whole("budget", budget, 2 * tried.spread) > most:
            raise UsageError(f"budget = {budget:g}; a plan simulates at most {most:,} rollouts")
    floor = sequential_lower_bound(R, epsilon, delta)
    tests = tests_apart(space, kernel)
    beyond = floor > most or log_rollouts(tests, tried.spread, tried.batch) > math.log10(most)

    done, of = 0, runs * (2 + len(budgets) + len(real))

    def tell() -> None:
        if progress is not None:
            progress("simulated searches", done, of)

    def simulated(run: int, share: float, budget: int, target: float, proxy: float = R) -> Certificate:
        nonlocal done
        rng = np.random.default_rng([seed, run])
        search = Search(
            space,
            kernel=kernel,
            B=B,
            R=proxy,
            delta=delta,
            epsilon=target,
            mode=mode,
            seed=run,
            budget=budget,
        )
        centres = rng.uniform(space.lower, space.upper, (SECTIONS, space.dim))
        weights = rng.normal(size=SECTIONS)
        weights *= share * B / math.sqrt(weights @ kernel.gram(centres, centres) @ weights)
        while not search.done:
            tell()
            queries = search.ask()
            points = np.array([space.vector(query.point) for query in queries])
            for query, mean in zip(queries, kernel.gram(points, centres) @ weights, strict=True):
                search.tell(query, mean + proxy * rng.normal(size=query.replicates))
        done += 1
        tell()
        return search.certificate()

    def to_stop(share: float) -> int | None:
        reached: list[int] = []
        for run in range(runs):
            certificate = None if beyond else simulated(run, share, most, epsilon)
            if certificate is None or certificate.epsilon > epsilon:
                return None
            reached.append(certificate.rollouts)
        return int(median(reached))

    def reached(budget: int, proxy: float) -> tuple[int, float]:
        # The width wanted is 0.3 of the best that Gaussian noise allows: the budget ends the search, not ε.
        target = min(B, 0.3 * 2 * -NormalDist().inv_cdf(min(delta, 0.3)) * proxy / math.sqrt(budget))
        return budget, median(simulated(run, FLAT, budget, target, proxy).epsilon for run in range(runs))

    return Plan(
        floor=floor,
        minimax=minimax(R, epsilon, delta),
        peaked=to_stop(PEAKED),
        flat=to_stop(FLAT),
        reachable=tuple(reached(budget, R) for budget in budgets),
        runs=runs,
        gaps=tuple(reached(budget, R * math.sqrt(1 + 1 / SIMULATED_PER_REAL)) for budget in real),
    )


@dataclass(frozen=True)
class Pilot:
    """What replicated outcomes say about R. They must not be used for the certificate again.

    Attributes:
        rollouts: outcomes read.
        std: within tests, pooled.
        refuted: the largest R that the e-test refutes at 1/20; the true proxy is hardly below it.
        kurtosis: of the residuals; 3 for Gaussian noise.
        warning: one sentence if the noise looks heavy-tailed, else "".
    """

    rollouts: int
    std: float
    refuted: float
    kurtosis: float
    warning: str


def read_pilot(groups: list[ArrayLike]) -> Pilot:
    """Judge the noise from groups of replicated outcomes.

    Raises:
        UsageError: no test was replicated.
    """
    values = [np.asarray(group, dtype=np.float64) for group in groups]
    values = [group for group in values if len(group) > 1]
    degrees = sum(len(group) - 1 for group in values)
    if degrees < 5:
        raise UsageError(
            f"the pilot has {degrees} replicates beyond the first of each test; it needs at least 5"
        )
    # Scaled, so that a residual from m outcomes has the variance of one outcome.
    residuals = np.concatenate([(g - g.mean()) * math.sqrt(len(g) / (len(g) - 1)) for g in values])
    scatter = float(sum(((g - g.mean()) ** 2).sum() for g in values))
    std = math.sqrt(scatter / degrees)
    if std == 0:
        raise UsageError("the pilot's replicates are all equal: there is no noise to judge")
    low, high = std * 1e-3, std * 10
    for _ in range(60):
        middle = math.sqrt(low * high)
        log_e = confidence.noise_e_value(scatter / middle**2, degrees)
        low, high = (middle, high) if log_e >= math.log(20) else (low, middle)
    kurtosis = float(np.mean(residuals**4) / np.mean(residuals**2) ** 2)
    farthest = float(np.abs(residuals).max() / std)
    # Four standard errors of a Gaussian sample's kurtosis, and a residual that Gaussian noise shows once in 10⁴ pilots.
    tail = kurtosis > 3 + 4 * math.sqrt(24 / len(residuals))
    rare = farthest > NormalDist().inv_cdf(1 - 0.5e-4 / len(residuals))
    warning = ""
    if tail or rare:
        warning = (
            f"the noise looks heavy-tailed (kurtosis {kurtosis:.1f}, farthest residual {farthest:.1f} standard "
            f"deviations): a standard deviation is no proxy for it, use a proven range, R = (b − a)/2"
        )
    return Pilot(len(residuals), std, low, kurtosis, warning)
