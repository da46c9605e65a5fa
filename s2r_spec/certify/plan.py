"""How many rollouts a certificate takes, and the ε that a budget reaches: simulated before a robot is switched on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import NormalDist, median
from typing import Unpack

import numpy as np

from s2r_spec.certify.certificate import Certificate
from s2r_spec.certify.feasibility import log_rollouts, tests_apart
from s2r_spec.certify.pairing import SIMULATED_PER_REAL
from s2r_spec.certify.sample_complexity import minimax, sequential_lower_bound
from s2r_spec.certify.search import Search
from s2r_spec.certify.settings import Declared, SearchSettings
from s2r_spec.errors import UsageError
from s2r_spec.magnitude import whole
from s2r_spec.space import Space

PEAKED, FLAT = 0.3, 0.03
"""Definition: norms of the random functions that stand in for the unknown objective, as shares of B, which is declared
with a margin. A flat objective costs most: every test is nearly the worst one, and none can be left out."""
SECTIONS = 12
"""Definition: kernel sections in a random function."""

Progress = Callable[[str, int, int], None]
"""Receives the stage, how many simulated searches are done, and how many there are."""


@dataclass(frozen=True)
class Plan:
    """Expected effort of a search.

    Attributes:
        floor: rollouts below which no method can make the claim.
        minimax: rollouts for one known point; no search is faster.
        peaked: median rollouts of simulated searches, on functions of norm 0.3 B; None if one gave up.
        flat: the same on functions of norm 0.03 B.
        reachable: (rollouts, median ε on flat functions) for each budget.
        runs: number of simulated searches for each number.
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
    budgets: tuple[int, ...] = (),
    real: tuple[int, ...] = (),
    runs: int = 3,
    most: int = 2_000_000,
    progress: Progress | None = None,
    **declared: Unpack[Declared],
) -> Plan:
    """Simulate the search on random functions of norm 0.3 B and 0.03 B, with Gaussian noise of deviation R.

    Args:
        space: the test space.
        budgets: numbers of rollouts; the plan gives the reachable ε of each.
        real: numbers of real rollouts; the plan gives the reachable ε of a gap for each.
        runs: simulated searches; the plan has the medians, or None as soon as one search gives up.
        most: rollouts after which a search for ε gives up.
        progress: receives the number of finished searches now and then.
        declared: ``kernel``, ``B``, ``R``, ``delta``, ``epsilon``, ``mode`` and ``seed``, see
            :class:`~s2r_spec.certify.settings.SearchSettings`.

    Raises:
        UsageError: a setting is out of its range, or no rollouts could give a certificate.
    """
    # With a budget, since too small an ε is an answer of a plan and no error.
    settings = SearchSettings(space=space, budget=most, **declared)
    Search.of(settings).refuse_hopeless()
    for budget in (*budgets, *real):
        if whole("budget", budget, 2 * settings.spread) > most:
            raise UsageError(f"budget = {budget:g}; a plan simulates at most {most:,} rollouts")
    simulation = _Simulation(settings, runs, runs * (2 + len(budgets) + len(real)), progress)
    return Plan(
        floor=sequential_lower_bound(settings.R, settings.epsilon, settings.delta),
        minimax=minimax(settings.R, settings.epsilon, settings.delta),
        peaked=simulation.rollouts(PEAKED),
        flat=simulation.rollouts(FLAT),
        reachable=tuple((budget, simulation.reachable(budget, settings.R)) for budget in budgets),
        runs=runs,
        gaps=tuple(
            (budget, simulation.reachable(budget, settings.R * math.sqrt(1 + 1 / SIMULATED_PER_REAL)))
            for budget in real
        ),
    )


@dataclass
class _Simulation:
    """Simulated searches, with a count of those that are done.

    Attributes:
        settings: the declaration; its budget is the most rollouts of a search, and its seed fixes the simulation.
        runs: searches for each number.
        total: all of them.
        progress: receives the count.
        done: the count.
    """

    settings: SearchSettings
    runs: int
    total: int
    progress: Progress | None
    done: int = 0

    def rollouts(self, share: float) -> int | None:
        """Return the median rollouts until width ε, on functions of norm ``share`` · B; None if a search gives up."""
        settings, most = self.settings, self.settings.budget
        assert most is not None
        fewest = sequential_lower_bound(settings.R, settings.epsilon, settings.delta)
        tests = tests_apart(settings.space, settings.kernel)
        if fewest > most or log_rollouts(tests, settings.spread, settings.batch) > math.log10(most):
            return None
        reached: list[int] = []
        for run in range(self.runs):
            certificate = self._search(replace(settings, seed=run), share)
            if certificate.epsilon > settings.epsilon:
                return None
            reached.append(certificate.rollouts)
        return int(median(reached))

    def reachable(self, budget: int, proxy: float) -> float:
        """Return the median ε after a budget on flat functions, with noise of sub-Gaussian proxy ``proxy``."""
        # The width wanted is 0.3 of the best that Gaussian noise allows: the budget ends the search, not ε.
        quantile = -NormalDist().inv_cdf(min(self.settings.delta, 0.3))
        target = min(self.settings.B, 0.3 * 2 * quantile * proxy / math.sqrt(budget))
        searches = (
            replace(self.settings, R=proxy, epsilon=target, seed=run, budget=budget)
            for run in range(self.runs)
        )
        return median(self._search(settings, FLAT).epsilon for settings in searches)

    def _search(self, settings: SearchSettings, share: float) -> Certificate:
        """Return the certificate of one search on a random function of norm ``share`` · B."""
        search, space, kernel = Search.of(settings), settings.space, settings.kernel
        rng = np.random.default_rng([self.settings.seed, settings.seed])
        centres = rng.uniform(space.lower, space.upper, (SECTIONS, space.dim))
        weights = rng.normal(size=SECTIONS)
        weights *= share * settings.B / math.sqrt(weights @ kernel.gram(centres, centres) @ weights)
        while not search.done:
            self._report()
            queries = search.ask()
            points = np.array([space.vector(query.point) for query in queries])
            for query, mean in zip(queries, kernel.gram(points, centres) @ weights, strict=True):
                search.tell(query, mean + settings.R * rng.normal(size=query.replicates))
        self.done += 1
        self._report()
        return search.certificate()

    def _report(self) -> None:
        if self.progress is not None:
            self.progress("simulated searches", self.done, self.total)
