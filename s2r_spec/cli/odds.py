"""``s2r odds``: bound the probability that a rollout fails at the worst test; runs no rollout."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.cli.common import sentences
from s2r_spec.cli.terminal import say
from s2r_spec.json_values import line


def odds(
    run: Annotated[Path, typer.Argument(help="Folder of a check, finished or not.", show_default=False)],
    B: Annotated[
        float,
        typer.Option(
            "--B",
            help="Bound on the RKHS norm of the probability as a function of the test. It is 0 if no rollout ever "
            "fails. No data can prove it.",
            show_default=False,
        ),
    ],
    below: Annotated[
        list[float] | None,
        typer.Option(
            help="Level of ρ, in its unit: P(ρ < level) is bounded. May be repeated.", show_default="0"
        ),
    ] = None,
    delta: Annotated[
        float | None,
        typer.Option(help="Probability that any of the bounds is wrong.", show_default="the spec's"),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """Bound the probability that ρ is below a level at the worst test, from the rollouts of a check."""
    with sentences(as_json):
        from s2r_spec.certify.failure_probability import bound_failure_probability as bound
        from s2r_spec.certify.rounding import at_least, at_most
        from s2r_spec.json_objects.runs import OddsObject, RequirementOdds
        from s2r_spec.report.recompute import recompute, runs_in

        results = []
        for folder in runs_in(run):
            found = recompute(folder)
            settings = found.spec.certify[found.result.requirement]
            risk = settings.delta if delta is None else delta
            assert settings.kernel is not None  # recompute has searched with both
            assert risk is not None
            # In an unfinished batch, which rollouts are on disk may depend on their outcomes.
            counted = found.records[: len(found.records) - found.waiting]
            results.append(
                (
                    found,
                    risk,
                    bound(
                        found.spec.space,
                        [(record.params, [record.rho]) for record in counted],
                        below or [0.0],
                        kernel=found.search.kernel,
                        B=B,
                        delta=risk,
                    ),
                )
            )
        if as_json:
            record = {
                found.result.requirement: RequirementOdds(delta=risk, levels=tuple(levels))
                for found, risk, levels in results
            }
            print(line(OddsObject(results=record)))
            return
        for found, risk, levels in results:
            unit = f" {found.result.unit}" if found.result.unit else ""
            say(f"{found.result.requirement}: {levels[0].rollouts} rollouts, with probability ≥ 1 − {risk:g}")
            for one in levels:
                observed = f"observed in {one.seen} of {one.rollouts} rollouts"
                if one.refused:
                    say(f"  P(ρ < {one.level:g}{unit}): no bound, {observed}; {one.refused}")
                    continue
                bounds = f"≤ {at_most(one.upper)} at every test, ≥ {at_least(one.lower)} at the worst one"
                say(f"  P(ρ < {one.level:g}{unit}) {bounds}; {observed}")
            say("  This assumes:")
            say(
                f"   - each of these probabilities, as a function of the test, has norm ≤ B = {B:g} in the RKHS of the "
                f"check's kernel; no data can prove this"
            )
            say(
                "   - rollouts are independent given the tests, and the levels were chosen before any was seen"
            )
            say(
                "   - the noise of a yes-or-no outcome is ½-sub-Gaussian, which is proven (Hoeffding's lemma)"
            )
