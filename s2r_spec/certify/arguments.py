"""Arguments of Python callers: each is checked before anything runs, and a wrong one gets one sentence."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from s2r_spec.backend import Backend, fault
from s2r_spec.base.errors import UsageError
from s2r_spec.runs.journal import Journal
from s2r_spec.spec import Spec


def as_spec(spec: Any) -> Spec:
    """Return the specification.

    Raises:
        UsageError: it is a path, a text or another value.
    """
    if isinstance(spec, Spec):
        return spec
    what = f"{spec!r}" if isinstance(spec, str | Path) else _kind(spec)
    raise UsageError(f"a specification is needed, not {what}; s2r.load_spec reads one from a file")


def as_backend(backend: Any, what: str = "backend") -> Backend | str:
    """Return a backend, or the name of one.

    Raises:
        UsageError: it is another value, or breaks the protocol of a backend.
    """
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
    """Return a simulator or its name.

    Raises:
        UsageError: it is neither.
    """
    if isinstance(backend, str | Backend):
        return backend
    raise UsageError(f"sim must be a backend or the name of one, such as 'sim', not {_kind(backend)}")


def as_rollouts(real: Any) -> Any:
    """Return the real machine of a diagnosis: a backend, the name of one, or rollouts.

    Raises:
        UsageError: it is another value.
    """
    if isinstance(real, str | Backend | Iterable):
        return real
    raise UsageError(
        f"real must be a backend, the name of one, such as 'log:night', or (test, trace) of each rollout, not "
        f"{_kind(real)}"
    )


def as_folder(folder: Any) -> Path:
    """Return the folder of a run as a path.

    Raises:
        UsageError: it is not a path.
    """
    if isinstance(folder, str | os.PathLike) and isinstance(os.fspath(folder), str):
        return Path(folder)
    raise UsageError(f"folder must be a path, such as 'runs/night', not {_kind(folder)}")


def require_begun(places: list[Path], run: Path) -> None:
    """Refuse to resume a run that was never begun.

    Args:
        places: folders that could hold its journals.
        run: the folder of the run.

    Raises:
        UsageError: none of them holds one.
    """
    if not any(map(Journal.exists, places)):
        looked = ", ".join(map(str, places))
        raise UsageError(
            f"no run to resume in {run}: there is no journal in {looked}; begin one without resume"
        )


def _kind(value: Any) -> str:
    return "None" if value is None else f"a value of type {type(value).__name__}"
