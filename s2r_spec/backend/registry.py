"""Backends by name: the installed ones, which packages offer in the entry-point group ``s2r.backends``, and files.

A package opens files by their ending in the group ``s2r.files``. A Python file needs no package.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from s2r_spec.backend.capabilities import Backend, HasOptions, Option
from s2r_spec.backend.files import names_code
from s2r_spec.backend.model import Channel, Parameter
from s2r_spec.base.distribution import BACKENDS, FILES
from s2r_spec.base.errors import (
    BackendError,
    MissingPackageError,
    S2RError,
    UnknownBackendError,
    UsageError,
    one_of,
)


def installed() -> dict[str, EntryPoint]:
    """Return name → entry point of every installed backend, without any import of them."""
    return _points(BACKENDS, "offer a backend named")


def endings() -> dict[str, EntryPoint]:
    """Return ending → entry point of the files that installed packages open as backends, without any import."""
    return _points(FILES, "open files that end with")


def _points(group: str, offer: str) -> dict[str, EntryPoint]:
    points: dict[str, EntryPoint] = {}
    for point in entry_points(group=group):
        if point.name in points and point.value != points[point.name].value:
            raise BackendError(
                f"two installed packages {offer} {point.name!r}: "
                f"{points[point.name].value} and {point.value}; uninstall one of them"
            )
        points[point.name] = point
    return dict(sorted(points.items()))


@cache
def _factory(name: str) -> Any:
    points = installed()
    if name not in points:
        raise UnknownBackendError(name, points)
    return _load(points[name], name)


def _load(point: EntryPoint, name: str) -> Any:
    try:
        return point.load()
    except ModuleNotFoundError as error:
        raise MissingPackageError(name, error.name or str(error)) from error


def short(model_hash: str) -> str:
    """Return at most twelve digits of a model hash, for people; a hash with other characters is hashed first."""
    if len(model_hash) > 12 and not re.fullmatch("[0-9a-f]+", model_hash):
        model_hash = sha256(model_hash.encode()).hexdigest()
    return model_hash[:12]


def load_backend(name: str) -> Backend:
    """Make the backend called ``name``: an installed one, or that of a file; options may follow a colon.

    ``load_backend("sim")`` calls the class of the entry point ``sim`` without arguments, and
    ``load_backend("twin:lab")`` calls ``twin`` with ``"lab"``. If no backend of the name before the colon is installed,
    the name may be ``PATH.py:NAME[:OPTIONS]``, ``module:NAME[:OPTIONS]`` or a file with an ending that a package opens.

    Raises:
        UnknownBackendError: no installed package offers it, and it is no file; the message lists the installed ones.
        UsageError: a file or its code is missing or wrong.
        MissingPackageError: the backend imports a package that is not installed.
        BackendError: the entry point raised an error, or its result is not a backend.
    """
    factory, arguments = _find(name)
    try:
        backend = factory(*arguments)
        if arguments and hasattr(backend, "chosen"):
            backend.chosen()  # a class without options stores them in its first field, and fails much later
    except S2RError:
        raise
    except Exception as error:
        raise BackendError(f"backend {name!r} cannot be opened: {type(error).__name__}: {error}") from error
    if words := fault(backend):
        raise BackendError(f"backend {name!r} ({type(backend).__name__}) {words}")
    opened: Backend = backend
    return opened


def _find(name: str) -> tuple[Any, tuple[str, ...]]:
    """Return the factory of a backend, and its arguments."""
    kind, colon, argument = name.partition(":")
    try:
        return _factory(kind), (argument,) * bool(colon)
    except UnknownBackendError:
        points = endings()
        match = re.fullmatch(r"(?s)((?:[A-Za-z]:[\\/])?[^:]*\.(\w+))(?::.*)?", name)
        if match and match[2] in points:
            if not Path(match[1]).is_file():
                raise UsageError(
                    f"no file {match[1]} in {Path.cwd()}; give its path, or start s2r in its folder"
                ) from None
            return _load(points[match[2]], match[1]), (name,)
        if names_code(name):
            from s2r_spec.backend.from_code import open_code

            return open_code, (name,)
        if match and Path(match[1]).is_file():
            raise UsageError(
                f"no installed package opens {match[1]} as a backend; the endings are {one_of({*points, 'py'})}"
            ) from None
        raise


def file_opener(path: Path) -> Any:
    """Return what a package offers for files with the ending of this path: a factory of backends.

    Raises:
        UsageError: no installed package opens such files.
        MissingPackageError: it imports a package that is not installed.
    """
    points = endings()
    ending = path.suffix.removeprefix(".")
    if ending not in points:
        raise UsageError(f"{path}: no installed package opens such a file; the endings are {one_of(points)}")
    return _load(points[ending], str(path))


def described(name: str) -> tuple[Backend, tuple[Option, ...]]:
    """Return a backend to describe, and its options; it gets its example's options if required ones are missing.

    Raises:
        BackendError: as :func:`load_backend`.
    """
    factory, arguments = _find(name)
    if not isinstance(factory, HasOptions):
        return load_backend(name), ()
    return load_backend(name if arguments else f"{name}:{factory.example}"), factory.offered


def fault(backend: object) -> str:
    """Return how an object breaks the protocol :class:`Backend`, as words after its name; "" if it keeps it."""
    lacking = [word for word in _REQUIRED if not hasattr(backend, word)]
    if lacking:
        return f"lacks {', '.join(lacking)} of the protocol Backend"
    assert isinstance(backend, Backend)
    try:
        signature = inspect.signature(backend.rollout)
    except (TypeError, ValueError):  # not a function; or one of a library, which does not tell
        return "" if callable(backend.rollout) else "has a rollout that is not a method"
    try:
        signature.bind({}, 0)
    except TypeError:
        return f"has rollout{signature}, but it is called with a test and a seed: rollout(params, seed)"
    for word, kind in (("channels", Channel), ("parameters", Parameter)):
        declared = getattr(backend, word)
        if isinstance(declared, str | Mapping) or not all(isinstance(one, kind) for one in declared):
            return f"has {word} = {declared!r}; they must be a tuple of s2r.{kind.__name__}"
    return ""


_REQUIRED = ("name", "channels", "parameters", "deterministic", "duration", "cost", "model_hash", "rollout")
