"""How topics come to one clock, while each keeps its messages.

Data: topics i with stamps t_i1 < t_i2 < … and values y_ik, all of one clock. In a trace of them, a channel has a value
at every instant. By the rule, between two messages:

    hold     the value of the last message, as a controller sees a topic
    linear   on the line between both, up to the last message; whole numbers, truth values and commands are held

A command steps, so that fields of test parameters and of a condition are held under either rule.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from s2r_spec.logs.table import Column
from s2r_spec.logs.topics.topic import Stamps
from s2r_spec.trace.samples import Rule

RULES: tuple[Rule, ...] = get_args(Rule)


@dataclass(frozen=True)
class Joining:
    """How topics come to common instants.

    Args:
        clock: name of the topic at whose stamps requirements are evaluated; None for every instant.
        rule: values of a topic between its messages: "hold" or "linear".
        stamps: which stamps of a message count; None for those of the headers if all topics have one, else the
            times of receipt.
        held: fields that are held whatever the rule, by their names in the log.
    """

    clock: str | None = None
    rule: Rule = "hold"
    stamps: Stamps | None = None
    held: frozenset[str] = frozenset()

    @classmethod
    def of_options(cls, clock: str | None, rule: Rule | None, stamps: Stamps | None) -> Joining | None:
        """Return what a user chooses; None without a choice."""
        chooses = any(one is not None for one in (clock, rule, stamps))
        return cls(clock, rule or "hold", stamps) if chooses else None

    def interpolates(self, topic: str, name: str, column: Column) -> bool:
        """Return whether a field of a topic is linear between messages."""
        path = name if topic in ("", name) else f"{topic}.{name}"
        numeric = not column.fault and column.missing is None and column.values.dtype.kind == "f"
        stated = bool({path, path.rpartition("[")[0]} & self.held)
        return self.rule == "linear" and numeric and not stated and not is_whole(column.values)


def is_whole(values: NDArray[Any]) -> bool:
    """Return whether all values are whole numbers, as states and counts are."""
    return bool((values == np.rint(values)).all())
