"""The objects of ``s2r check``, ``s2r gap``, ``s2r certify`` and ``s2r report``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import MinLen

from s2r_spec.base.json_types import Location
from s2r_spec.base.json_values import ExitCode, Shown
from s2r_spec.certify.real_machine import CertifyResult
from s2r_spec.certify.result.check_result import CheckResult
from s2r_spec.certify.result.gap_result import GapResult


@dataclass(frozen=True, kw_only=True)
class CheckObject:
    """The result of ``s2r check``.

    Attributes:
        exit_code: 0 holds, 1 violated, 3 unknown; the worst over all requirements.
        results: the results, in the order of the requirements.
        locations: requirement → its place in the files.
    """

    schema: Literal["s2r.check/1"] = "s2r.check/1"
    exit_code: ExitCode
    results: Annotated[tuple[CheckResult, ...], MinLen(1)]
    locations: dict[str, Location]


@dataclass(frozen=True, kw_only=True)
class GapObject(Shown):
    """The result of ``s2r gap``.

    Attributes:
        exit_code: 0 if the interval is at most as wide as the target, else 3.
        location: the place of the requirement in the files.
    """

    schema: Literal["s2r.gap/1"] = "s2r.gap/1"
    exit_code: ExitCode
    result: GapResult
    location: Location

    JSON = "schema exit_code *result location"


@dataclass(frozen=True, kw_only=True)
class CertifyObject(Shown):
    """The result of ``s2r certify``.

    Attributes:
        exit_code: 0 holds, 1 violated, 3 unknown.
        location: the place of the requirement in the files.
    """

    schema: Literal["s2r.certify/1"] = "s2r.certify/1"
    exit_code: ExitCode
    result: CertifyResult
    location: Location

    JSON = "schema exit_code *result location"
