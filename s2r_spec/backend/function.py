"""A function ``f(params, seed)`` that returns a trace, as a backend."""

from __future__ import annotations

import inspect
import marshal
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, Self

from s2r_spec.backend import Channel, Needs, Parameter
from s2r_spec.base.errors import UsageError
from s2r_spec.trace import Trace


@dataclass(frozen=True)
class FunctionBackend:
    """A backend from a function of a test and a seed.

    The specification declares the channels, the parameters and their units. The function gets the parameters in these
    units, and its trace must last as long as the requirement looks ahead. It draws all random numbers from the seed.

        robot = s2r.FunctionBackend(simulate)
        s2r.check(spec, robot, "runs/night")

    Args:
        function: returns the trace of a test: ``f(params, seed)``.
        name: name in reports; the function's own name if empty.
        deterministic: whether the same parameters and seed give the same trace, whatever ran before. A run tests this.
        cost: expected CPU time of one rollout [s]; a rollout of 60 s and a hundred times as much counts as a crash.
        model_hash: text that changes whenever traces could. If empty, a hash of the function's own source: it does not
            change with other functions that it calls, nor with files that it reads.
        duration: duration of a trace [s]; the specification's horizon replaces it.

    Raises:
        UsageError: it is not a function, or its source cannot be read and there is no ``model_hash``.
    """

    function: Callable[[Mapping[str, float], int], Trace]
    name: str = ""
    deterministic: bool = True
    cost: float = 0.1
    model_hash: str = ""
    duration: float = 0.0
    channels: tuple[Channel, ...] = ()
    parameters: tuple[Parameter, ...] = ()

    def __post_init__(self) -> None:
        """Complete the name and the hash."""
        if not callable(self.function):
            raise UsageError(
                f"a FunctionBackend needs a function of a test and a seed, not {self.function!r}"
            )
        own = getattr(self.function, "__name__", type(self.function).__name__)
        object.__setattr__(self, "name", self.name or own)
        object.__setattr__(self, "model_hash", self.model_hash or _hash(self.function, self.name))

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test."""
        return self.function(params, seed)

    def with_duration(self, seconds: float) -> Self:
        """Return this backend with a declared duration [s]; the function decides how long its traces are."""
        return replace(self, duration=seconds)

    def for_spec(self, needs: Needs) -> Self:
        """Return this backend with the channels and parameters of a specification."""
        return replace(self, channels=needs.channels, parameters=needs.parameters)


def _hash(function: Any, name: str) -> str:
    try:
        source = inspect.getsource(function).encode()
    except (OSError, TypeError):
        code = getattr(function, "__code__", None)
        if code is None:
            raise UsageError(
                f"the source of {name} cannot be read; give model_hash, a text that changes with the model"
            ) from None
        source = marshal.dumps(code)
    return sha256(source).hexdigest()
