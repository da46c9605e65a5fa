"""A function ``f(params, seed)`` that returns a trace, as a backend."""

from __future__ import annotations

import inspect
import marshal
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, Self

from s2r_spec.backend import Channel, Effect, Needs, Parameter
from s2r_spec.backend.effects import Choice, Values, as_values, choose, settings, words
from s2r_spec.backend.files import split_options
from s2r_spec.base.errors import UsageError
from s2r_spec.trace import Trace


class Catalogue(tuple[Effect, ...]):
    """The effects of a function: the field ``effects``, and what ``effects()`` returns."""

    def __call__(self) -> tuple[Effect, ...]:
        """Return the effects."""
        return tuple(self)


@dataclass(frozen=True)
class FunctionBackend:
    """A backend from a function of a test and a seed.

    The specification declares the channels, the parameters and their units. The function gets the parameters in these
    units, and its trace must last as long as the requirement looks ahead. It draws all random numbers from the seed.

        robot = s2r.FunctionBackend(simulate)
        s2r.check(spec, robot, "runs/night")

    Args:
        function: returns the trace of a test: ``f(params, seed)``; with ``effects``, ``f(params, seed, values)``, where
            ``values`` has every effect → parameter → value, nominal unless it was set.
        name: name in reports; the function's own name if empty.
        deterministic: whether the same parameters and seed give the same trace, whatever ran before. A run tests this.
        cost: expected CPU time of one rollout [s]; a rollout of 60 s and a hundred times as much counts as a crash.
        model_hash: text that changes whenever traces could. If empty, a hash of the function's own source: it does not
            change with other functions that it calls, nor with files that it reads.
        duration: duration of a trace [s]; the specification's horizon replaces it.
        effects: unmodelled physics that the function can add; ``s2r diagnose`` then names causes of a gap.

    Raises:
        UsageError: it is not a function, or its source cannot be read and there is no ``model_hash``.
    """

    function: Callable[..., Trace]
    name: str = ""
    deterministic: bool = True
    cost: float = 0.1
    model_hash: str = ""
    duration: float = 0.0
    channels: tuple[Channel, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    effects: Any = ()  # a Catalogue, which is called as the method of HasEffects is
    added: Choice = ()
    nominal: tuple[str, str] = ("", "")
    """Name and model hash without added effects."""

    def __post_init__(self) -> None:
        """Complete the name and the hash."""
        if not callable(self.function):
            raise UsageError(
                f"a FunctionBackend needs a function of a test and a seed, not {self.function!r}"
            )
        own = getattr(self.function, "__name__", type(self.function).__name__)
        object.__setattr__(self, "name", self.name or own)
        object.__setattr__(self, "model_hash", self.model_hash or _hash(self.function, self.name))
        object.__setattr__(self, "effects", Catalogue(self.effects))
        if not self.added:
            object.__setattr__(self, "nominal", (self.name, self.model_hash))

    def rollout(self, params: Mapping[str, float], seed: int) -> Trace:
        """Run one test."""
        if not self.effects:
            return self.function(params, seed)
        nominal = {effect.name: {p.name: p.nominal for p in effect.parameters} for effect in self.effects}
        return self.function(params, seed, nominal | settings(self.effects, self.added))

    def with_effects(self, values: Values) -> Self:
        """Return this backend with these effects added: effect → parameter → value.

        Raises:
            UsageError: an effect or a parameter is unknown, or a value out of range.
        """
        added = choose(self.name, self.effects, self.added, values)
        name, model_hash = self.nominal
        if added:
            options = ",".join(words(added))
            name += f"{',' if split_options(name)[1] else ':'}{options}"
            model_hash = sha256(f"{model_hash} {options}".encode()).hexdigest()
        return replace(self, added=added, name=name, model_hash=model_hash)

    def chosen(self) -> Values:
        """Return effect → parameter → value of the added effects."""
        return as_values(self.added)

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
