"""The object of ``s2r diagnose``, as :meth:`s2r_spec.diagnose.diagnosis.Diagnosis.to_json` makes it."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import MinLen
from typing_extensions import TypedDict

from s2r_spec.diagnose.diagnosis import NextTest, Verdict
from s2r_spec.diagnose.gap.held_out import Gap, HeldOut
from s2r_spec.diagnose.isolability import Least
from s2r_spec.json_objects.diagnosis_parts import (
    FindingObject,
    IntervalObject,
    MaterialityObject,
    RemainderObject,
    SetObject,
    Values,
    WhereObject,
)
from s2r_spec.json_objects.parts import Count, Open, Probability


class EstimateObject(TypedDict):
    """A parameter of a named effect.

    Attributes:
        estimate: the estimate, in the unit.
        low: the lower end of the 90 % interval.
        high: the upper end of the 90 % interval.
        unit: the unit of the estimate and the interval.
        at_end: whether the value is at an end of its range, beyond which nothing was tried.
    """

    estimate: float
    low: float
    high: float
    unit: str
    at_end: bool


class IsolabilityObject(TypedDict):
    """Which effects these tests can tell apart.

    Attributes:
        effects: the names of the effects.
        sigma: distances in standard deviations; row: the true effect, column: the effect that imitates it.
        visible: distance of each effect from the nominal simulator.
        apart: below this distance effects are confounded.
        differs: the same distances as parts of the effect's own size; below 0.38 effects are confounded.
        least: the values of each parameter at which its effect differs from every other effect.
    """

    effects: list[str]
    sigma: list[list[float]]
    visible: list[float]
    apart: float
    differs: list[list[float]]
    least: list[Least]


class WhichObject(TypedDict):
    """Which effects, with probabilities.

    Attributes:
        posterior: effect, none or unknown → probability that it alone is the answer.
        pairs: sets of two or more effects, each with a probability of at least one in a thousand.
        others: probability of all other sets of several effects.
        membership: effect → probability that it is among the causes.
        answer: effects named; empty for none and unknown.
        set: effects that the data cannot distinguish from the answer, the answer included.
        spare: effects of the answer that may be absent: without them the others are nearly as probable.
        parameters: effect → parameter → value that fits best.
        nearest_family: the family of the most probable effects.
        isolability: the isolability at the tests that were run.
        next_test: the test that would best separate the candidates; null if the answer is sure.
    """

    posterior: dict[str, Probability]
    pairs: list[SetObject]
    others: float
    membership: dict[str, float]
    answer: list[str]
    set: list[str]
    spare: list[str]
    parameters: dict[str, dict[str, EstimateObject]]
    nearest_family: str
    isolability: IsolabilityObject
    next_test: NextTest | None


class HowFarObject(TypedDict):
    """The gap on held-out rollouts, before and after the named effects were added to the simulator.

    Attributes:
        rollouts: number of held-out real rollouts.
        unit: the unit of ρ.
        before: the gap of the nominal simulator.
        after: the gap with the named effects; null if nothing is named.
        tuned: the gap with fitted small amounts of all other effects as well.
        floor: the gap due to scatter alone.
        background: the largest gap that small amounts of all effects make in 19 of 20 machines.
        material: whether the gap exceeds scatter and background.
        seen: the gap of the nominal simulator at the rollouts that were not held out.
        elsewhere: whether the gap is material at some test, but not on average over the held-out tests.
        share: part of the gap above the floor that the named effects close.
        tuned_share: the same share for the tuned simulator.
        oracle_gap: the gap after, as predicted for the best of all single effects.
        oracle_share: part of this reduction of the gap that the named effects reach.
        tests_with_a_larger_gap_at_most: part of all tests, with 95 % confidence.
        tests: the signed gap of each held-out test.
    """

    rollouts: Count
    unit: str
    before: Gap
    after: Gap | None
    tuned: Gap | None
    floor: float
    background: float
    material: bool
    seen: Gap | None
    elsewhere: bool
    share: IntervalObject | None
    tuned_share: IntervalObject | None
    oracle_gap: float | None
    oracle_share: float | None
    tests_with_a_larger_gap_at_most: Probability
    tests: list[HeldOut]


class DiagnosisObject(Open):
    """The result of ``s2r diagnose``. Further fields describe the origin of the answer.

    Attributes:
        schema: name and version of this object.
        exit_code: 0 if a cause or no material gap is the answer; else 3.
        s2r: the version of s2r.
        seed: the seed of the diagnosis.
        spec_hash: the hash of the specification.
        requirement: the name of the requirement.
        backend: the simulator.
        model_hash: the hash of the simulator.
        rollouts: number of real rollouts behind the answer.
        held_out: number of real rollouts on which the gap is measured.
        verdict: the answer in a few words.
        by_falls: whether only falls show the named effect: no other rollout does.
        reason: one sentence for the verdict.
        next: the next step, in one sentence.
        which: the effects, with probabilities.
        where: where the gap lies; null if it was not asked for.
        how_far: the gap on held-out real rollouts; null if there are too few.
        materiality: whether the gap matters; null for a diagnosis that was put together by hand.
        left: motion that no effect explains, the cause's place first; empty with fewer than five complete rollouts.
        patch: effect → parameter → value to add to the simulator.
        tuned: the same with fitted small amounts of all other effects.
        assumptions: the assumptions, each in one sentence.
        notes: limits of the real rollouts, each in one sentence.
        findings: suspected mistakes of the recordings; correct these first.
        misread: the channels of the findings, each once.
    """

    schema: Literal["s2r/diagnosis/1"]
    exit_code: Literal[0, 3]
    s2r: str
    seed: Count
    spec_hash: str
    requirement: str
    backend: str
    model_hash: str
    rollouts: Count
    held_out: Count
    verdict: Verdict
    by_falls: bool
    reason: str
    next: str
    which: WhichObject
    where: WhereObject | None
    how_far: HowFarObject | None
    materiality: MaterialityObject | None
    left: list[RemainderObject]
    patch: Values
    tuned: Values
    assumptions: Annotated[list[str], MinLen(1)]
    notes: list[str]
    findings: list[FindingObject]
    misread: list[str]
