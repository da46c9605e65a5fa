"""Parts of the object of ``s2r diagnose``: where the gap lies, whether it matters, what no effect explains."""

from __future__ import annotations

from typing import Annotated

from annotated_types import MinLen
from typing_extensions import TypedDict

from s2r_spec.attribution.attribute import Part
from s2r_spec.attribution.critical import Critical
from s2r_spec.diagnose.residuals.shifts import Shift
from s2r_spec.json_objects.parts import Count, Point, Probability

Values = dict[str, dict[str, float]]
"""Effect → parameter → value."""
Ends = tuple[float, float]


class FindingObject(TypedDict):
    """A mistake that the recordings seem to have.

    Attributes:
        code: kind of mistake: late, begin, clock, hold, exchanged, sign, scale, frame, offset, labels, unit, …
        channel: the channel with the mistake; 'the tests' or 'the clock' if it is in no channel.
        text: the mistake and its remedy in a few sentences; the notes repeat it.
    """

    code: str
    channel: str
    text: str


class SetObject(TypedDict):
    """Two or more effects that together are the answer.

    Attributes:
        effects: the names of the effects.
        probability: the probability that these are the causes.
    """

    effects: Annotated[list[str], MinLen(2)]
    probability: Probability


class IntervalObject(TypedDict):
    """An estimate with its interval.

    Attributes:
        estimate: the estimate of a share.
        low: the lower end of the 95 % interval.
        high: the upper end of the 95 % interval.
    """

    estimate: float
    low: float
    high: float


class LargestObject(IntervalObject):
    """The expected |Δρ| at its worst test.

    Attributes:
        estimate: the estimate, in the unit.
        unit: the unit of ρ.
    """

    unit: str


class BeyondObject(TypedDict):
    """Tests at which the gap exceeds the tolerance.

    Attributes:
        share: the share of the test space.
        within: parameter → ends of the box that contains these tests.
    """

    share: Probability
    within: dict[str, Ends]


class LineObject(TypedDict):
    """The gap on a line through the worst test, with bands of 95 %.

    Attributes:
        at: values of the parameter.
        absolute: E|Δρ|.
        absolute_low: end of its band.
        absolute_high: end of its band.
        signed: E Δρ.
        signed_low: end of its band.
        signed_high: end of its band.
        exceeds: probability that E|Δρ| is above the tolerance; null if there is no tolerance.
    """

    at: list[float]
    absolute: list[float]
    absolute_low: list[float]
    absolute_high: list[float]
    signed: list[float]
    signed_low: list[float]
    signed_high: list[float]
    exceeds: list[float] | None


class SpaceObject(TypedDict):
    """Where in the test space the gap lies.

    Attributes:
        worst: the test where E|Δρ| is probably largest.
        worst_probability: the probability of being within a tenth of every axis of the worst test.
        worst_within: parameter → central 90 % interval of the worst test.
        largest: E|Δρ| at the worst test.
        floor: E|Δρ| of the simulator against itself; null if no test was simulated twice.
        tolerance: twice the |Δρ| that scatter alone causes; null if no test was simulated twice.
        beyond: tests at which the gap exceeds the tolerance with probability 95 %; null if there is no tolerance.
        along: parameter → the gap on the line along it through the worst test.
        notes: limits of the data, each in one sentence.
    """

    worst: Point
    worst_probability: Probability
    worst_within: dict[str, Ends]
    largest: LargestObject
    floor: float | None
    tolerance: float | None
    beyond: BeyondObject | None
    along: dict[str, LineObject]
    notes: list[str]


class WindowObject(TypedDict):
    """One of equal windows of time.

    Attributes:
        begin: the start of the window [s].
        end: the end of the window [s].
        delta: the contribution of the window to Δρ.
    """

    begin: float
    end: float
    delta: float


class SwitchObject(TypedDict):
    """The critical predicates in simulation and on the real machine.

    Attributes:
        simulated: the predicate that decides ρ of the simulated trace.
        real: the predicate that decides ρ of the real trace.
        switches: whether the two predicates differ.
        bounds: bounds on Δρ; null if ρ is neither a minimum nor a maximum of margins.
        words: the same in a sentence.
    """

    simulated: Critical
    real: Critical
    switches: bool
    bounds: Ends | None
    words: str


class ChannelObject(TypedDict):
    """One channel of both traces, in the spec's unit.

    Attributes:
        real: means over bins.
        simulated: means over bins.
        delta: the contribution of each bin to Δρ.
    """

    real: list[float]
    simulated: list[float]
    delta: list[float]


class TraceObject(TypedDict):
    """A real and a simulated trace, in bins of samples.

    Attributes:
        begin: the start of each bin [s].
        channels: name of the channel → samples.
    """

    begin: list[float]
    channels: dict[str, ChannelObject]


class BodyPartObject(TypedDict):
    """A part of the machine.

    Attributes:
        part: the name of the part in the backend.
        shifts: the shifts of its residuals, clearest first; empty if nothing shifts.
    """

    part: str
    shifts: list[Shift]


class BodyObject(TypedDict):
    """The parts of the machine whose motion their model does not explain.

    Attributes:
        level: false-discovery rate.
        rollouts: number of compared real rollouts.
        duration: the duration of a rollout [s].
        asked: number of hypothesis tests: columns times two times windows.
        parts: the parts, clearest first.
    """

    level: Probability
    rollouts: Count
    duration: float
    asked: Count
    parts: list[BodyPartObject]


class WhereObject(TypedDict):
    """Where the gap lies.

    Attributes:
        space: the gap over the test space; null if the spec sweeps no parameter, or more than four.
        test: the worst of the tests that were run; the fields below describe a pair of rollouts at this test.
        delta: Δρ = ρ_real − ρ_sim.
        time: the contributions of equal windows of time to Δρ.
        formula: the contributions of the sub-formulas, in written order.
        channels: name of a channel → its contribution to Δρ.
        ended: part of Δρ that the common samples do not show.
        switch: the critical predicates of both traces; null if ρ depends on no predicate.
        trace: samples of both traces.
        body: the parts of the machine whose motion their model does not explain; null if this is unknown.
        no_body: the reason why body is null, in a sentence; null if there is a body.
    """

    space: SpaceObject | None
    test: Point
    delta: float
    time: list[WindowObject]
    formula: list[Part]
    channels: dict[str, float]
    ended: float
    switch: SwitchObject | None
    trace: TraceObject
    body: BodyObject | None
    no_body: str | None


class GapAtTestObject(TypedDict):
    """The gap at one test, in the unit of ρ.

    Attributes:
        params: the test.
        rollouts: number of real rollouts that ran to their end.
        real: mean ρ of these.
        simulated: mean ρ of the simulated rollouts; its size is the margin.
        gap: mean real ρ minus mean simulated ρ.
        low: the lower end of the gap's interval; the intervals of all tests hold at once with probability 95 %.
        high: the upper end.
        p: p-value of no gap, at this test alone.
        changes_sign: whether the gap is more than scatter, and one of both means is negative.
    """

    params: Point
    rollouts: Count
    real: float
    simulated: float
    gap: float
    low: float
    high: float
    p: Probability
    changes_sign: bool


class FailuresObject(TypedDict):
    """Rollouts that ended early, over all tests.

    Attributes:
        real: number of real rollouts that ended early.
        real_rollouts: number of real rollouts.
        simulated: number of simulated rollouts that ended early.
        simulated_rollouts: number of simulated rollouts.
        p: p-value of both ending early alike, times two, because ρ has the other half of the level.
    """

    real: Count
    real_rollouts: Count
    simulated: Count
    simulated_rollouts: Count
    p: Probability


class MaterialityObject(TypedDict):
    """Whether the gap matters, over all real rollouts.

    Attributes:
        matters: whether it matters at any test, or rollouts end early more often on one side.
        level: the probability of a material gap where there is none.
        tests: number of tests with whole rollouts of both kinds.
        unit: the unit of ρ.
        tolerance: the smallest constant that the requirement compares a signal with, in the unit; null without one.
        largest: the largest gap of those that matter, or of all where none does; null without tests.
        places: the tests at which the gap matters, largest gap first.
        failures: rollouts that ended early; null without any.
    """

    matters: bool
    level: Probability
    tests: Count
    unit: str
    tolerance: float | None
    largest: GapAtTestObject | None
    places: list[GapAtTestObject]
    failures: FailuresObject | None


class RemainderObject(TypedDict):
    """A difference between the machine and the improved simulator in one place.

    Attributes:
        quantity: a recorded channel, or a residual of the nominal model.
        column: the column of the channel.
        part: the part of the machine; "" if the quantity belongs to no single part.
        along: channel whose values bound the place; "" for time.
        low: end of the place; null where it has no such end.
        high: end of the place; null where it has no such end.
        size: the value of the machine minus the value of the improved simulator, in the quantity's unit.
        unit: the unit of the quantity.
        along_unit: the unit of the channel, or of time.
        surplus: size divided by the largest size that needs no cause.
        recorded: whether the quantity is a recorded channel.
        times: first and last time [s] at which the channel has these values; null for all the time, or without channel.
        extent: lowest and highest value of the channel; null if it is not known, or without channel.
    """

    quantity: str
    column: int
    part: str
    along: str
    low: float | None
    high: float | None
    size: float
    unit: str
    along_unit: str
    surplus: float
    recorded: bool
    times: Ends | None
    extent: Ends | None
