"""``s2r monitor``: ρ of recorded traces, with the reason, or of a trace while it is recorded."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.base.errors import UsageError
from s2r_spec.base.json_values import line
from s2r_spec.base.printable import lines, one_line
from s2r_spec.base.verdict import Verdict
from s2r_spec.cli.options.groups import group_options, options, output_option
from s2r_spec.cli.options.logs import LogForm, missing
from s2r_spec.cli.options.search import SpecFile
from s2r_spec.cli.terminal import terminal
from s2r_spec.cli.terminal.common import answered, note, sentences

if TYPE_CHECKING:
    from s2r_spec.recordings.spec_traces import TraceRequest
    from s2r_spec.report.monitor import Evaluated, Unread
    from s2r_spec.spec import Spec
    from s2r_spec.spec.followed import Ended, VerdictChange
    from s2r_spec.spec.monitored import Conventions

TraceFiles = Annotated[
    list[Path],
    typer.Argument(
        help="Files of recorded traces. With --online, one file, or - to read CSV rows from stdin.",
        show_default=False,
    ),
]
AsJson = Annotated[
    bool, output_option("--json", help="Print one JSON object on stdout; with --online, one on each line.")
]


@options
class Following:
    """Whether a trace is followed while it is recorded, and how; each field is an option."""

    online: bool = typer.Option(
        False,
        "--online",
        help="Follow one trace sample by sample; print the range of possible ρ whenever it changes.",
    )
    period: float | None = typer.Option(
        None, help="With --online: sample period in seconds.", show_default="as the samples come"
    )
    ranges: bool = typer.Option(
        True, help="With --online: assume that signals stay in their declared ranges."
    )


@options
class Evaluation:
    """What is evaluated, and by which conventions; each field is an option."""

    params: list[str] | None = typer.Option(
        None,
        "--param",
        "-p",
        help="Value of a test parameter: vd=0.3 in its declared unit, 'vd=30 cm/s'. vd=/cmd.speed@0 takes it from "
        "a field of the log, 0 s after the start. May be repeated.",
        show_default="as the trace says",
    )
    requirements: list[str] | None = typer.Option(
        None, "--requirement", "-r", help="Requirement to evaluate; may be repeated.", show_default="all"
    )
    partial: bool = typer.Option(
        False, "--partial", help="Evaluate a trace that is too short, with windows cut at its end."
    )
    like: str = typer.Option(
        "s2r",
        "--profile",
        help="Conventions of another tool: breach, moonlight, rtamt, rtamt-dense, stlcgpp, stlrom or tidystl.",
    )

    def request(self, spec: Path, reading: LogForm) -> TraceRequest:
        """Return what is evaluated, and how files are read."""
        from s2r_spec.recordings.log_episodes import read_sources
        from s2r_spec.recordings.spec_traces import TraceRequest
        from s2r_spec.spec import load_spec

        parsed = load_spec(spec)
        stated, sources = read_sources(self.params or [])
        values = parsed.read_params(stated)
        chosen = tuple(self.requirements or parsed.requirements)
        return TraceRequest(parsed, chosen, values, reading.episode_settings(sources), missing(reading.nan))


@group_options
def monitor(
    spec: SpecFile,
    traces: TraceFiles,
    *,
    evaluation: Evaluation,
    following: Following,
    reading: LogForm,
    as_json: AsJson = False,
) -> None:
    """Evaluate requirements on recorded traces: robustness ρ, verdict, and the instant that decides."""
    with sentences(as_json):
        from s2r_spec.robustness.profiles import profile
        from s2r_spec.spec.monitored import Conventions

        request, like = evaluation.request(spec, reading), evaluation.like
        conventions = Conventions(request.nan, evaluation.partial, reading.time_unit is not None, like=like)
        profile(like)
        if not following.online:
            if following.period is not None or not following.ranges:
                raise UsageError("--period and --no-ranges are for --online")
            raise typer.Exit(_evaluate(request, traces, conventions, as_json))
        if like != "s2r":
            raise UsageError("--profile is for recorded traces; --online evaluates only at the samples")
        if len(traces) != 1:
            raise UsageError("--online follows one trace: give one file, or - for stdin")
        raise typer.Exit(_follow(request, traces[0], following, conventions, as_json))


def _evaluate(request: TraceRequest, traces: list[Path], conventions: Conventions, as_json: bool) -> int:
    """Evaluate recorded traces, print their results, and return the exit code."""
    from s2r_spec.report.monitor import Unread, exit_code, monitor_file, monitor_record

    results: list[Evaluated | Unread] = []
    for path in traces:
        try:
            results += monitor_file(request, path, conventions)
        except UsageError as error:
            if len(traces) == 1:
                raise
            print(f"error: {error}", file=sys.stderr)
            results.append(Unread(path, str(error)))
    if as_json:
        record = monitor_record(request, results, conventions.like)
        answered.set()
        print(line(record, infinite=True))
        return record.exit_code
    for result in results:
        if isinstance(result, Unread):  # printed on stderr
            continue
        trace = result.trace
        taken = ", ".join(f"{name} = {trace.params[name]:g}" for name in sorted(trace.taken))
        terminal.print_heading(one_line(trace.name), f", {taken} as recorded" if taken else "")
        for one in result.results:
            terminal.print_verdict(lines(one.text), Verdict.of(one.satisfied))
    return exit_code(results)


def _follow(
    request: TraceRequest, source: Path, following: Following, conventions: Conventions, as_json: bool
) -> int:
    """Follow a file, or standard input if it is ``-``, to its end; print each change, and return the exit code."""
    from s2r_spec.recordings.spec_traces import in_file, stream_of_file, stream_of_rows
    from s2r_spec.report.monitor import change_record, online_record
    from s2r_spec.spec.followed import OnlineConventions, VerdictChange, follow
    from s2r_spec.trace.instants import instant

    how = OnlineConventions(
        period=following.period,
        ranges=following.ranges,
        partial=conventions.partial,
        nan=conventions.nan,
        sparse=conventions.sparse,
    )
    naming: AbstractContextManager[None]
    if str(source) != "-":
        stream, naming = stream_of_file(request, source), in_file(source)
    else:
        if hasattr(sys.stdin, "reconfigure"):
            sys.stdin.reconfigure(errors="replace")  # other columns may hold bytes that are not text
        stream, naming = stream_of_rows(request, sys.stdin.readline), nullcontext()
    ended: list[Ended] = []
    with naming:
        for one in follow(request.spec, request.requirements, stream, how):
            if not isinstance(one, VerdictChange):
                ended.append(one)
            elif as_json:
                print(line(change_record(request.spec, one), infinite=True), flush=True)
            else:
                _print(request.spec, one, f"t = {instant(one.times, one.times[-1])}  ")
    for sentence in stream.notes:
        note(sentence)
    record = online_record(request.spec, stream.params, ended)
    if as_json:
        print(line(record, infinite=True), flush=True)
        return record.exit_code
    for one in ended:
        _print(request.spec, one, "", f" ({one.shortfall})" if one.shortfall else "")
    return record.exit_code


def _print(spec: Spec, result: VerdictChange | Ended, before: str, after: str = "") -> None:
    """Print the interval of a requirement, or ρ if it is decided."""
    interval, unit = result.interval, spec.unit(result.requirement)
    words = f"ρ in [{interval.lower:+.6g}, {interval.upper:+.6g}] {unit}".rstrip()
    if interval.decided:
        words = f"ρ = {interval.lower:+.6g} {unit}".rstrip()
    text = f"{before}{result.requirement} {interval.verdict}: {words}{after}"
    terminal.print_verdict(one_line(text), Verdict.of(interval.satisfied))
