"""The objects of the commands that read finished runs: ``s2r replay``, ``s2r choose`` and ``s2r odds``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from s2r_spec.base.json_types import Count, Magnitude, Probability
from s2r_spec.base.json_values import Point, Shown
from s2r_spec.certify.result.failure_probability import FailureProbability


@dataclass(frozen=True, kw_only=True)
class ReplayObject:
    """The result of ``s2r replay``.

    Attributes:
        rollout: the name of the rollout, as given.
        params: the test.
        seed: the seed of the rollout.
        rho: robustness of the repeated rollout.
        recorded_rho: robustness in the journal.
        same: whether the two are equal, bit for bit.
    """

    schema: Literal["s2r.replay/1"] = "s2r.replay/1"
    rollout: str
    params: Point
    seed: Count
    rho: float
    recorded_rho: float
    same: bool


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A checked controller.

    Attributes:
        backend: the name of the backend.
        folder: the folder of the rollouts.
        lower: lower bound on its worst expected robustness.
        upper: upper bound on its worst expected robustness.
        rollouts: the number of rollouts.
        refused: the reason why its certificate was refused; null if it was not.
    """

    backend: str
    folder: str
    lower: float
    upper: float
    rollouts: Count
    refused: str | None


@dataclass(frozen=True, kw_only=True)
class ChoiceObject:
    """The result of ``s2r choose``.

    Attributes:
        requirement: the name of the requirement.
        best: the backend with the largest certified worst case; null if every certificate was refused.
        delta: 1 − probability that all statements hold.
        regret: the largest amount by which another candidate can be better; null if there is no best candidate.
        candidates: the candidates, in the order of the folders.
    """

    schema: Literal["s2r.choice/1"] = "s2r.choice/1"
    requirement: str
    best: str | None
    delta: Probability
    regret: Magnitude | None
    candidates: tuple[Candidate, ...]


@dataclass(frozen=True, kw_only=True)
class RequirementOdds(Shown):
    """Bounds on the probability that ρ of a requirement falls below levels.

    Attributes:
        delta: 1 − probability that all bounds hold.
        levels: one bound for each level.
        requirement: its name.
        unit: the unit of ρ.
        B: bound on the RKHS norm of each probability as a function of the test.
    """

    requirement: str
    unit: str
    B: float
    delta: Probability
    levels: tuple[FailureProbability, ...]

    JSON = "delta levels"


@dataclass(frozen=True, kw_only=True)
class OddsObject:
    """The result of ``s2r odds``.

    Attributes:
        results: requirement → its bounds.
    """

    schema: Literal["s2r.odds/1"] = "s2r.odds/1"
    results: dict[str, RequirementOdds]
