"""The object of ``s2r diagnose``, as :meth:`s2r_spec.diagnose.diagnosis.Diagnosis.to_json` makes it."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import MinLen
from typing_extensions import TypedDict

from s2r_spec.diagnose.decision import Verdict
from s2r_spec.diagnose.gap.held_out import Gap, HeldOut
from s2r_spec.json_objects.diagnosis_parts import (
    FindingObject,
    IntervalObject,
    MaterialityObject,
    RemainderObject,
    SetObject,
    Values,
    WhereObject,
)
from s2r_spec.json_objects.parts import Count, Open, Point, Probability

Status = Literal["named", "possible", "ruled out", "hidden"]


class EstimateObject(TypedDict):
    """A parameter of an effect.

    Attributes:
        estimate: the posterior median, in the unit.
        low: the lower end of the 90 % interval.
        high: the upper end of the 90 % interval.
        unit: the unit of the estimate and the interval.
        size: the estimate in typical sizes; a typical size is twice the standard deviation of the parameter's prior.
        size_low: the lower end in typical sizes.
        size_high: the upper end in typical sizes.
        half_width: half-width of the interval by the data alone, with all other sizes free, in typical sizes.
        at_end: whether the data ask for an end of the range, beyond which nothing was simulated.
        dependent: whether it acts only beside another parameter, and only says how the effect acts.
    """

    estimate: float
    low: float
    high: float
    unit: str
    size: float
    size_low: float
    size_high: float
    half_width: float
    at_end: bool
    dependent: bool


class PowerObject(TypedDict):
    """What one more run of an experiment says about a possible effect.

    Attributes:
        experiment: the experiment in words.
        allowed: whether the user allows it.
        sigma: distance of the most probable sets with and without the effect, in standard deviations per run.
        settles: whether the effect is then named or ruled out.
    """

    experiment: str
    allowed: bool
    sigma: float
    settles: bool


class SeparationObject(TypedDict):
    """A possible effect, and the experiments that could settle it.

    Attributes:
        effect: the name of the effect.
        included: the most probable set with the effect.
        excluded: the most probable set without it.
        powers: the experiments, largest distance first.
    """

    effect: str
    included: list[str]
    excluded: list[str]
    powers: list[PowerObject]


class NextTestObject(TypedDict):
    """The experiment to run next.

    Attributes:
        protocol: the name of the protocol; "" for a test of the specification.
        params: its parameters.
        separates: the two sets of effects that it separates.
        sigma: their distance in standard deviations per run.
        entropy: expected fall of the entropy of the set, in bits.
    """

    protocol: str
    params: Point
    separates: tuple[list[str], list[str]]
    sigma: float
    entropy: float


class WhichObject(TypedDict):
    """Which effects, with sizes and probabilities.

    Attributes:
        posterior: none, or an effect → probability that nothing else is a cause.
        pairs: sets of two or more effects, each with a probability of at least one in a thousand.
        others: probability of all other sets of several effects.
        membership: effect → probability that it is at least a quarter of typical.
        presence: effect → probability that it is at least an eighth of typical.
        status: effect → named, possible, ruled out, or hidden: ruled out by the prior alone.
        answer: effects named.
        set: effects named, then the possible ones.
        parameters: effect → parameter → its estimate, for every effect of the catalogue.
        nearest_family: the family of the most probable effects.
        hidden: effects, or some of their parameters, that the data alone do not measure to a quarter of typical.
        separations: one for each possible effect: what other experiments would say about it.
        next_test: the experiment to run next; null if none separates the candidates.
    """

    posterior: dict[str, Probability]
    pairs: list[SetObject]
    others: float
    membership: dict[str, float]
    presence: dict[str, float]
    status: dict[str, Status]
    answer: list[str]
    set: list[str]
    parameters: dict[str, dict[str, EstimateObject]]
    nearest_family: str
    hidden: list[str]
    separations: list[SeparationObject]
    next_test: NextTestObject | None


class HowFarObject(TypedDict):
    """The gap on held-out rollouts, before and after the named effects were added to the simulator.

    Attributes:
        rollouts: number of held-out real rollouts.
        unit: the unit of ρ.
        before: the gap of the nominal simulator.
        after: the gap with the named effects; null if nothing is named.
        tuned: the gap with the posterior mean of every effect.
        floor: the gap due to scatter alone.
        background: the largest gap that small amounts of all effects make in 19 of 20 machines.
        material: whether the gap exceeds scatter and background.
        seen: the gap of the nominal simulator at the tests that were not held out.
        elsewhere: whether only these tests have a material gap.
        share: part of the gap above the floor that the named effects close.
        tuned_share: the same share for the tuned simulator.
        tests_with_a_larger_gap_at_most: part of all tests, with 95 % confidence.
        tests: the signed gap of each held-out test.
    """

    rollouts: Count
    unit: str
    before: Gap
    after: Gap | None
    tuned: Gap
    floor: float
    background: float
    material: bool
    seen: Gap | None
    elsewhere: bool
    share: IntervalObject | None
    tuned_share: IntervalObject | None
    tests_with_a_larger_gap_at_most: Probability
    tests: list[HeldOut]


class MisfitObject(TypedDict):
    """Where the misfit of the traces is largest.

    Attributes:
        experiment: the experiment in words.
        quantity: the channel or the residual.
        statistic: what of it is compared: its means over parts of the trace, its scatter, …
        part: the column of the quantity; "" if it has one.
        begin: the start of the place [s].
        end: the end of the place [s].
    """

    experiment: str
    quantity: str
    statistic: str
    part: str
    begin: float
    end: float


class GoodnessOfFitObject(TypedDict):
    """Whether the best set of effects fits the traces as well as it fits machines of the catalogue.

    Attributes:
        p: conformal p-value over all experiments.
        level: level of the alarm.
        alarm: whether the p-value is at most this level.
        worst: where the misfit is largest.
    """

    p: Probability
    level: Probability
    alarm: bool
    worst: MisfitObject


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
        rule: the rule behind the verdict.
        reason: a few sentences for the verdict.
        next: the next step, in one sentence.
        which: the effects, with sizes and probabilities.
        where: where the gap lies; null if it was not asked for.
        how_far: the gap on held-out real rollouts; null if there are too few.
        materiality: whether the gap matters; null for a diagnosis that was put together by hand.
        goodness_of_fit: whether the effects explain the traces; null where that was not tested.
        left: motion that no effect explains, the cause's place first; empty with fewer than five complete rollouts.
        patch: effect → parameter → value to add to the simulator.
        tuned: effect → parameter → posterior mean, for every effect.
        passive: whether the data are tests of the specification alone, without a protocol.
        assumptions: the assumptions, each in one sentence.
        notes: limits of the real rollouts, each in one sentence.
        findings: suspected mistakes of the recordings; correct these first.
        misread: the channels of the findings, each once.
    """

    schema: Literal["s2r/diagnosis/2"]
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
    rule: str
    reason: str
    next: str
    which: WhichObject
    where: WhereObject | None
    how_far: HowFarObject | None
    materiality: MaterialityObject | None
    goodness_of_fit: GoodnessOfFitObject | None
    left: list[RemainderObject]
    patch: Values
    tuned: Values
    passive: bool
    assumptions: Annotated[list[str], MinLen(1)]
    notes: list[str]
    findings: list[FindingObject]
    misread: list[str]
