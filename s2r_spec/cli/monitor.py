"""``s2r monitor``: ρ of recorded traces, with the reason, or of a trace while it is recorded."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from s2r_spec.cli import terminal
from s2r_spec.cli.common import answered, sentences
from s2r_spec.cli.log_options import (
    Clock,
    Columns,
    Duration,
    Join,
    Longest,
    Nan,
    Stamped,
    Start,
    TimeUnit,
    When,
    missing,
)
from s2r_spec.cli.online import Settings, follow
from s2r_spec.cli.reading import Request, named, read
from s2r_spec.json_values import line
from s2r_spec.printable import lines, one_line
from s2r_spec.verdict import Verdict, worst

if TYPE_CHECKING:
    from s2r_spec.json_objects.monitor import MonitoredKind, MonitoredTrace, UnreadTrace
    from s2r_spec.json_values import ExitCode
    from s2r_spec.spec.monitored import Conventions, Monitored


def monitor(
    spec: Annotated[Path, typer.Argument(help="Specification, an .stl file.", show_default=False)],
    traces: Annotated[
        list[Path],
        typer.Argument(
            help="Files of recorded traces. With --online, one file, or - to read CSV rows from stdin.",
            show_default=False,
        ),
    ],
    params: Annotated[
        list[str] | None,
        typer.Option(
            "--param",
            "-p",
            help="Value of a test parameter: vd=0.3 in its declared unit, 'vd=30 cm/s'. vd=/cmd.speed@0 takes it from "
            "a field of the log, 0 s after the start. May be repeated.",
            show_default="as the trace says",
        ),
    ] = None,
    columns: Columns = None,
    time_unit: TimeUnit = None,
    nan: Nan = None,
    when: When = None,
    start: Start = None,
    duration: Duration = None,
    join: Join = None,
    clock: Clock = None,
    stamps: Stamped = None,
    longest: Longest = None,
    requirement: Annotated[
        list[str] | None,
        typer.Option(
            "--requirement", "-r", help="Requirement to evaluate; may be repeated.", show_default="all"
        ),
    ] = None,
    partial: Annotated[
        bool,
        typer.Option("--partial", help="Evaluate a trace that is too short, with windows cut at its end."),
    ] = False,
    online: Annotated[
        bool,
        typer.Option(
            "--online",
            help="Follow one trace sample by sample; print the range of possible ρ whenever it changes.",
        ),
    ] = False,
    period: Annotated[
        float | None,
        typer.Option(help="With --online: sample period in seconds.", show_default="as the samples come"),
    ] = None,
    ranges: Annotated[
        bool, typer.Option(help="With --online: assume that signals stay in their declared ranges.")
    ] = True,
    like: Annotated[
        str,
        typer.Option(
            "--profile",
            help="Conventions of another tool: breach, moonlight, rtamt, rtamt-dense, stlcgpp, stlrom or tidystl.",
        ),
    ] = "s2r",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on stdout; with --online, one on each line.")
    ] = False,
) -> None:
    """Evaluate requirements on recorded traces: robustness ρ, verdict, and the instant that decides."""
    with sentences(as_json):
        from s2r_spec.errors import UsageError
        from s2r_spec.json_objects.monitor import MonitorObject, UnreadTrace
        from s2r_spec.logs.mapping import read_map
        from s2r_spec.logs.topics.join import Joining
        from s2r_spec.robustness.profiles import profile
        from s2r_spec.rollouts.excerpts import Excerpts, read_longest, read_sources
        from s2r_spec.spec import load_spec
        from s2r_spec.spec.monitored import Conventions

        parsed = load_spec(spec)
        given, sources = read_sources(params or [])
        values = parsed.read_params(given)
        chosen = tuple(requirement or parsed.requirements)
        for name in chosen:
            parsed.unit(name)  # report a wrong name before any file is read
        chooses = any(option is not None for option in (clock, join, stamps))
        joining = Joining(clock, join or "hold", stamps) if chooses else None
        valid = read_longest(longest or [])
        excerpts = Excerpts(
            read_map(columns or []), time_unit, joining, when, start, duration, sources, valid
        )
        request = Request(parsed, chosen, values, excerpts, missing(nan))
        conventions = Conventions(missing(nan), partial, time_unit is not None, like=like)
        profile(like)
        if online:
            if like != "s2r":
                raise UsageError("--profile is for recorded traces; --online evaluates only at the samples")
            if len(traces) != 1:
                raise UsageError("--online follows one trace: give one file, or - for stdin")
            raise typer.Exit(follow(request, traces[0], Settings(period, ranges, partial, as_json)))
        if period is not None or not ranges:
            raise UsageError("--period and --no-ranges are for --online")
        results: list[MonitoredTrace | UnreadTrace] = []
        for path in traces:
            try:
                results += _evaluated(request, path, conventions)
            except UsageError as error:
                if len(traces) == 1:
                    raise
                print(f"error: {error}", file=sys.stderr)
                results.append(UnreadTrace(trace=str(path), error=str(error)))
        verdicts = [Verdict.of(one.satisfied) for result in results for one in result.requirements]
        broken = any(isinstance(result, UnreadTrace) for result in results)
        code: ExitCode | Literal[2] = 2 if broken else worst(verdicts).exit_code
        if as_json:
            answered()
            record = MonitorObject(
                exit_code=code,
                spec=parsed.name,
                hash=parsed.hash,
                profile=like,
                params=values,
                results=tuple(results),
            )
            print(line(record, infinite=True))
        else:
            _print(results)
        raise typer.Exit(code)


def _evaluated(request: Request, path: Path, conventions: Conventions) -> list[MonitoredTrace]:
    """Return the results of one file, one for each episode; an error names the file."""
    from s2r_spec.json_objects.monitor import MonitoredTrace
    from s2r_spec.spec.monitored import monitored, refuse_unstated

    results = []
    for recorded in read(request, path):
        with named(path):
            found = []
            for name in request.requirements:
                if not recorded.stated:
                    refuse_unstated(request.spec, recorded.trace, name)
                how = replace(conventions, stated=recorded.stated)
                found.append(monitored(request.spec, recorded.trace, name, recorded.params, how))
        results.append(
            MonitoredTrace(
                trace=recorded.name,
                params=recorded.params,
                from_trace=tuple(sorted(recorded.taken)),
                notes=tuple(recorded.notes),
                accounts=recorded.accounts,
                requirements=tuple(map(_printable, found)),
            )
        )
    return results


def _printable(found: Monitored) -> MonitoredKind:
    """Return the object of one requirement."""
    from s2r_spec.json_objects.monitor import (
        FailedRequirement,
        MonitoredRequirement,
        Sampling,
        UnknownRequirement,
    )
    from s2r_spec.json_values import extended

    sampling = None if found.sampled is None else Sampling(**vars(found.sampled))
    if found.reason is None:
        assert sampling is not None
        return extended(UnknownRequirement, sampling, requirement=found.requirement, text=found.text)
    verdict = Verdict.of(found.satisfied).value
    if sampling is None:
        return extended(FailedRequirement, found.reason, verdict=verdict, text=found.text)
    return extended(MonitoredRequirement, found.reason, verdict=verdict, text=found.text, **vars(sampling))


def _print(results: list[MonitoredTrace | UnreadTrace]) -> None:
    from s2r_spec.json_objects.monitor import UnreadTrace

    console = terminal.console()
    for result in results:
        if isinstance(result, UnreadTrace):
            continue  # printed on stderr
        taken = ", ".join(f"{name} = {result.params[name]:g}" for name in result.from_trace)
        from rich.text import Text

        head = Text(one_line(result.trace), style="bold")
        console.print(head.append(f", {taken} as recorded", style="not bold") if taken else head)
        for one in result.requirements:
            terminal.print_verdict(lines(one.text), Verdict.of(one.satisfied))
