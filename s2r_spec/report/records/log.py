"""The object of ``s2r log``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from s2r_spec.logs.summary import TopicSummary


@dataclass(frozen=True, kw_only=True)
class LogObject:
    """The result of ``s2r log``.

    Attributes:
        log: the file.
        topics: its topics; a table is one topic without a name.
        notes: on the file, a sentence each.
    """

    schema: Literal["s2r.log/1"] = "s2r.log/1"
    log: str
    topics: tuple[TopicSummary, ...]
    notes: tuple[str, ...]
