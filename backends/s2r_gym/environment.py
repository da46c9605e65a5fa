"""Gymnasium environments: how one is made with other numbers, and what it says about itself.

A number of an environment is a keyword of its constructor (``g`` of Pendulum) or a public attribute (``m`` and ``l``).
An attribute is set after the constructor has run. Then the constructor's assignments that read it run again, such as
``self.total_mass = self.masspole + self.masscart``. Other uses of it in a constructor keep the nominal number.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import sys
import textwrap
import warnings
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import CodeType
from typing import Any

from s2r_spec.backend import read_code
from s2r_spec.errors import UsageError, not_installed, one_of, suggest

Value = float | int | bool | str
_PICTURE = ("screen", "render", "camera", "viewer")
"""Definition: beginnings of the names of numbers that only change a picture."""
_STEP = ("dt", "tau")
"""Definition: attributes with the time step [s]."""
_LIMIT = "max_episode_steps"
"""Definition: keyword of ``gymnasium.make`` with the number of steps after which an episode is truncated."""


@dataclass(frozen=True)
class Facts:
    """What an environment says about itself.

    Attributes:
        name: its name without namespace and version ("Pendulum").
        step: its time step [s]; None if it does not say.
        limit: number of steps after which it truncates an episode; None if it does not.
        settings: every keyword and attribute that can be set, with its value.
        observation: its space of observations.
        action: its space of actions.
        digest: hash of its source when it was loaded; see :func:`_digest`.
    """

    name: str
    step: float | None
    limit: int | None
    settings: Mapping[str, Value]
    observation: Any
    action: Any
    digest: str

    @property
    def numbers(self) -> dict[str, float]:
        """Every number that a test may change."""
        return {
            name: float(value)
            for name, value in self.settings.items()
            if not isinstance(value, bool | str) and name != _LIMIT
        }


@cache
def facts(identifier: str, options: tuple[tuple[str, str], ...] = ()) -> Facts:
    """Return what an environment with these options says about itself.

    Raises:
        UsageError: there is no such environment, or it cannot be made with them.
    """
    environment = make(identifier, dict(options))
    own = environment.unwrapped
    spec = environment.spec
    limit = spec.max_episode_steps if spec is not None else None
    keywords = _keyword_defaults(identifier)
    settings: dict[str, Value] = {name: getattr(own, name) for name in _attributes(own)}
    settings |= {name: _read(name, dict(options).get(name, value), value) for name, value in keywords.items()}
    found = Facts(
        "" if spec is None or spec.namespace else spec.name,
        time_step(environment),
        limit,
        settings,
        environment.observation_space,
        environment.action_space,
        _digest(type(own)),
    )
    environment.close()
    return found


def _digest(environment: type) -> str:
    """Return the hash of the module of an environment, with those of its own folder that it imports.

    Of Gymnasium's own environments it is the hash of their module, since the version of Gymnasium decides the rest.
    """
    module = environment.__module__
    if not module.startswith("gymnasium."):
        with suppress(UsageError):  # for instance an environment that a notebook defines
            return read_code(f"{module}:{environment.__name__}")[0]
    source = Path(getattr(sys.modules.get(module), "__file__", None) or "")
    return sha256(source.read_bytes()).hexdigest() if source.is_file() else ""


def make(identifier: str, settings: Mapping[str, Value]) -> Any:
    """Return a new environment with these keywords and attributes; a text is read as the kind of value it replaces.

    Raises:
        UsageError: there is no such environment, it has no such number, or it cannot be made.
    """
    keywords = _keyword_defaults(identifier)
    given: dict[str, Any] = {
        name: _read(name, value, keywords[name]) for name, value in settings.items() if name in keywords
    }
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an older version, at every rollout
            import gymnasium

            environment = gymnasium.make(identifier, disable_env_checker=True, **given)
    except Exception as error:
        raise UsageError(_sentence(identifier, error)) from None
    own, names = environment.unwrapped, [name for name in settings if name not in keywords]
    known = {*_attributes(own)}
    for name in names:
        if name not in known:
            every = known | {*keywords}
            raise UsageError(
                f"the environment {identifier} has no number {name!r}{suggest(name, every)} it has {one_of(every)}"
            )
        setattr(own, name, _read(name, settings[name], getattr(own, name)))
    _assign_again(own, names)
    return environment


def time_step(environment: Any) -> float | None:
    """Return the time of a step [s] that an environment states; None if it states none."""
    stated = (getattr(environment.unwrapped, name, None) for name in _STEP)
    return next((float(value) for value in stated if isinstance(value, float | int)), None)


@cache
def _keyword_defaults(identifier: str) -> dict[str, Value]:
    """Return the keywords that ``gymnasium.make`` takes for an environment, with their values."""
    import gymnasium
    from gymnasium.envs.registration import load_env_creator

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            module, colon, _ = identifier.partition(":")
            if colon:
                __import__(module)
            spec = gymnasium.spec(identifier.rpartition(":")[2])
            entry = spec.entry_point
            creator: Any = load_env_creator(entry) if isinstance(entry, str) else entry
    except gymnasium.error.UnregisteredEnv:
        raise UsageError(
            f"gymnasium has no environment {identifier!r}{suggest(identifier, gymnasium.registry)} "
            f"`python -c 'import gymnasium; gymnasium.pprint_registry()'` lists them"
        ) from None
    except Exception as error:
        raise UsageError(_sentence(identifier, error)) from None
    found = {
        name: spec.kwargs.get(name, one.default)
        for name, one in inspect.signature(creator).parameters.items()
        if name != "render_mode"
    }
    return {name: value for name, value in found.items() if isinstance(value, float | int | str)} | {
        _LIMIT: spec.max_episode_steps or 0
    }


def _sentence(identifier: str, error: Exception) -> str:
    """Return why an environment cannot be made, in one line, with the remedy for a missing package."""
    if isinstance(error, ModuleNotFoundError) and error.name:
        return not_installed(f"the environment {identifier} needs", error.name.partition(".")[0], None)
    return f"gymnasium cannot make {identifier}: {' '.join(str(error).split()) or type(error).__name__}"


def _attributes(own: Any) -> Iterator[str]:
    """Yield the names of public numbers that are no part of a picture, and not the time step."""
    for name in dir(own):
        if name.startswith(("_", *_PICTURE)) or name in _STEP:
            continue
        if _is_number(inspect.getattr_static(own, name, None)):
            yield name


def _is_number(value: object) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool)


def _read(name: str, value: Value, nominal: Value) -> Value:
    """Return a value as the kind of the nominal one."""
    if isinstance(nominal, bool):
        words = {"true": True, "false": False, "1": True, "0": False}
        if str(value).lower() not in words:
            raise UsageError(f"{name} = {value!r} must be true or false")
        return words[str(value).lower()]
    if isinstance(nominal, str):
        return str(value)
    try:
        number = float(value)
    except ValueError:
        raise UsageError(f"{name} = {value!r} is not a number, such as {nominal:g}") from None
    return int(number) if isinstance(nominal, int) and number.is_integer() else number


def _assign_again(own: Any, names: Collection[str]) -> None:
    """Run the assignments ``self.a = …`` of the constructor that read one of these attributes, in their order."""
    changed = {*names}
    constructor = type(own).__init__
    for name, reads, code in _assignments(constructor) if names else ():
        if name not in names and reads & changed:
            exec(code, constructor.__globals__, {"self": own})
            changed.add(name)


@cache
def _assignments(constructor: Any) -> tuple[tuple[str, frozenset[str], CodeType], ...]:
    """Return the assignments of a constructor that use attributes and global names alone.

    Each has the name of its attribute, the names of the attributes that it reads, and its code.
    """
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(constructor))).body[0]
    except (OSError, TypeError, SyntaxError):
        return ()
    found = []
    outside = {*constructor.__globals__, *dir(builtins)} - {*constructor.__code__.co_varnames} | {"self"}
    for node in tree.body if isinstance(tree, ast.FunctionDef) else ():
        match node:
            case ast.Assign(targets=[ast.Attribute(value=ast.Name(id="self"), attr=name)]):
                reads = {one.attr for one in ast.walk(node.value) if isinstance(one, ast.Attribute)}
                if {one.id for one in ast.walk(node.value) if isinstance(one, ast.Name)} <= outside:
                    code = compile(ast.Module([node], []), constructor.__code__.co_filename, "exec")
                    found.append((name, frozenset(reads), code))
    return tuple(found)
