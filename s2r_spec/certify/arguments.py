"""Arguments of Python callers: each is checked before anything runs, and a wrong one gets one sentence."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, TypeVar

from s2r_spec.backend import Backend, fault
from s2r_spec.base.errors import UsageError, one_of, suggest
from s2r_spec.spec import Spec, load_spec

_Options = TypeVar("_Options")


def as_spec(spec: Any) -> Spec:
    """Return the specification, or that of a file; refuse a text or another value with a UsageError."""
    if isinstance(spec, Spec):
        return spec
    if isinstance(spec, str) and "\n" in spec:
        raise UsageError("a specification is needed, not a text of several lines; s2r.parse_spec reads one")
    if isinstance(spec, str | os.PathLike):
        return load_spec(Path(os.fspath(spec)))
    raise UsageError(f"a specification is needed, not {_kind(spec)}; s2r.load_spec reads one from a file")


def options_from(kind: Callable[..., _Options], keywords: Mapping[str, Any]) -> _Options:
    """Return the options of a run, a dataclass, from some of its fields; a UsageError refuses a wrong set of them."""
    known = {one.name: one for one in fields(kind) if one.init}  # type: ignore[arg-type]
    for name in keywords:
        if name not in known:
            raise UsageError(
                f"there is no keyword {name!r}{suggest(name, known)} the keywords are {one_of(known)}"
            )
    for name, one in known.items():
        if one.default is MISSING and one.default_factory is MISSING and name not in keywords:
            raise UsageError(f"the keyword {name!r} is needed")
    return kind(**keywords)


def as_backend(backend: Any, what: str = "backend") -> Backend | str:
    """Return a backend or the name of one; refuse another value, or a broken protocol, with a UsageError."""
    if isinstance(backend, str):
        return backend
    if isinstance(backend, type):
        raise UsageError(
            f"{what} is the class {backend.__name__}; give an object, such as {backend.__name__}()"
        )
    if not hasattr(backend, "rollout"):
        remedy = "; wrap the function as s2r.FunctionBackend(f)" if callable(backend) else ""
        raise UsageError(
            f"{what} must be a backend or the name of an installed one, such as 'sim', not {_kind(backend)}{remedy}"
        )
    if words := fault(backend):
        raise UsageError(f"{what} ({type(backend).__name__}) {words}")
    checked: Backend = backend
    return checked


def as_simulator(backend: Any) -> Backend | str:
    """Return a simulator or its name; refuse another value with a UsageError."""
    if isinstance(backend, str | Backend):
        return backend
    raise UsageError(f"sim must be a backend or the name of one, such as 'sim', not {_kind(backend)}")


def as_rollouts(real: Any) -> Any:
    """Return the real machine of a diagnosis: a backend, its name, or rollouts; refuse others with a UsageError."""
    if isinstance(real, str | Backend | Iterable):
        return real
    raise UsageError(
        f"real must be a backend, the name of one, such as 'log:night', or (test, trace) of each rollout, not "
        f"{_kind(real)}"
    )


def as_folder(folder: Any) -> Path:
    """Return the folder of a run as a path; refuse another value with a UsageError."""
    if isinstance(folder, str | os.PathLike) and isinstance(os.fspath(folder), str):
        return Path(folder)
    raise UsageError(f"folder must be a path, such as 'runs/night', not {_kind(folder)}")


def name_of(backend: Backend | str) -> str:
    """Return the name of a backend for the name of a folder."""
    return backend if isinstance(backend, str) else backend.name


def _kind(value: Any) -> str:
    return "None" if value is None else f"a value of type {type(value).__name__}"
