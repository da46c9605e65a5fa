"""The certificate of a search: an interval, its probability, and its assumptions."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Any

from annotated_types import MinLen

from s2r_spec.base.json_values import to_json

ALL_COUNT = "every requested rollout is counted"
"""Definition: an assumption about the rollouts; a machine's rollouts may be void, and then run again."""


class Label(Enum):
    """Status of a certificate; the value is the printed text."""

    CERTIFIED = "certified under the stated assumptions"
    DECIDED = "decided (valid interval)"
    BUDGET = "budget exhausted (valid interval)"
    ONE_SIDED = "one-sided (only the upper end holds, for every B)"
    REFUSED = "refused"
    MODEL_BASED = "model-based (not certified)"
    RUNNING = "running (valid interval)"

    @property
    def bounds(self) -> bool:
        """Whether both ends of the interval hold under the stated assumptions."""
        return self.certifies and self is not Label.ONE_SIDED

    @property
    def certifies(self) -> bool:
        """Whether at least one end of the interval holds under the stated assumptions."""
        return self not in (Label.REFUSED, Label.MODEL_BASED)


@dataclass(frozen=True)
class Rung:
    """The interval that holds if the RKHS norm is at most ``B``; every rung shares the one δ."""

    B: float
    lower: float
    upper: float
    discretisation: float


@dataclass(frozen=True)
class Certificate:
    """P(lower ≤ J* ≤ upper) ≥ 1 − δ, where J* = max over the box of the expected outcome.

    With the label ``ONE_SIDED`` only P(lower ≤ J*) ≥ 1 − δ holds, and no B is assumed.

    Attributes:
        lower: largest lower confidence bound at a point.
        upper: J^e, the upper confidence bound of the maximum over the whole box.
        delta: 1 − probability.
        target: the declared ε.
        label: see :class:`Label`.
        reason: the reason why the interval is refused, else "".
        worst: the point of the largest lower confidence bound.
        rollouts: number of outcomes.
        iterations: number of batches.
        points: number of distinct test points.
        discretisation: B e(h), contained in ``upper``.
        ladder: the interval for B, 2B, 4B, 8B.
        B_low: the smallest RKHS norm compatible with the data.
        log_e_value: natural logarithm of the e-value against R.
        assumptions: each in one sentence; the certificate means nothing without them.
        settings: the declaration, made before the data.
        epsilon: the achieved ε: upper − lower.
    """

    lower: float
    upper: float
    delta: float
    target: float
    label: Label
    reason: str
    worst: dict[str, float]
    rollouts: int
    iterations: int
    points: int
    discretisation: float
    ladder: Annotated[tuple[Rung, ...], MinLen(1)]
    B_low: float
    log_e_value: float
    assumptions: tuple[str, ...]
    settings: dict[str, Any]
    epsilon: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "epsilon", self.upper - self.lower)

    def to_json(self) -> dict[str, Any]:
        """Return the certificate as plain JSON values."""
        return dict(to_json(self))
