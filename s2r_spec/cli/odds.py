"""``s2r odds``: bound the probability that a rollout fails at the worst test; runs no rollout."""

from __future__ import annotations

from typing import Annotated

import typer

from s2r_spec.base.json_values import line
from s2r_spec.cli.options.search import AsJson, RunFolder
from s2r_spec.cli.terminal.common import sentences
from s2r_spec.cli.terminal.terminal import say


def odds(
    run: RunFolder,
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
    as_json: AsJson = False,
) -> None:
    """Bound the probability that ρ is below a level at the worst test, from the rollouts of a check."""
    with sentences(as_json):
        from s2r_spec.report import odds as bounds
        from s2r_spec.report.records.runs import OddsObject

        results = bounds.odds(run, below or [0.0], B, delta)
        if as_json:
            print(line(OddsObject(results={one.requirement: one for one in results})))
            return
        for result in results:
            for text in bounds.lines(result):
                say(text)
