"""``s2r monitor``: ρ of recorded traces, with the reason; or of one that is being recorded."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from s2r_spec.cli import terminal
from s2r_spec.cli.common import CODES, COLOURS, sentences, worst
from s2r_spec.cli.online import Settings, follow
from s2r_spec.printable import lines, one_line

if TYPE_CHECKING:
    from s2r_spec.robustness.profiles import Profile
    from s2r_spec.spec import Spec
    from s2r_spec.trace import Trace


def monitor(
    spec: Annotated[Path, typer.Argument(help="The specification, a .stl file.", show_default=False)],
    traces: Annotated[
        list[Path],
        typer.Argument(help="Recorded traces; with --online one, or - for CSV rows.", show_default=False),
    ],
    params: Annotated[
        list[str] | None,
        typer.Option("--param", "-p", help="A test parameter: vd=0.3, or 'vd=30 cm/s' (may be repeated)."),
    ] = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(
            "--map", "-m", help="What a signal (or t) is called in the files: vx=velocity.x (repeat)."
        ),
    ] = None,
    requirement: Annotated[
        list[str] | None, typer.Option("--requirement", "-r", help="Only this requirement (may be repeated).")
    ] = None,
    partial: Annotated[
        bool, typer.Option("--partial", help="Evaluate a trace that is too short on what there is.")
    ] = False,
    online: Annotated[
        bool,
        typer.Option("--online", help="Sample by sample: say what ρ can still become when that changes."),
    ] = False,
    period: Annotated[
        float | None,
        typer.Option(help="With --online: seconds from one sample to the next.", show_default="as they come"),
    ] = None,
    ranges: Annotated[
        bool, typer.Option(help="With --online: signals stay in their declared ranges.")
    ] = True,
    like: Annotated[
        str, typer.Option("--profile", help="Read formulas as another tool does: breach, rtamt-dense, …")
    ] = "s2r",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on stdout; with --online one a line.")
    ] = False,
) -> None:
    """Evaluate every requirement on recorded traces: ρ, verdict, and what decides it."""
    with sentences(as_json):
        from s2r_spec.errors import UsageError
        from s2r_spec.logs import read
        from s2r_spec.robustness.profiles import profile
        from s2r_spec.spec import load_spec

        parsed = load_spec(spec)
        values = parsed.read_params(params or [])
        names = _columns(columns or [])
        conventions = profile(like)
        if online:
            if like != "s2r":
                raise UsageError("--profile is for recorded traces; --online asks at the samples")
            if len(traces) != 1:
                raise UsageError("--online follows one trace: give one file, or - for rows that come in")
            chosen = tuple(requirement or parsed.requirements)
            settings = Settings(values, names, chosen, period, ranges, partial, as_json)
            raise typer.Exit(follow(parsed, traces[0], settings))
        if period is not None or not ranges:
            raise UsageError("--period and --no-ranges are for --online")
        results: list[dict[str, Any]] = [
            {"trace": str(path), "requirements": [
                _judged(parsed, trace, name, values, partial, like, conventions)
                for name in requirement or parsed.requirements
            ]}
            for path in traces for trace in [read(path, names)]
        ]  # fmt: skip
        code = CODES[worst(one["verdict"] for result in results for one in result["requirements"])]
        if as_json:
            record = {"schema": "s2r.monitor/1", "exit_code": code, "spec": parsed.name, "hash": parsed.hash}
            print(
                json.dumps(record | {"profile": like, "params": values, "results": results}, allow_nan=False)
            )
        else:
            _print(results)
        raise typer.Exit(code)


def _columns(texts: list[str]) -> dict[str, str]:
    """Return channel → column of texts like ``vx=velocity.x``."""
    from s2r_spec.errors import UsageError

    names: dict[str, str] = {}
    for text in texts:
        name, _, names[name] = text.partition("=")
        if not names[name]:
            raise UsageError("--map is written name=column, for example --map vx=velocity.x")
    return names


def _judged(
    spec: Spec,
    trace: Trace,
    requirement: str,
    params: dict[str, float],
    partial: bool,
    like: str,
    conventions: Profile,
) -> dict[str, Any]:
    """Return the explanation of one requirement as plain data, with a verdict and a text."""
    from s2r_spec.robustness.explain import Explanation

    if trace.failure is None:
        if partial and conventions["end"] != "hold":
            conventions = {**conventions, "end": "clip"}
        found = spec.evaluate(trace, requirement, params, **conventions)
        if not (found.complete[0] or partial or conventions["end"] == "hold"):
            text = (
                f"{requirement} unknown: it looks {found.horizon:g} s ahead, but the trace lasts "
                f"{trace.duration:g} s (--partial evaluates what there is)"
            )
            return {"requirement": requirement, "verdict": "unknown", "text": text}
        why = ""
        if conventions["interpolation"] != "samples":
            why = f"it is asked at every instant, as {like} does: no one sample decides it"
        elif not found.complete[0] and conventions["end"] == "hold":
            why = f"it looks past the last sample, which lasts on, as in {like}"
        reason = Explanation(requirement, found.value, found.unit, reason=why)
    if trace.failure is not None or not reason.reason:
        reason = spec.explain(trace, requirement, params, until=conventions["until"], partial=True)
    verdict = "holds" if reason.rho >= 0 else "violated"
    return {"verdict": verdict, "text": str(reason), **reason.to_json()}


def _print(results: list[dict[str, Any]]) -> None:
    console = terminal.console()
    for result in results:
        console.print(Text(one_line(result["trace"]), style="bold"))
        for one in result["requirements"]:
            text = Text(lines(one["text"]))
            text.highlight_words([f" {one['verdict']}:"], style=COLOURS[one["verdict"]])
            console.print(text)
