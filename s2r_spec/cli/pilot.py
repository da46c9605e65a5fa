"""``s2r pilot``: settings for a certificate from rollouts that no certificate uses."""

from __future__ import annotations

from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import typer

from s2r_spec.base.errors import UsageError
from s2r_spec.base.files import save
from s2r_spec.base.json_values import line
from s2r_spec.cli.options.groups import group_options, options, search_option
from s2r_spec.cli.options.search import AsJson, OneRequirement, Running, Seed, SpecFile
from s2r_spec.cli.terminal.common import begin_run, refuse_without_operator, resumable, sentences
from s2r_spec.cli.terminal.terminal import console, say

if TYPE_CHECKING:
    from s2r_spec.certify.pilot.run import PilotResult


WIDTH = 88
"""Definition: most letters of a line that gives a reason."""


@options
class Piloted:
    """The backends and the size of a pilot; each field is an option."""

    backend: str = typer.Option(
        "sim", "--backend", "-b", "--sim", help="Backend of the certificate, or the simulator of a gap."
    )
    real: str | None = typer.Option(
        None, help="Backend of the real machine: proposes the settings of the gap to it.", show_default=False
    )
    requirement: OneRequirement = None
    write: bool = typer.Option(False, "--write", help="Put the proposed line into the specification.")
    budget: int | None = search_option(
        None, min=1, help="Most rollouts; of a gap, most real ones.", show_default="4 at each test of a grid"
    )


@group_options
def pilot(
    spec: SpecFile, *, piloted: Piloted, seed: Seed = None, running: Running, as_json: AsJson = False
) -> None:
    """Propose a certify line (B, R, kernel, epsilon) from rollouts on a grid of tests."""
    with sentences(as_json):
        names = [piloted.backend, *([piloted.real] if piloted.real else [])]
        refuse_without_operator(names[-1])
        from s2r_spec.certify.options import seed_of
        from s2r_spec.certify.pilot.run import pilot as run_pilot
        from s2r_spec.cli.terminal.progress import Live
        from s2r_spec.report.records.plan import PilotObject
        from s2r_spec.runs.layout import SYSTEMS
        from s2r_spec.spec import load_spec

        parsed, resume = load_spec(spec), running.resume
        places = [] if resume is None else [resume, *(resume / side for side in SYSTEMS)]
        seed = seed_of(seed, *places)
        name = "-".join(["pilot", spec.stem, *names])
        executor, folder, opening = begin_run(running, name, seed, names[-1])
        with resumable(folder), Live(console(stderr=True), running.quiet, opening=opening) as live:
            result = run_pilot(
                parsed,
                piloted.backend,
                folder,
                real=piloted.real,
                requirement=piloted.requirement,
                budget=piloted.budget,
                seed=seed,
                executor=executor,
                resume=resume is not None,
                observer=live,
            )
        place = _write(spec, result) if piloted.write else None
        if as_json:
            print(line(PilotObject(result=result, written=place)))
            return
        _print(spec, result)
        if place is not None:
            say(f"  The line is in {place}.")


def _write(spec: Path, result: PilotResult) -> str:
    """Put the line into the specification; return its place."""
    from s2r_spec.lang.certify_line import with_certify_line
    from s2r_spec.lang.files import read_text
    from s2r_spec.spec import parse_spec

    text, number = with_certify_line(read_text(spec), str(spec), result.requirement, result.line)
    parse_spec(text, str(spec))  # before the file is touched
    try:
        save(spec, text)
    except OSError as error:
        raise UsageError(f"cannot write {spec}: {error.strerror or error}") from None
    return f"{spec}:{number}"


def _print(spec: Path, result: PilotResult) -> None:
    proposal = result.proposal
    unit = f" {result.unit}" if result.unit else ""
    fallen = ", ".join(f"{count} × {word}" for word, count in result.failures.items()) or "no falls"
    where = ", ".join(f"{name} = {value:.3g}" for name, value in proposal.worst.items())
    say(f"{result.requirement}  ({spec.name} on {' and '.join(result.backends)})")
    say(f"  pilot     {result.rollouts} rollouts at {result.tests} tests ({result.layout}), {fallen}")
    of = f" of {result.backends[-1]}" if len(result.backends) > 1 else ""
    say(
        f"  mean ρ    {proposal.lowest_mean:+.4f} … {proposal.highest_mean:+.4f}{unit}{of}, lowest at {where}"
    )
    say("")
    for text in result.line.splitlines():
        say(text)
    say("")
    low, high = proposal.expected
    rollouts, width = (
        ("real rollouts", "gap_epsilon") if len(result.backends) > 1 else ("rollouts", "epsilon")
    )
    expected = f"{low} … {high} {rollouts} until the interval is {width} wide; a verdict may come earlier"
    rows = [*proposal.reasons.items(), ("expected", expected)]
    rows += [("note", warning) for warning in proposal.warnings]
    indent = 4 + max(len(name) for name, _ in rows)
    for name, words in rows:
        first = f"  {name}".ljust(indent)
        for text in wrap(words, WIDTH, initial_indent=first, subsequent_indent=" " * indent):
            say(text)
    say(f"  These rollouts, in {result.folder}, are for the settings only; a certificate runs others.")
