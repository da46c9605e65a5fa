"""Which protocols may be run, and the next experiment in words and as a file that a robot can play."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from s2r_spec.backend import Backend
from s2r_spec.backend.protocols import HasPlayable, HasProtocols, Protocol, protocol_of, write_playable
from s2r_spec.base.errors import UsageError
from s2r_spec.diagnose.simulator.experiments import Experiment


def canonical(protocol: Protocol, params: Mapping[str, float]) -> Experiment:
    """Return the experiment of a run, without the parameters at the protocol's defaults.

    Raises:
        UsageError: a parameter is not declared, is not a number, or is outside its range.
    """
    values = protocol.values(params)
    changed = {p.name: values[p.name] for p in protocol.parameters if values[p.name] != p.default}
    return Experiment(protocol.name, tuple(sorted(changed.items())))


def allowed_experiments(
    simulator: Backend, machine: Backend, names: Sequence[str] | None = None
) -> tuple[tuple[Experiment, ...], tuple[str, ...]]:
    """Return an experiment for each protocol that both sides have, in the machine's order, and notes on the others.

    Parameters have the simulator's defaults, moved into the machine's range. The machine of recordings is the simulator
    again. ``names`` are protocols that may be run; None for all, empty for none.

    Raises:
        UsageError: one of the names is not a protocol of the machine, or of the simulator.
    """
    for name in names or ():
        protocol_of(machine, name)
        protocol_of(simulator, name)
    experiments, notes = [], []
    every = machine.protocols() if isinstance(machine, HasProtocols) else ()
    for other in (each for each in every if names is None or each.name in names):
        try:
            own = protocol_of(simulator, other.name)
            if {(p.name, p.unit) for p in own.parameters} != {(p.name, p.unit) for p in other.parameters}:
                raise UsageError("its parameters, or their units, differ between machine and simulator")
            defaults = own.values({})
            moved = {p.name: min(max(defaults[p.name], p.low), p.high) for p in other.parameters}
            experiments.append(canonical(own, moved))
        except UsageError as error:
            notes.append(f"the protocol {other.name!r} is not run: {error}")
    return tuple(experiments), tuple(notes)


def with_protocols_of(backend: Backend, runnable: Sequence[Experiment]) -> list[Experiment]:
    """Return experiments, and after them the simulator's other protocols at their defaults."""
    have = {experiment.protocol for experiment in runnable}
    own = backend.protocols() if isinstance(backend, HasProtocols) else ()
    return [*runnable, *(Experiment(protocol.name) for protocol in own if protocol.name not in have)]


def next_words(
    experiment: Experiment,
    units: Mapping[str, str],
    simulator: Backend,
    path: Path | None = None,
    replayed: bool = False,
    machine: Backend | None = None,
) -> str:
    """Return which experiment to run next; a test is in ``units``, or is ``replayed`` from recorded commands.

    A machine that has references of its protocols writes them to ``path``, which ends in ``.csv``; else the simulator
    does, if it has them.

    Raises:
        UsageError: the simulator, or the machine, does not have the protocol; or the path does not end in ``.csv``.
        TraceError: the file cannot be written.
    """
    add = "Then add its log, with its row of rollouts.csv, to the folder."
    if not experiment.protocol:
        test = _values(experiment.values, units)
        if replayed:
            return (
                f"Play the commands again that were recorded at {test}. Then add the log, with another value of some "
                f"parameter of the specification in its row of rollouts.csv, to the folder."
            )
        return f"Run the test {test or 'of the spec'} next. {add}"
    protocol = protocol_of(simulator, experiment.protocol)
    params = protocol.values(experiment.values)
    values = _values(params, {p.name: p.unit for p in protocol.parameters})
    player = machine if isinstance(machine, HasPlayable) else simulator
    if path is not None and isinstance(player, HasPlayable):
        playing = write_playable(player, protocol.name, params, path)
    else:
        playing = protocol.words + (f" Risk: {protocol.risk}." if protocol.risk else "")
    return f"Run the protocol {protocol.name}{f' with {values}' if values else ''} next. {playing} {add}"


def _values(params: Mapping[str, float], units: Mapping[str, str]) -> str:
    return ", ".join(f"{name} = {value:.4g} {units.get(name, '')}".rstrip() for name, value in params.items())
