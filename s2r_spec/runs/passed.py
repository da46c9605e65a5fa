"""Backends that a caller passes as objects, instead of names of installed ones."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any

from s2r_spec.backend import Backend
from s2r_spec.backend.files import pack, unpack
from s2r_spec.base.errors import BackendError

_MAIN = b"__main__"
"""Definition: module of a class of a notebook or a script, as its pickle names it. A worker process has another one."""


class PassedBackend:
    """A backend object on its way to the rollouts: the object itself in this process, a copy in another."""

    def __init__(self, backend: Backend) -> None:
        self.backend = backend
        _ = self._pickled  # before a rollout leaves anything in the object

    @property
    def portable(self) -> bool:
        """Whether another process on this computer can have a copy."""
        return not self._pickled[1]

    @cached_property
    def _pickled(self) -> tuple[bytes, str]:
        """The pickled object, and why another process cannot read it ("" if it can)."""
        try:
            data = pack(self.backend)
        except Exception as error:  # third-party code may raise anything
            return b"", f"{type(error).__name__}: {error}"
        return data, "its code is in the notebook or script that runs now" if _MAIN in data else ""

    def __reduce__(self) -> tuple[Any, ...]:
        data, fault = self._pickled
        if fault:
            raise BackendError(
                f"the backend {self.backend.name!r} cannot go to a worker process, because {fault}; move its "
                f"code to a module, or run it here, without executor"
            )
        return _copy, (data,)


@lru_cache(maxsize=8)
def _copy(data: bytes) -> PassedBackend:
    """Return the same copy for all rollouts of a worker process; its own copies are as it was."""
    copy = PassedBackend.__new__(PassedBackend)
    copy.backend = unpack(data)
    copy.__dict__["_pickled"] = data, ""
    return copy
