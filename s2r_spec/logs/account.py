"""The account of a signal's messages: what became of each between the file and the trace.

Identity: messages = samples + merged + dropped, for tables and topics alike. A requirement adds its own part: messages
before its begin, or after its end, are not evaluated (:mod:`s2r_spec.robustness.judge`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Account:
    """What became of the messages of a signal.

    Args:
        messages: messages of its topic, or rows of its table, in the file.
        samples: samples of the trace.
        merged: messages with the stamp and the value of another one.
        dropped: reason → messages that were left out.
        resorted: samples that stand in the file after a later one.
    """

    messages: int
    samples: int
    merged: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    resorted: int = 0
