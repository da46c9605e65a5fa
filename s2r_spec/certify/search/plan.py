"""How many rollouts a certificate takes, and the ε that a budget reaches: estimated before a robot is switched on.

Data: none. Known: the declaration. Unknown: the objective J; all else follows from the model of
:mod:`s2r_spec.certify.search.effort`. So the estimate is a range over J:

- **low**: J varies by ``VARIATION`` · ε over the test space: most tests soon turn out not to be the worst one.
- **high**: J is flat, so that every test is nearly the worst one and none can be left out. Its norm is B/2, since the
  guard (B ≥ 2 B_low) refuses more. A search ends with a whole batch, a tenth of all rollouts, which may not be needed.

``low`` is the least over a few random functions of the kernel; ``high`` has no random part. Where one number is needed,
it is their geometric mean. Two *floors* bound every search from below, in closed form.

Units: B, R and ε are in the outcome's unit; rollouts are numbers. ``benchmarks/certify/plan.py`` compares the range
with complete runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from s2r_spec.certify.bound.coverage import PARTS, Coverage, long_axes
from s2r_spec.certify.bound.sample_complexity import minimax, sequential_lower_bound
from s2r_spec.certify.bound.settings import SearchSettings
from s2r_spec.certify.search.effort import Effort, Objective
from s2r_spec.certify.search.pairing import SIMULATED_PER_REAL

VARIATION = 4.0
"""Definition: change of J over the test space in the easier case, in ε. If ε is half of the worst mean, as the pages
advise, E ρ rises to three times its worst."""
FUNCTIONS = 5
"""Budget: random functions for ``low``."""
SECTIONS = 12
"""Definition: kernel sections in a random function."""
SHARE_VARIED, SHARE_FLAT = 0.4, 0.5
"""Definition: share of ε below J(z*). Where J varies, the rollouts gather at its worst test. Where it is flat, they
do not."""
MOST = 2_000_000
"""Definition: rollouts beyond which an estimate is only called larger."""
WIDTHS = 6
"""Budget: most estimates of the rollouts until the ε of a budget is found."""
CLOSE = 0.03
"""Tolerance: relative change of that ε at which it is found."""

Progress = Callable[[str, int, int], None]
"""Receives the stage, how many estimates are done, and how many there are."""


@dataclass(frozen=True)
class Floors:
    """Rollouts below which no search can end.

    Attributes:
        floor: rollouts below which no method can make the claim.
        minimax: rollouts for one known point; no search is faster.
    """

    floor: float
    minimax: float


@dataclass(frozen=True)
class Plan(Floors):
    """Expected effort of a search.

    Attributes:
        peaked: the low end of the range of rollouts, if the objective varies by four ε; None if beyond ``most``.
        flat: the high end, if every test is nearly the worst one; None if beyond ``most``.
        expected: the geometric mean of both ends; None if beyond ``most``.
        reachable: (rollouts, expected ε) for each budget.
        reachable_range: (rollouts, lowest ε, highest ε) for each budget.
        runs: number of random functions behind ``peaked``.
        gaps: the same as ``reachable`` for the search of a gap, whose budget is of real rollouts.
    """

    peaked: int | None
    flat: int | None
    expected: int | None
    reachable: tuple[tuple[int, float], ...]
    reachable_range: tuple[tuple[int, float, float], ...]
    runs: int
    gaps: tuple[tuple[int, float], ...] = ()


def floors(settings: SearchSettings) -> Floors:
    """Return the floors of a declaration, in closed form."""
    return Floors(
        sequential_lower_bound(settings.R, settings.epsilon, settings.delta),
        minimax(settings.R, settings.epsilon, settings.delta),
    )


def plan_search(
    settings: SearchSettings,
    budgets: tuple[int, ...] = (),
    real: tuple[int, ...] = (),
    progress: Progress | None = None,
    gap: SearchSettings | None = None,
) -> Plan:
    """Estimate the rollouts of a search, and the ε that numbers of rollouts reach.

    An estimate beyond the budget of the settings is None. The numbers ``real`` are of real rollouts in a gap, whose
    search has the settings ``gap``.
    """
    most = settings.budget or MOST
    count = 1 + len(budgets) + len(real)
    report = progress or (lambda *_: None)
    report("estimates", 0, count)
    least = floors(settings)
    low, high = rollouts(settings)
    report("estimates", 1, count)
    widths: list[tuple[float, float]] = []
    paired = gap or replace(settings, R=settings.R * math.sqrt(1 + 1 / SIMULATED_PER_REAL))
    for budget, of in [(each, settings) for each in budgets] + [(each, paired) for each in real]:
        widths.append(reachable(of, budget))
        report("estimates", 1 + len(widths), count)
    ends = list(zip((*budgets, *real), widths, strict=True))
    expected = [(budget, math.sqrt(narrow * wide)) for budget, (narrow, wide) in ends]
    return Plan(
        floor=least.floor,
        minimax=least.minimax,
        peaked=_whole_number(low, most),
        flat=_whole_number(high, most),
        expected=_whole_number(math.sqrt(low * high), most),
        reachable=tuple(expected[: len(budgets)]),
        reachable_range=tuple((budget, *width) for budget, width in ends[: len(budgets)]),
        runs=FUNCTIONS,
        gaps=tuple(expected[len(budgets) :]),
    )


def rollouts(settings: SearchSettings) -> tuple[float, float]:
    """Return the low and the high end of the range of rollouts until the interval is ε wide."""
    low = min(_one(settings, number) for number in range(FUNCTIONS))
    return low, max(low, _most_rollouts(settings))


def _one(settings: SearchSettings, number: int) -> float:
    effort = Effort.of(settings)
    varied = _random_objective(effort, settings, np.random.default_rng([settings.seed, number]))
    return max(_least_rollouts(settings), effort.rollouts(varied, SHARE_VARIED))


def _most_rollouts(settings: SearchSettings) -> float:
    """Return the high end: the rollouts for a flat objective, with a last batch that was not needed."""
    effort = Effort.of(settings)
    flat = Objective.flat(len(effort.region.points), float(effort.norms[0]) / 2)
    return max(2 * _least_rollouts(settings), effort.rollouts(flat, SHARE_FLAT) * (1 + settings.batch))


def _least_rollouts(settings: SearchSettings) -> float:
    """Return the rollouts of the first batch, of the floor, or of the tests on axes shorter than their lengthscale."""
    axes = long_axes(settings.space, settings.kernel)
    needed = Coverage(settings.space, axes).needed(settings.R, settings.epsilon, settings.delta)
    return max(2.0 * settings.spread, floors(settings).floor, PARTS * needed if axes else 0.0)


def reachable(settings: SearchSettings, budget: int) -> tuple[float, float]:
    """Return the least and the largest ε that a budget may reach."""
    # The objective that takes the fewest rollouts is the same one for every ε, or nearly so.
    easiest = min(range(FUNCTIONS), key=lambda number: _one(settings, number))
    narrow = _epsilon_of_budget(settings, budget, lambda changed: _one(changed, easiest))
    return narrow, max(narrow, _epsilon_of_budget(settings, budget, _most_rollouts))


def _epsilon_of_budget(
    settings: SearchSettings, budget: int, count: Callable[[SearchSettings], float]
) -> float:
    """Return the ε at which an end of the range of rollouts equals the budget, by the secant method in logarithms."""
    largest = math.log(1.99 * settings.B)  # |J| ≤ B needs no rollout
    x, slope = min(math.log(settings.epsilon), largest), -2.0
    excess = math.log(count(replace(settings, epsilon=math.exp(x))) / budget)
    for _ in range(WIDTHS):
        other = min(largest, x - excess / slope)
        if abs(other - x) < CLOSE:
            return math.exp(other)
        log_ratio = math.log(count(replace(settings, epsilon=math.exp(other))) / budget)
        # More parameters make the rollouts fall faster than the square as ε grows.
        slope = min(-1.0, (log_ratio - excess) / (other - x))
        x, excess = other, log_ratio
    return math.exp(x)


def _random_objective(effort: Effort, settings: SearchSettings, rng: np.random.Generator) -> Objective:
    """Return a random function that varies by ``VARIATION`` ε, or less, so that its norm is at most B/2."""
    region = effort.region
    centres = rng.uniform(region.space.lower, region.space.upper, (SECTIONS, region.space.dim))
    weights = rng.normal(size=SECTIONS)
    values = settings.kernel.gram(region.points, centres) @ weights
    norm = math.sqrt(float(weights @ settings.kernel.gram(centres, centres) @ weights))
    spread = float(values.max() - values.min())
    scale = min(VARIATION * effort.epsilon / spread, float(effort.norms[0]) / 2 / norm)
    return Objective.of(scale * values)


def _whole_number(number: float, most: int) -> int | None:
    return None if number > most else round(number)
