"""``s2r choose``: the checked controller with the best certified worst case; runs no rollout."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from s2r_spec.base.json_values import line
from s2r_spec.cli.terminal.common import sentences
from s2r_spec.cli.terminal.terminal import say


def choose(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="Folders of checks of the same spec, one for each candidate.", show_default=False
        ),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """Choose the controller with the largest certified worst expected ρ, from the folders of finished checks."""
    with sentences(as_json):
        from s2r_spec.certify.bound.rounding import at_most, down, interval_text, width_text
        from s2r_spec.certify.choose import choose as pick
        from s2r_spec.report.recompute import recompute
        from s2r_spec.report.records.runs import Candidate, ChoiceObject
        from s2r_spec.runs.layout import runs_in

        results = [recompute(folder).result for run in runs for folder in runs_in(run)]
        choice = pick(results)
        unit = f" {results[0].unit}" if results[0].unit else ""
        rows = [
            Candidate(
                backend=r.provenance["backend"],
                folder=str(r.folder),
                lower=r.lower,
                upper=r.upper,
                rollouts=r.certificate.rollouts,
                refused=r.certificate.reason if i in choice.refused else None,
            )
            for i, r in enumerate(results)
        ]
        if as_json:
            best = None if choice.best is None else rows[choice.best].backend
            record = ChoiceObject(
                requirement=results[0].requirement,
                best=best,
                delta=choice.delta,
                regret=None if best is None else choice.regret,
                candidates=tuple(rows),
            )
            print(line(record))
            raise typer.Exit(0 if best is not None else 3)
        for i, row in enumerate(rows):
            mark, bound = "→" if i == choice.best else " ", f"refused: {row.refused}"
            if i not in choice.refused:
                bound = f"worst expected ρ in {interval_text(row.lower, row.upper)}{unit}"
            say(f"{mark} {row.backend:32} {bound}, {row.rollouts} rollouts")
        if choice.best is None:
            say("no choice: every certificate was refused")
            raise typer.Exit(3)
        least, regret = f"{down(choice.lower)}{unit}", f"{width_text(choice.regret)}{unit}"
        say(
            f"choose {rows[choice.best].backend}: its worst expected ρ is at least {least}, and no other "
            f"candidate's is more than {regret} better, with probability ≥ 1 − {at_most(choice.delta)}"
        )
        if choice.refused:
            say("this does not cover the refused candidates")
