"""The object of every command that has no result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import MinLen

from s2r_spec.base.errors import ErrorCode


@dataclass(frozen=True, kw_only=True)
class ErrorObject:
    """The reason why a command has no result.

    Attributes:
        exit_code: 2 usage or specification, 4 backend or internal, 130 a machine's operator stopped the run.
        error: the error in one sentence; below it, the mistakes of a specification with their places.
    """

    schema: Literal["s2r.error/1"] = "s2r.error/1"
    exit_code: ErrorCode
    error: Annotated[str, MinLen(1)]
