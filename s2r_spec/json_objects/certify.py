"""The object of ``s2r certify``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from s2r_spec.certify.compose import Composition
from s2r_spec.json_objects.check import CheckedRequirement
from s2r_spec.json_objects.gap import BoundedGap
from s2r_spec.json_values import ExitCode, Location
from s2r_spec.verdict import Verdict


@dataclass(frozen=True, kw_only=True)
class CertifyObject:
    """The result of ``s2r certify``.

    Attributes:
        schema: name and version of this object.
        exit_code: 0 holds, 1 violated, 3 unknown.
        verdict: holds, violated or unknown.
        reason: one sentence for the verdict.
        real: the backend of the real machine, which the bounds cover.
        promise: the bounds on the worst expected robustness of the real machine; null if there are none.
        simulation: the check of the simulator.
        gap: the gap between the two; null if the simulation was refused.
        location: the place of the requirement in the files.
    """

    schema: Literal["s2r.certify/1"] = "s2r.certify/1"
    exit_code: ExitCode
    verdict: Verdict
    reason: str
    real: str
    promise: Composition | None
    simulation: CheckedRequirement
    gap: BoundedGap | None
    location: Location
