"""The objects of ``s2r backends``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from s2r_spec.backend import (
    Backend,
    Channel,
    Effect,
    Finding,
    HasEffects,
    Option,
    Parameter,
    assumptions_of,
    is_exclusive,
)
from s2r_spec.backend.protocols import HasProtocols, Protocol
from s2r_spec.base.json_types import Count
from s2r_spec.base.json_values import OPTIONAL
from s2r_spec.testing.subject import Check


@dataclass(frozen=True, kw_only=True)
class BackendsObject:
    """The result of ``s2r backends``.

    Attributes:
        backends: name → entry point, the place of its code.
    """

    schema: Literal["s2r.backends/1"] = "s2r.backends/1"
    backends: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class BackendObject:
    """The result of ``s2r backends NAME``.

    Attributes:
        name: the name of the backend, as in ``--backend``.
        model_hash: the hash of the model, which changes whenever traces could.
        parameters: the parameters of a test.
        channels: the channels of a trace.
        effects: the effects that a diagnosis can name.
        protocols: the excitation protocols that it can run; only if there are some.
        options: the options that may follow the name; only if there are some.
        exclusive: whether rollouts run one at a time; only for a machine.
        assumptions: the assumptions of every statement about this backend; only if there are some.
    """

    schema: Literal["s2r.backend/1"] = "s2r.backend/1"
    name: str
    model_hash: str
    parameters: tuple[Parameter, ...]
    channels: tuple[Channel, ...]
    effects: tuple[Effect, ...]
    protocols: tuple[Protocol, ...] | None = field(default=None, metadata=OPTIONAL)
    options: tuple[Option, ...] | None = field(default=None, metadata=OPTIONAL)
    exclusive: Literal[True] | None = field(default=None, metadata=OPTIONAL)
    assumptions: tuple[str, ...] | None = field(default=None, metadata=OPTIONAL)

    @classmethod
    def of(cls, machine: Backend, name: str, options: tuple[Option, ...]) -> BackendObject:
        """Return what a backend declares, found by its name, which these options may follow."""
        protocols = machine.protocols() if isinstance(machine, HasProtocols) else ()
        effects = machine.effects() if isinstance(machine, HasEffects) else ()
        return cls(
            name=machine.name if options else name,
            model_hash=machine.model_hash,
            parameters=tuple(machine.parameters),
            channels=tuple(machine.channels),
            # A backend's own effects may have functions besides.
            effects=tuple(Effect(e.name, e.family, e.physics, tuple(e.parameters)) for e in effects),
            protocols=tuple(protocols) or None,
            options=options or None,
            exclusive=True if is_exclusive(machine) else None,
            assumptions=assumptions_of(machine) or None,
        )


@dataclass(frozen=True, kw_only=True)
class ConformanceObject:
    """The result of ``s2r backends NAME --check``.

    Attributes:
        name: the name of the backend.
        promises: every requirement, in the order in which it was tried.
        preflight: what a backend finds in the user's files; only if it was put together from files.
    """

    schema: Literal["s2r.promises/1"] = "s2r.promises/1"
    name: str
    promises: tuple[Check, ...]
    preflight: tuple[Finding, ...] | None = field(default=None, metadata=OPTIONAL)


@dataclass(frozen=True, kw_only=True)
class LoopObject:
    """The result of ``s2r backends NAME --log FOLDER``.

    Attributes:
        name: the name of the backend.
        recordings: number of recordings.
        loop: what they say of each equation of the control loop.
    """

    schema: Literal["s2r.loop/1"] = "s2r.loop/1"
    name: str
    recordings: Count
    loop: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True)
class NewObject:
    """The result of ``s2r new``.

    Attributes:
        robot: the robot file.
        text: its content.
        marks: a sentence for each thing that no file states.
        problem: what keeps the robot from running as the file is; "" if nothing does.
    """

    schema: Literal["s2r.new/1"] = "s2r.new/1"
    robot: str
    text: str
    marks: tuple[str, ...]
    problem: str
