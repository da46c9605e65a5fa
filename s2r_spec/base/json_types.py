"""Types of numbers with their ranges, as the JSON Schemas of records state them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Interval

Count = Annotated[int, Ge(0)]
Magnitude = Annotated[float, Ge(0)]
Probability = Annotated[float, Interval(ge=0, le=1)]
Level = Annotated[float, Interval(gt=0, lt=1)]
"""A probability that is neither impossible nor sure, such as δ."""
Failures = dict[str, Annotated[int, Ge(1)]]
"""Word for a failure → number of rollouts that ended with it."""


@dataclass(frozen=True, kw_only=True)
class Location:
    """The place of a requirement in the files.

    Attributes:
        file: the specification.
        line: counted from 1.
    """

    file: str
    line: Annotated[int, Ge(1)]
