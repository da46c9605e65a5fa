"""The objects of ``s2r backends``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from s2r_spec.backend import Channel, Effect, Option, Parameter
from s2r_spec.json_values import OPTIONAL


@dataclass(frozen=True, kw_only=True)
class BackendsObject:
    """The result of ``s2r backends``.

    Attributes:
        schema: name and version of this object.
        backends: name → where its code is, as its entry point says.
    """

    schema: Literal["s2r.backends/1"] = "s2r.backends/1"
    backends: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class BackendObject:
    """The result of ``s2r backends NAME``.

    Attributes:
        schema: name and version of this object.
        name: as ``--backend`` says it.
        model_hash: changes whenever the traces could.
        parameters: the parameters of a test.
        channels: the channels of a trace.
        effects: that a diagnosis looks for.
        options: that may follow the name; only where there are some.
        exclusive: only of a machine: its rollouts run one at a time.
        assumptions: what every statement about this backend assumes of it; only where there are some.
    """

    schema: Literal["s2r.backend/1"] = "s2r.backend/1"
    name: str
    model_hash: str
    parameters: tuple[Parameter, ...]
    channels: tuple[Channel, ...]
    effects: tuple[Effect, ...]
    options: tuple[Option, ...] | None = field(default=None, metadata=OPTIONAL)
    exclusive: Literal[True] | None = field(default=None, metadata=OPTIONAL)
    assumptions: tuple[str, ...] | None = field(default=None, metadata=OPTIONAL)


@dataclass(frozen=True, kw_only=True)
class ConformanceCheck:
    """The result of trying one requirement on a backend.

    Attributes:
        words: the requirement.
        broken: a sentence for each place where it is not met.
        remarks: sentences on what is allowed, but may not be intended.
    """

    words: str
    broken: tuple[str, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ConformanceObject:
    """The result of ``s2r backends NAME --check``.

    Attributes:
        schema: name and version of this object.
        name: the name of the backend.
        promises: every requirement, in the order in which it was tried.
    """

    schema: Literal["s2r.promises/1"] = "s2r.promises/1"
    name: str
    promises: tuple[ConformanceCheck, ...]
