"""A backend from a class, an object or a function of a Python file or module."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from s2r_spec.backend.files import explaining, load_code, split_options
from s2r_spec.backend.function import FunctionBackend
from s2r_spec.backend.model import Effect
from s2r_spec.backend.options import read_options
from s2r_spec.base.errors import UsageError
from s2r_spec.trace import Trace


def open_code(text: str) -> Any:
    """Return the backend that ``PATH.py:NAME[:OPTIONS]`` or ``module:NAME[:OPTIONS]`` names.

    A class or a factory gets the options as one text. Without channels and parameters of its own, its result or the
    named object becomes a :class:`FunctionBackend` with the hash of the code, and words ``effect.parameter=value`` of
    the options add effects. Anything else is returned as it is, and must keep the whole protocol.

    Raises:
        UsageError: as :func:`s2r_spec.backend.files.load_code`, or no backend comes from the object and the options.
    """
    name, options = split_options(text)
    code = load_code(name)
    if not _is_factory(code.value):
        if _declares(code.value) and options:
            raise UsageError(f"{name} is an object and takes no options; leave out {options!r}")
        return code.value if _declares(code.value) else _named(code.value, name, code.digest, "", options)
    words = [word for word in options.split(",") if word]
    added = ",".join(word for word in words if "." in word.partition("=")[0])
    own = ",".join(word for word in words if "." not in word.partition("=")[0])
    made = _make(code.value, own, name, code.files[0])
    if added and (_declares(made) or not hasattr(made, "effects")):
        made, own, added = _make(code.value, options, name, code.files[0]), options, ""
    return made if _declares(made) else _named(made, name, code.digest, own, added)


def _is_factory(value: Any) -> bool:
    """Return whether something is a class, or a function with at most one required argument."""
    if isinstance(value, type) or hasattr(value, "rollout") or not callable(value):
        return isinstance(value, type)
    return _takes(value) or _takes(value, "")


def _declares(made: Any) -> bool:
    """Return whether an object has channels or parameters of its own."""
    return not isinstance(made, FunctionBackend) and (
        hasattr(made, "channels") or hasattr(made, "parameters")
    )


def _takes(function: Callable[..., Any], *arguments: Any) -> bool:
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError:
        return False
    except ValueError:  # of a library, which does not tell
        return True
    return True


def _make(factory: Callable[..., Any], options: str, name: str, path: Path) -> Any:
    arguments = (options,) if options else ()
    if not _takes(factory, *arguments):
        if options:
            raise UsageError(f"{name} takes no options; leave out {options!r}")
        if _takes(factory, ""):
            raise UsageError(f"{name} needs options: write {name}:OPTIONS")
        raise UsageError(
            f"{name}{inspect.signature(factory)} must be callable without arguments, or with one text"
        )
    with explaining(":".join((name, *arguments)), path):
        return factory(*arguments)


def _named(made: Any, name: str, digest: str, own: str, added: str) -> FunctionBackend:
    """Return a function, or an object with a rollout, as the backend of this name, options and effects."""
    function, effects = _function(made, name)
    own_hash = made.nominal[1] if isinstance(made, FunctionBackend) else getattr(made, "model_hash", "")
    if own or own_hash:
        digest = sha256(f"{digest} {own} {own_hash}".encode()).hexdigest()
    backend = FunctionBackend(
        function,
        f"{name}:{own}" if own else name,
        getattr(made, "deterministic", True),
        getattr(made, "cost", 0.1),
        digest,
        effects=effects,
    )
    if isinstance(made, FunctionBackend):
        backend = backend.with_effects(made.chosen())
    _, choice = read_options(name, added, {}, effects)
    return backend.with_effects({effect: dict(values) for effect, values in choice})


def _function(made: Any, name: str) -> tuple[Callable[..., Trace], tuple[Effect, ...]]:
    """Return the function of a test and a seed, and its effects; with effects it takes their values, too."""
    effects = getattr(made, "effects", ())
    effects = effects() if callable(effects) else effects
    if not isinstance(effects, tuple | list) or not all(isinstance(effect, Effect) for effect in effects):
        raise UsageError(f"{name}: effects must be a tuple of s2r.Effect, not {effects!r}")
    if getattr(made, "exclusive", False) or hasattr(made, "attendance"):
        raise UsageError(f"{name} moves a machine, so it must declare its channels and parameters itself")
    if isinstance(made, FunctionBackend):
        return made.function, tuple(effects)
    function = getattr(made, "rollout", made)
    if effects and hasattr(made, "with_effects"):
        function = _Rebuilt(made)
    if not callable(function):
        raise UsageError(
            f"{name} is a value of type {type(made).__name__}; name a class or an object with "
            f"rollout(params, seed), or a function f(params, seed)"
        )
    arguments: tuple[Any, ...] = ({}, 0, {}) if effects else ({}, 0)
    if not _takes(function, *arguments):
        given = "a test, a seed and the values of its effects" if effects else "a test and a seed"
        raise UsageError(
            f"{name} has rollout{inspect.signature(function)}, but it is called with {given}: "
            f"rollout(params, seed{', effects' * bool(effects)})"
        )
    return function, tuple(effects)


@dataclass(frozen=True)
class _Rebuilt:
    """The rollout of an object that makes another one for each setting of its effects."""

    robot: Any

    def __call__(
        self, params: Mapping[str, float], seed: int, values: Mapping[str, Mapping[str, float]]
    ) -> Trace:
        trace: Trace = self.robot.with_effects(values).rollout(params, seed)
        return trace
