"""What the result of a check and that of a gap have in common."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired

from annotated_types import MinLen

from s2r_spec.base.json_types import Count, Failures, Magnitude
from s2r_spec.base.json_values import DIGITS, OPTIONAL, Open, Shown
from s2r_spec.base.result import Result
from s2r_spec.certify.bound.certificate import Certificate
from s2r_spec.spec import Spec


class BackendProvenance(Open):
    """The data that fix a backend's answers.

    Attributes:
        backend: the name of the backend, as in ``--backend``.
        model_hash: the hash of the model, which changes whenever traces could.
        assumptions: the assumptions of every statement about this backend.
        void: the treatment of a void rollout; only for a machine.
        reading: the number of the rule by which messages become samples; only for logs.
    """

    backend: str
    model_hash: str
    assumptions: NotRequired[list[str]]
    void: NotRequired[Literal["again", "fall"]]
    reading: NotRequired[Count]


class RunProvenance(Open):
    """The data that fix a run: the first line of each of its journals.

    Attributes:
        s2r: version.
        spec: name of the specification's file.
        spec_hash: the hash of the specification.
        requirement: the name of the requirement.
        seed: the seed of the run.
        settings: the settings that were declared before the data.
        stop: the stopping rule; absent for ``epsilon``.
        recorded: the parts of recordings that were left out, each in one sentence; only for recordings.
    """

    s2r: str
    spec: str
    spec_hash: str
    requirement: str
    seed: Count
    settings: dict[str, Any]
    stop: NotRequired[Literal["decided", "budget"]]
    recorded: NotRequired[list[str]]


@dataclass(frozen=True, kw_only=True, repr=False)
class SearchResult(Result, Shown):
    """The result of a search on one requirement.

    Attributes:
        requirement: the name of the requirement.
        lower: certified lower bound, in ``unit``.
        upper: certified upper bound, in ``unit``.
        unit: the unit of ρ; "" when the requirement mixes units.
        failures: word for a failure → number of rollouts that ended with it; of a gap, of real rollouts.
        assumptions: the assumptions, each in one sentence.
        label: the label of the certificate.
        certificate: the certificate of the search.
        provenance: the data that fix the run.
        folder: the folder of the rollouts.
        seconds: wall time of the rollouts [s], summed over all workers and all resumed processes.
        spec: the specification.
        voids: word → number of rollouts that something other than the robot ended; only for a machine.
    """

    requirement: str
    lower: float
    upper: float
    unit: str
    failures: Failures
    assumptions: Annotated[tuple[str, ...], MinLen(1)]
    certificate: Certificate
    provenance: dict[str, Any]
    folder: Path
    seconds: Magnitude = field(metadata={DIGITS: 3})
    spec: Spec = field(compare=False)
    voids: Failures | None = field(default=None, metadata=OPTIONAL)


def rho_unit(spec: Spec, requirement: str) -> str:
    """Return the unit of ρ, "" when the requirement mixes units that do not compare."""
    unit = spec.unit(requirement)
    return "" if unit == "mixed" else unit


def by_test(rollouts: Iterable[Any]) -> list[list[Any]]:
    """Group rollouts or pairs by their ``params``, in the order of the tests."""
    groups: dict[tuple[float, ...], list[Any]] = {}
    for rollout in rollouts:
        groups.setdefault(tuple(rollout.params.values()), []).append(rollout)
    return list(groups.values())


def by_query(rollouts: Iterable[Any]) -> list[list[Any]]:
    """Group rollouts or pairs by their ``query``, in order."""
    groups: dict[int, list[Any]] = {}
    for rollout in rollouts:
        groups.setdefault(rollout.query, []).append(rollout)
    return [groups[query] for query in sorted(groups)]


def distance(spec: Spec, left: Mapping[str, float], right: Mapping[str, float]) -> float:
    """Return the distance of two tests as a share of the test space's width, on the axis where it is largest."""
    return max(abs(left[axis.name] - right[axis.name]) / axis.width for axis in spec.space.axes)


def left_out(rollouts: int) -> tuple[str, ...]:
    """Return a sentence on the real or simulated rollouts of an incomplete last batch; none if there are none."""
    words = f"{rollouts} rollouts of an incomplete last batch are on disk and not counted"
    return (words,) if rollouts else ()


def replay_line(folder: Path, query: int, replicate: int) -> str:
    """Return the shell command that runs a rollout again."""
    return f"s2r replay {shlex.quote(str(folder))}#{query}.{replicate}"
