"""``s2r replay``: run one rollout of a run again; of a machine, show the recorded one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.base.json_values import extend, line
from s2r_spec.cli.terminal.common import sentences
from s2r_spec.cli.terminal.terminal import say

if TYPE_CHECKING:
    from s2r_spec.runs.replay import Replay


def replay(
    rollout: Annotated[
        str,
        typer.Argument(help="Rollout as `s2r check` prints it, FOLDER#QUERY.REPLICATE.", show_default=False),
    ],
    save: Annotated[Path | None, typer.Option(help="File for the trace, .npz or .csv.")] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="File for a plot of the signals and their allowed values: .svg, .png or .pdf."),
    ] = None,
    render: Annotated[
        Path | None,
        typer.Option(help="File for a picture by the backend; sim draws .png tiles or a .gif video."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """Run a recorded rollout again and compare ρ. A machine's rollout is only shown."""
    with sentences(as_json):
        from s2r_spec import logs
        from s2r_spec.report.records.runs import ReplayObject
        from s2r_spec.runs.replay import replay as again

        result = again(rollout)
        if save is not None:
            logs.write(result.trace, save)
        if as_json:
            more = {"rollout": rollout, "recorded_rho": result.recorded, "same": result.same}
            print(line(extend(ReplayObject, result, **more)))
        else:
            test = ", ".join(f"{name} = {value:.6g}" for name, value in result.params.items())
            say(f"{test}, seed {result.seed}: ρ = {result.rho:+.6f} {result.unit}".rstrip())
            if not result.ran:
                say(f"as recorded: {result.backend.name} is a machine, and nothing was sent to it")
            say("the recorded ρ, bit for bit" if result.same else result.difference)
        if save is not None:
            say(f"trace: {save}", error=True)
        # The plot comes first, since it does not need the backend's pictures.
        if plot is not None:
            _plot(result, plot)
            say(f"plot: {plot}", error=True)
        if render is not None:
            result.render(render)
            say(f"picture: {render}", error=True)
        if not result.same:
            raise typer.Exit(4)


def _plot(result: Replay, path: Path) -> None:
    from s2r_spec.base.errors import BackendError
    from s2r_spec.spec.plot import plot

    if result.trace is None:
        raise BackendError("the rollout crashed again: there is no trace to plot")
    spec, requirement, trace = result.spec, result.requirement, result.trace
    test = ", ".join(f"{name} = {value:.6g}" for name, value in result.params.items())
    plot(
        spec.tolerances(trace, requirement, result.params),
        spec.explain(trace, requirement, result.params, partial=True),
        f"{result.backend.name}: {test}, seed {result.seed}",
        path,
    )
