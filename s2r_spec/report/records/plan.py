"""The objects of ``s2r plan``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from s2r_spec.certify.search.pilot import Pilot
from s2r_spec.certify.search.plan import Plan


@dataclass(frozen=True, kw_only=True)
class PilotObject:
    """The result of ``s2r plan --pilot`` without settings.

    Attributes:
        schema: name and version of this object.
        pilot: the judgement of R from the pilot run.
    """

    schema: Literal["s2r.plan/1"] = "s2r.plan/1"
    pilot: Pilot


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
    pilot: Pilot | None


@dataclass(frozen=True)
class PlanObject(_Cost, Plan, _Settings):
    """The result of ``s2r plan``.

    Attributes:
        schema: name and version of this object.
        R: sub-Gaussian proxy of one rollout's noise.
        epsilon: target width of the interval.
        delta: 1 − probability.
        B: bound on the RKHS norm.
        seconds_per_rollout: time of a rollout with all cores of this computer [s]; null without a backend.
        pilot: the judgement of R from the pilot run; null without a pilot.
    """
