"""The objects of ``s2r plan`` and ``s2r pilot``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from s2r_spec.base.json_values import Shown
from s2r_spec.certify.pilot.run import PilotResult
from s2r_spec.certify.search.plan import Plan


@dataclass(frozen=True, kw_only=True)
class PilotObject(Shown):
    """The result of ``s2r pilot``.

    Attributes:
        written: the specification into which the line was put; null without ``--write``.
    """

    schema: Literal["s2r.pilot/1"] = "s2r.pilot/1"
    result: PilotResult
    written: str | None

    JSON = "schema *result written"


@dataclass(frozen=True, kw_only=True)
class _Settings:
    schema: Literal["s2r.plan/1"] = "s2r.plan/1"
    R: float
    epsilon: float
    delta: float
    B: float


@dataclass(frozen=True, kw_only=True)
class _Cost:
    seconds_per_rollout: float | None


@dataclass(frozen=True)
class PlanObject(_Cost, Plan, _Settings):
    """The result of ``s2r plan``.

    Attributes:
        R: sub-Gaussian proxy of one rollout's noise.
        epsilon: target width of the interval.
        delta: 1 − probability.
        B: bound on the RKHS norm.
        seconds_per_rollout: time of a rollout with all cores of this computer [s]; null without a backend.
    """
