"""What a diagnosis found, in the words of a backend's own files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from s2r_spec.backend.capabilities import Finding
from s2r_spec.backend.loop import LoopMistake


@runtime_checkable
class WritesFound(Protocol):
    """A backend that was put together from a user's files, and can write what was found into copies of them."""

    def write_found(
        self,
        values: Mapping[str, Mapping[str, float]],
        folder: Path,
        mistakes: Sequence[LoopMistake] = (),
    ) -> list[Finding]:
        """Write the machine as found, and a deploy file with the fault undone, to a new folder; return what each is.

        Args:
            values: effect → parameter → value.
            folder: new.
            mistakes: of the machine's loop, as :meth:`.HasLoop.with_mistakes` takes them.

        Raises:
            UsageError: the folder is there already, or cannot be written.
        """
