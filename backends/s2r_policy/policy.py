"""Trained policies as functions of an observation, opened without running anything that a file could bring along."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from s2r_spec.errors import UsageError

FloatArray32 = NDArray[np.float32]


class Policy(Protocol):
    """A trained policy: a function of an observation, and perhaps of a state of its own.

    Attributes:
        width: numbers in an observation; None if the file does not say.
        outputs: numbers in an action; None if the file does not say.
        recurrent: whether it has a state besides its weights.
        metadata: custom metadata of an ONNX file; empty for other files.
        files: every file that determines the actions, for hashes.
        digest: hash of these files and of the version of the library that runs them.
        notes: sentences about parts of the file that are not used.
    """

    @property
    def width(self) -> int | None: ...  # noqa: D102
    @property
    def outputs(self) -> int | None: ...  # noqa: D102
    @property
    def recurrent(self) -> bool: ...  # noqa: D102
    @property
    def metadata(self) -> Mapping[str, str]: ...  # noqa: D102
    @property
    def files(self) -> tuple[Path, ...]: ...  # noqa: D102
    @property
    def digest(self) -> str: ...  # noqa: D102
    @property
    def notes(self) -> tuple[str, ...]: ...  # noqa: D102

    def reset(self) -> None:
        """Set the state to its value in the file, or to zeros; called at t = 0 of every rollout."""

    def __call__(self, observation: FloatArray32) -> FloatArray32:
        """Return the action (outputs,) for an observation (width,), as a new array; it may be NaN or infinite.

        Raises:
            UsageError: the observation has another width, or the file cannot be evaluated.
        """


def digest(files: Iterable[Path], library: str) -> str:
    """Return the hash of the contents of files, in order, and of the name and version of a library."""
    total = sha256(library.encode())
    for path in files:
        with path.open("rb") as file:
            total.update(file_digest(file, "sha256").digest())
    return total.hexdigest()


def refuse_width(path: Path, width: int | None, observation: FloatArray32) -> None:
    """Refuse an observation that is not a vector of the policy's width.

    Raises:
        UsageError: its shape is another.
    """
    if observation.ndim != 1 or width not in (None, observation.size):
        wanted = "a vector" if width is None else f"{width} numbers"
        raise UsageError(
            f"{path}: the policy takes {wanted}, but the observation has shape {observation.shape}"
        )
