"""``s2r backends``: the installed backends, and the declarations of one."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.base.errors import UsageError
from s2r_spec.base.json_values import line
from s2r_spec.cli.options.search import AsJson
from s2r_spec.cli.terminal.common import finding_lines, sentences
from s2r_spec.cli.terminal.terminal import say

if TYPE_CHECKING:
    from s2r_spec.backend import Backend, Parameter
    from s2r_spec.report.records.backends import BackendObject

Name = Annotated[
    str | None,
    typer.Argument(
        help="Backend to describe: its parameters, channels, protocols and effects. Without a name, all installed "
        "ones are listed. The code of a PATH.py:NAME runs when it is loaded; that of other files only with --check."
    ),
]
Check = Annotated[
    bool,
    typer.Option(
        "--check",
        help="Run the backend and check the rules of the backend protocol. Exit code 1 if it breaks one.",
    ),
]


Spec = Annotated[
    Path | None,
    typer.Option(
        "--spec",
        metavar="SPEC",
        help="Specification with the parameters and channels of a function in a Python file.",
    ),
]


Log = Annotated[
    str | None,
    typer.Option(
        "--log",
        metavar="FOLDER",
        help="Recordings of the robot: hold its control loop against that of a robot file, tick by tick. "
        "Exit code 1 if they differ.",
    ),
]


def backends(
    name: Name = None, check: Check = False, spec: Spec = None, log: Log = None, as_json: AsJson = False
) -> None:
    """List the installed backends, or describe one of them."""
    with sentences(as_json):
        from s2r_spec.backend import described, endings, installed
        from s2r_spec.report.records.backends import BackendObject, BackendsObject

        if name is None and (check or log):
            option = "--check" if check else "--log FOLDER"
            raise UsageError(f"{option} needs the name of a backend: s2r backends NAME {option}")
        if name is None:
            classes = {key: point.value for key, point in installed().items()}
            if as_json:
                print(line(BackendsObject(backends=classes)))
                return
            classes |= {f"PATH.{ending}": point.value for ending, point in endings().items()}
            for key, value in classes.items():
                say(f"{key:12} {value}")
            say(
                "PATH.py:NAME a class, an object or a function of a Python file; of a module it is module:NAME"
            )
            return
        machine, options = described(name)
        machine = _for_spec(machine, spec, check)
        record = BackendObject.of(machine, name, tuple(options))
        if check and record.exclusive:
            raise UsageError(
                f"{name} is a machine: --check would move it to the ends of its ranges. "
                f"The commands check, gap and certify run it with its operator"
            )
        if log is not None:
            raise typer.Exit(_loop(machine, log, as_json))
        if check:
            raise typer.Exit(_check(machine, as_json))
        if as_json:
            print(line(record))
            return
        for each in _lines(machine, record):
            say(each)


def _for_spec(machine: Backend, path: Path | None, check: bool) -> Backend:
    """Return a backend with the parameters and channels of a spec, if it has none of its own."""
    from s2r_spec.backend import NeedsSpec, is_exclusive

    if path is None and not _needs_spec(machine):
        return machine
    if not isinstance(machine, NeedsSpec) or is_exclusive(machine):
        raise UsageError(f"{machine.name} declares its own parameters and channels: leave out --spec")
    if path is None and check:
        raise UsageError(f"{machine.name} takes its parameters and channels from a spec; add --spec SPEC")
    if path is None:
        return machine
    from s2r_spec.runs.scorer import open_for_requirement
    from s2r_spec.spec import load_spec

    spec = load_spec(path)
    return open_for_requirement(spec, spec.requirements[0], machine)


def _needs_spec(machine: Backend) -> bool:
    from s2r_spec.backend import NeedsSpec, is_exclusive

    return (
        isinstance(machine, NeedsSpec)
        and not (machine.parameters or machine.channels)
        and not is_exclusive(machine)
    )


def _lines(machine: Backend, record: BackendObject) -> Iterator[str]:
    lasting = f"of {machine.duration:g} s" if machine.duration else "as long as the spec looks ahead"
    yield f"{machine.name}: rollouts {lasting}, about {machine.cost:g} s each on one core"
    if record.exclusive:
        yield "a machine: its rollouts run one at a time, each after its operator's confirmation"
    yield from (f"assumption: {sentence}" for sentence in record.assumptions or ())
    if record.options:
        yield f"options, separated by commas, as in {machine.name}"
    for option in record.options or ():
        default = "required" if option.default is None else f"default {option.default}"
        yield f"  {option.name:14} {default}: {option.description}"
    if _needs_spec(machine):
        yield "its parameters and channels are those of a spec, which --spec SPEC gives"
    else:
        yield "parameters"
        yield from (f"  {p.name:14} {_range(p)}" for p in record.parameters)
        yield "channels"
    for c in record.channels:
        size = f"[{c.width}]" if c.width > 1 else ""
        yield f"  {c.name + size:14} {c.unit or '1'}: {c.description}"
    if record.protocols:
        yield "protocols that excite it, beside the tests of a spec"
    for protocol in record.protocols or ():
        yield f"  {protocol.name} ({protocol.place}, {protocol.duration:g} s): {protocol.words}"
        if protocol.risk:
            yield f"    risk: {protocol.risk}"
        yield from (f"    {p.name:12} {_range(p)}" for p in protocol.parameters)
    if record.effects:
        yield "effects that `s2r diagnose` can name"
    for effect in record.effects:
        yield f"  {effect.name} ({effect.family}): {effect.physics}"
        for one in effect.parameters:
            unit = f" {one.unit}" if one.unit else ""
            yield f"    {one.name:12} [{one.low:g}, {one.high:g}]{unit}; nominal {one.nominal:g}; {one.prior}"


def _range(p: Parameter) -> str:
    unit = f" {p.unit}" if p.unit else ""
    return f"[{p.low:g}, {p.high:g}]{unit}; default {p.default:g}: {p.description}"


def _loop(machine: Backend, log: str, as_json: bool) -> int:
    """Print what recordings say of the control loop of a robot's files, and return the exit code."""
    from s2r_spec.report.records.backends import LoopObject
    from s2r_spec.testing.loop import loop_findings

    findings, recordings = loop_findings(machine, log)
    wrong = sum(one.level == "wrong" for one in findings)
    if as_json:
        print(line(LoopObject(name=machine.name, recordings=recordings, loop=tuple(findings))))
        return 1 if wrong else 0
    for finding in findings:
        for each in finding_lines(finding):
            say(each)
    if wrong:
        words = f"differs from that of {machine.name} in {wrong} equation{'s' * (wrong > 1)}"
    else:
        words = f"is that of {machine.name}, as far as the log shows it"
    say(f"the loop of {recordings} recording{'s' * (recordings > 1)} {words}")
    return 1 if wrong else 0


def _check(machine: Backend, as_json: bool) -> int:
    """Print the pre-flight and each conformance check as soon as it is known, and return the exit code."""
    from s2r_spec.report.records.backends import ConformanceObject
    from s2r_spec.testing.conformance import check_conformance
    from s2r_spec.testing.preflight import FAULT, preflight

    findings, checks = [], []
    # What the user's code prints must not be among the lines of --json.
    with redirect_stdout(sys.stderr) if as_json else nullcontext():
        for finding in preflight(machine):
            findings.append(finding)
            if not as_json:
                for each in finding_lines(finding):
                    say(each)
        wrong = sum(finding.level == "wrong" for finding in findings)
        # A controller that cannot run breaks every rule for the same reason.
        for check in () if any(one.topic == FAULT for one in findings) else check_conformance(machine):
            checks.append(check)
            if not as_json:
                say(f"{'BROKEN' if check.violations else 'ok    '}  {check.requirement}")
                for sentence in check.violations + check.remarks:
                    say(f"        {sentence}")
    broken = sum(bool(check.violations) for check in checks)
    if as_json:
        found = tuple(findings) or None
        print(line(ConformanceObject(name=machine.name, promises=tuple(checks), preflight=found)))
    else:
        ends = [f"keeps {len(checks) - broken} of {len(checks)} rules"] if checks else []
        ends += [f"has {wrong} WRONG line{'s' * (wrong > 1)} in its pre-flight"] if wrong else []
        say(f"{machine.name} {' and '.join(ends)}")
    return 1 if broken or wrong else 0
