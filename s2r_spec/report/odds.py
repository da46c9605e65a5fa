"""The failure probability at the worst test, from the rollouts of a check on disk; runs no rollout."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from s2r_spec.certify.bound.rounding import at_least, at_most
from s2r_spec.certify.result.failure_probability import bound_failure_probability
from s2r_spec.report.recompute import recompute
from s2r_spec.report.records.runs import RequirementOdds
from s2r_spec.runs.layout import runs_in


def odds(run: Path, levels: Sequence[float], B: float, delta: float | None = None) -> list[RequirementOdds]:
    """Bound the failure probability of each requirement of a check.

    Args:
        run: the folder of the check, finished or not.
        levels: the levels of ρ, in its unit, chosen before any rollout was seen.
        B: bound on the RKHS norm of the probability as a function of the test.
        delta: probability that any of the bounds is wrong; None for the specification's.

    Raises:
        UsageError: the folder has no run that can be evaluated, or a setting is out of its range.
    """
    results = []
    for folder in runs_in(run):
        recomputed = recompute(folder)
        requirement = recomputed.result.requirement
        risk = recomputed.spec.certify[requirement].delta if delta is None else delta
        assert risk is not None  # recompute has searched with it
        # In an unfinished batch, which rollouts are on disk may depend on their outcomes.
        counted = recomputed.records[: len(recomputed.records) - recomputed.waiting]
        bounds = bound_failure_probability(
            recomputed.spec.space,
            [(record.params, [record.rho]) for record in counted],
            levels,
            kernel=recomputed.search.kernel,
            B=B,
            delta=risk,
        )
        unit = recomputed.result.unit
        odds_of = RequirementOdds(requirement=requirement, unit=unit, B=B, delta=risk, levels=tuple(bounds))
        results.append(odds_of)
    return results


def lines(result: RequirementOdds) -> Iterator[str]:
    """Yield the bounds of a requirement in words, and what they assume."""
    unit = f" {result.unit}" if result.unit else ""
    yield f"{result.requirement}: {result.levels[0].rollouts} rollouts, with probability ≥ 1 − {result.delta:g}"
    for one in result.levels:
        observed = f"observed in {one.seen} of {one.rollouts} rollouts"
        if one.refused:
            yield f"  P(ρ < {one.level:g}{unit}): no bound, {observed}; {one.refused}"
            continue
        bounds = f"≤ {at_most(one.upper)} at every test, ≥ {at_least(one.lower)} at the worst one"
        yield f"  P(ρ < {one.level:g}{unit}) {bounds}; {observed}"
    yield "  This assumes:"
    yield (
        f"   - each of these probabilities, as a function of the test, has norm ≤ B = {result.B:g} in the RKHS of the "
        f"check's kernel; no data can prove this"
    )
    yield "   - rollouts are independent given the tests, and the levels were chosen before any was seen"
    yield "   - the noise of a yes-or-no outcome is ½-sub-Gaussian, which is proven (Hoeffding's lemma)"
