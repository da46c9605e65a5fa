"""The answer of a diagnosis: where the gap lies, which effects cause it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import MinLen

from s2r_spec.backend import LoopMistake
from s2r_spec.base.json_types import Count, Probability
from s2r_spec.base.json_values import Open, Shown
from s2r_spec.base.result import Result
from s2r_spec.base.upper import upper
from s2r_spec.diagnose.decision import Evidence, Rule, Verdict
from s2r_spec.diagnose.experiment_design.next_test import NextTest
from s2r_spec.diagnose.gap.breaking import Breaking
from s2r_spec.diagnose.gap.held_out import HeldOutGap
from s2r_spec.diagnose.gap.materiality import Materiality
from s2r_spec.diagnose.gap.where import Where
from s2r_spec.diagnose.inference.estimates import (
    EffectEstimate,
    ParameterEstimate,
    Status,
    hidden_names,
    with_status,
)
from s2r_spec.diagnose.inference.prior import LIKELY
from s2r_spec.diagnose.residuals.left import Remainder
from s2r_spec.diagnose.simulator.axes import Values
from s2r_spec.spec import Spec

SHOWN = 1e-3
"""Definition: probability from which on a set of several effects has an entry in the JSON object."""


@dataclass(frozen=True)
class LikelySet:
    """Two or more effects that together are the answer.

    Attributes:
        effects: the names of the effects.
        probability: the probability that these are the causes.
    """

    effects: Annotated[tuple[str, ...], MinLen(2)]
    probability: Probability


@dataclass(frozen=True)
class Which(Shown):
    """Which effects, with sizes and probabilities.

    Attributes:
        evidence: what the verdict rests on, with the estimate of every effect.
        sets: (effects, probability), most probable first; () for no cause.
        posterior: none, or an effect → probability that nothing else is a cause.
        set: effects named, then the possible ones.
        separations: one for each possible effect: what other experiments would say about it.
        next_test: the experiment to run next; None if none separates the candidates.
    """

    evidence: Evidence
    sets: tuple[tuple[tuple[str, ...], float], ...]
    next_test: NextTest | None = None

    JSON = (
        "posterior pairs others membership presence status answer set=asserted parameters nearest_family hidden "
        "separations=evidence.separations next_test"
    )

    @property
    def effects(self) -> tuple[EffectEstimate, ...]:
        """Every effect of the catalogue, in its order."""
        return self.evidence.effects

    @property
    def posterior(self) -> dict[str, Probability]:
        """The probability of no cause, and of each effect alone."""
        sets = dict(self.sets)
        alone = {one.effect: sets.get((one.effect,), 0.0) for one in self.effects}
        return _round({"none": sets.get((), 0.0)} | alone)

    @property
    def pairs(self) -> tuple[LikelySet, ...]:
        """Sets of two or more effects, each with a probability of at least one in a thousand."""
        return tuple(LikelySet(names, round(p, 6)) for names, p in self._several.items() if p >= SHOWN)

    @property
    def others(self) -> float:
        """Probability of all other sets of several effects."""
        several = self._several.values()
        return round(sum(several) - sum(p for p in several if p >= SHOWN), 6)

    @property
    def _several(self) -> dict[tuple[str, ...], float]:
        return {names: p for names, p in dict(self.sets).items() if len(names) > 1}

    @property
    def membership(self) -> dict[str, float]:
        """Effect → probability that it is at least a quarter of typical."""
        return _round({e.effect: e.probability for e in sorted(self.effects, key=lambda e: -e.probability)})

    @property
    def presence(self) -> dict[str, float]:
        """Effect → probability that it is at least an eighth of typical."""
        return _round({one.effect: one.presence for one in self.effects})

    @property
    def status(self) -> dict[str, Status]:
        """Effect → named, possible, ruled out, or hidden: ruled out by the prior alone."""
        return {one.effect: one.status for one in self.effects}

    @property
    def answer(self) -> tuple[str, ...]:
        """Effects named."""
        return self.evidence.answer

    @property
    def asserted(self) -> tuple[str, ...]:
        """The effects named, then the possible ones."""
        return (*self.answer, *(one.effect for one in self.possible))

    @property
    def ranked(self) -> list[tuple[tuple[str, ...], float]]:
        """Every set with its probability, most probable first; ("none",) for no cause."""
        return [(names or ("none",), p) for names, p in self.sets]

    @property
    def possible(self) -> tuple[EffectEstimate, ...]:
        """The possible effects, most probable first."""
        return with_status(self.effects, Status.POSSIBLE)

    @property
    def parameters(self) -> dict[str, dict[str, ParameterEstimate]]:
        """Effect → parameter → its estimate, for every effect of the catalogue."""
        return {one.effect: {each.parameter: each for each in one.parameters} for one in self.effects}

    @property
    def hidden(self) -> tuple[str, ...]:
        """Effects, or some of their parameters, that the data alone do not measure to a quarter of typical."""
        return hidden_names(self.effects)

    @property
    def nearest(self) -> tuple[str, ...]:
        """The effects with a name; without any, those of a set that is more likely than all others together."""
        return self.evidence.named or next((names for names, p in self.sets if names and p >= LIKELY), ())

    @property
    def nearest_family(self) -> str:
        """The family of the nearest effects; "" without any."""
        return " and ".join(dict.fromkeys(one.family for one in self.effects if one.effect in self.nearest))


def _round(probabilities: Mapping[str, float]) -> dict[str, float]:
    return {name: round(p, 6) for name, p in probabilities.items()}


class Provenance(Open):
    """The data that fix the answer.

    Attributes:
        s2r: the version of s2r.
        seed: the seed of the diagnosis.
        spec_hash: the hash of the specification.
        requirement: the name of the requirement.
        backend: the simulator.
        model_hash: the hash of the simulator.
        rollouts: number of real rollouts behind the answer.
        held_out: number of real rollouts on which the gap is measured.
    """

    s2r: str
    seed: Count
    spec_hash: str
    requirement: str
    backend: str
    model_hash: str
    rollouts: Count
    held_out: Count


@dataclass(frozen=True, repr=False)
class Diagnosis(Result, Shown):
    """The result of ``s2r diagnose``. Further fields describe the origin of the answer.

    Attributes:
        which: the effects, with sizes and probabilities.
        where: where the gap lies; None if it was not asked for.
        tuned: effect → parameter → posterior mean, for every effect.
        provenance: version, seed, hashes.
        how_far: the gap on held-out real rollouts; None if there are too few.
        materiality: whether the gap matters; None for a diagnosis that was put together by hand.
        misfit: what the most probable set leaves of the difference of the traces.
        findings: suspected mistakes of the recordings; correct these first.
        loop: the loop of code around the controller that the recordings show; None where they show none.
        assumptions: the assumptions, each in one sentence.
        notes: limits of the real rollouts, each in one sentence.
        passive: whether the data are tests of the specification alone, without a protocol.
        spec: the specification; None for a diagnosis that was put together by hand, which has no JSON object.
        real: name of the real machine; "" for rollouts without a name.
        breaking: at which size each parameter alone would break the requirement on this machine; None where no test of
            the library was run.
    """

    which: Which
    where: Where | None
    tuned: Values
    provenance: Provenance
    assumptions: Annotated[tuple[str, ...], MinLen(1)]
    notes: tuple[str, ...] = ()
    passive: bool = False
    spec: Spec | None = field(default=None, compare=False)
    real: str = ""
    breaking: Breaking | None = None

    JSON = (
        "schema *provenance verdict rule=rule.word reason which where how_far materiality "
        "misfit=evidence.misfit loop=evidence.loop left patch tuned breaking passive assumptions notes "
        "findings=evidence.findings misread exit_code next"
    )

    @property
    def schema(self) -> Literal["s2r/diagnosis/2"]:
        """Name and version of this object."""
        return "s2r/diagnosis/2"

    @property
    def exit_code(self) -> Literal[0, 3]:
        """0 if a cause or no material gap is the answer; else 3."""
        return 0 if self.verdict.exit_code == 0 and not self.misread else 3

    @property
    def next(self) -> str:
        """The next step, in one sentence."""
        words: str = upper("report.advice").next_step(self, self.spec)
        return words

    @property
    def rule(self) -> Rule:
        """The rule behind the verdict."""
        return self.evidence.rule()

    @property
    def verdict(self) -> Verdict:
        """The answer in a few words."""
        return self.rule.verdict

    @property
    def reason(self) -> str:
        """A few sentences for the verdict."""
        words: str = upper("report.reason").reason(self)
        return words

    @property
    def evidence(self) -> Evidence:
        """What the verdict rests on."""
        return self.which.evidence

    @property
    def how_far(self) -> HeldOutGap | None:
        """The held-out gap before and after; None where nothing was held out."""
        return self.evidence.held_out

    @property
    def materiality(self) -> Materiality | None:
        """Whether the gap matters at any test."""
        return self.evidence.materiality

    @property
    def left(self) -> tuple[Remainder, ...]:
        """Motion that no effect explains, the cause's place first; empty with fewer than five complete rollouts."""
        return tuple(self.evidence.left)

    @property
    def patch(self) -> dict[str, dict[str, float]]:
        """Effect → parameter → value to add to the simulator."""
        answer = self.which.answer
        return {one.effect: one.values for one in self.which.effects if one.effect in answer}

    @property
    def mistakes(self) -> tuple[LoopMistake, ...]:
        """The mistakes that the machine's loop surely has."""
        loop = self.evidence.loop
        return loop.mistakes if loop is not None and loop.sure else ()

    @property
    def misread(self) -> tuple[str, ...]:
        """The channels of the findings, each once."""
        return tuple(dict.fromkeys(each.channel for each in self.evidence.findings))

    def __str__(self) -> str:
        """Return verdict and reason; all else is in the fields."""
        return f"{self.verdict.value}: {self.reason}"

    def improved(self, tuned: bool) -> Values:
        """Return what to add to the simulator; empty where nothing is to be.

        Args:
            tuned: also add small amounts of all other effects; without a named cause only these are there to add.
        """
        if not tuned:
            return self.patch
        without_name = self.rule in (Rule.SPREAD, Rule.EITHER)
        return self.tuned if self.patch or without_name else {}
