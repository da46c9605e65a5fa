"""``s2r backends``: the installed backends, and the declarations of one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from s2r_spec.cli.common import sentences
from s2r_spec.cli.terminal import say
from s2r_spec.errors import UsageError
from s2r_spec.json_values import line

if TYPE_CHECKING:
    from s2r_spec.backend import Backend


def backends(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Backend to describe: its parameters, channels, protocols and effects. Without a name, all are listed."
        ),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="Run the backend and check the rules of the backend protocol. Exit code 1 if it breaks one.",
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")] = False,
) -> None:
    """List the installed backends, or describe one of them."""
    with sentences(as_json):
        from s2r_spec import backend as registry
        from s2r_spec.json_objects.backends import BackendObject, BackendsObject
        from s2r_spec.protocols import HasProtocols

        if name is None and check:
            raise UsageError("--check needs the name of a backend: s2r backends NAME --check")
        if name is None:
            found = {key: point.value for key, point in registry.installed().items()}
            if as_json:
                print(line(BackendsObject(backends=found)))
            else:
                for key, value in found.items():
                    say(f"{key:12} {value}")
            return
        machine, options = registry.described(name)
        exclusive, assumed = registry.is_exclusive(machine), registry.assumptions_of(machine)
        if check and exclusive:
            raise UsageError(
                f"{name} is a machine: --check would move it to the ends of its ranges. "
                f"The commands check, gap and certify run it with its operator"
            )
        if check:
            raise typer.Exit(_checked(machine, as_json))
        protocols = machine.protocols() if isinstance(machine, HasProtocols) else ()
        effects = machine.effects() if isinstance(machine, registry.HasEffects) else ()
        if as_json:
            # A backend's own effects may have functions besides.
            plain = (registry.Effect(e.name, e.family, e.physics, tuple(e.parameters)) for e in effects)
            record = BackendObject(
                name=machine.name if options else name,
                model_hash=machine.model_hash,
                parameters=tuple(machine.parameters),
                channels=tuple(machine.channels),
                effects=tuple(plain),
                protocols=protocols or None,
                options=options or None,
                exclusive=True if exclusive else None,
                assumptions=assumed or None,
            )
            print(line(record))
            return
        say(f"{machine.name}: rollouts of {machine.duration:g} s, about {machine.cost:g} s each on one core")
        if exclusive:
            say("a machine: its rollouts run one at a time, each after its operator's confirmation")
        for sentence in assumed:
            say(f"assumption: {sentence}")
        if options:
            say(f"options, separated by commas, as in {machine.name}")
        for option in options:
            default = "required" if option.default is None else f"default {option.default}"
            say(f"  {option.name:14} {default}: {option.description}")
        say("parameters")
        for p in machine.parameters:
            say(
                f"  {p.name:14} [{p.low:g}, {p.high:g}]{f' {p.unit}' if p.unit else ''}; default {p.default:g}: "
                f"{p.description}"
            )
        say("channels")
        for c in machine.channels:
            size = f"[{c.width}]" if c.width > 1 else ""
            say(f"  {c.name + size:14} {c.unit or '1'}: {c.description}")
        if protocols:
            say("protocols that excite it, beside the tests of a spec")
        for protocol in protocols:
            say(f"  {protocol.name} ({protocol.place}, {protocol.duration:g} s): {protocol.words}")
            if protocol.risk:
                say(f"    risk: {protocol.risk}")
            for p in protocol.parameters:
                say(
                    f"    {p.name:12} [{p.low:g}, {p.high:g}]{f' {p.unit}' if p.unit else ''}; "
                    f"default {p.default:g}: {p.description}"
                )
        if effects:
            say("effects that `s2r diagnose` can name")
        for effect in effects:
            say(f"  {effect.name} ({effect.family}): {effect.physics}")
            for each in effect.parameters:
                say(
                    f"    {each.name:12} [{each.low:g}, {each.high:g}]{f' {each.unit}' if each.unit else ''}; "
                    f"nominal {each.nominal:g}; {each.prior}"
                )


def _checked(machine: Backend, as_json: bool) -> int:
    """Print the result of each conformance check as soon as it is known, and return the exit code."""
    from s2r_spec.conformance import check_conformance
    from s2r_spec.json_objects.backends import ConformanceObject

    found = []
    for check in check_conformance(machine):
        found.append(check)
        if not as_json:
            say(f"{'BROKEN' if check.violations else 'ok    '}  {check.requirement}")
            for sentence in check.violations + check.remarks:
                say(f"        {sentence}")
    broken = sum(bool(check.violations) for check in found)
    if as_json:
        print(line(ConformanceObject(name=machine.name, promises=tuple(found))))
    else:
        say(f"{machine.name} keeps {len(found) - broken} of {len(found)} rules")
    return 1 if broken else 0
