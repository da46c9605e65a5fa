"""The answer of a diagnosis: where the gap lies, which effects cause it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from s2r_spec.diagnose.decision import Evidence, GoodnessOfFit, Rule, Verdict
from s2r_spec.diagnose.experiment_design.next_test import NextTest
from s2r_spec.diagnose.gap.held_out import HeldOutGap
from s2r_spec.diagnose.gap.materiality import Materiality
from s2r_spec.diagnose.gap.where import Where
from s2r_spec.diagnose.inference.estimates import EffectEstimate, Status, hidden_names, with_status
from s2r_spec.diagnose.residuals.left import Remainder
from s2r_spec.result import Result
from s2r_spec.spec import Spec
from s2r_spec.upper import upper

SCHEMA = "s2r/diagnosis/2"
SHOWN = 1e-3
"""Definition: probability from which on a set of several effects has an entry in the JSON object."""

Values = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Which:
    """Which effects, with sizes and probabilities.

    Attributes:
        evidence: what the verdict rests on, with the estimate of every effect.
        sets: (effects, probability), most probable first; () for no cause.
        next_test: the experiment to run next; None where none separates the sets.
    """

    evidence: Evidence
    sets: tuple[tuple[tuple[str, ...], float], ...]
    next_test: NextTest | None = None

    @property
    def effects(self) -> tuple[EffectEstimate, ...]:
        """Every effect of the catalogue, in its order."""
        return self.evidence.effects

    @property
    def answer(self) -> tuple[str, ...]:
        """The effects that the verdict names."""
        return self.evidence.answer

    @property
    def membership(self) -> dict[str, float]:
        """Return effect → probability that it is at least a quarter of typical, most probable first."""
        return {one.effect: one.probability for one in sorted(self.effects, key=lambda e: -e.probability)}

    @property
    def ranked(self) -> list[tuple[tuple[str, ...], float]]:
        """Return every set with its probability, most probable first; ("none",) for no cause."""
        return [(names or ("none",), p) for names, p in self.sets]

    @property
    def possible(self) -> tuple[EffectEstimate, ...]:
        """The possible effects, most probable first."""
        return with_status(self.effects, Status.POSSIBLE)

    @property
    def hidden(self) -> tuple[str, ...]:
        """The effects, or some of their parameters, that the data alone do not measure to a quarter of typical."""
        return hidden_names(self.effects)

    @property
    def nearest(self) -> tuple[str, ...]:
        """The effects with a name; without any, those of the most probable set with an effect."""
        return self.evidence.named or next((names for names, _ in self.sets if names), ())

    @property
    def nearest_family(self) -> str:
        """The family of the nearest effects, of each if they differ."""
        return " and ".join(dict.fromkeys(one.family for one in self.effects if one.effect in self.nearest))

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object; sets of several below one in a thousand are summed up in ``others``."""
        sets = dict(self.sets)
        several = {names: p for names, p in sets.items() if len(names) > 1}
        shown = {names: p for names, p in several.items() if p >= SHOWN}
        names = [one.effect for one in self.effects]
        return {
            "posterior": {
                "none": round(sets.get((), 0.0), 6),
                **{name: round(sets.get((name,), 0.0), 6) for name in names},
            },
            "pairs": [{"effects": list(each), "probability": round(p, 6)} for each, p in shown.items()],
            "others": round(sum(several.values()) - sum(shown.values()), 6),
            "membership": {name: round(p, 6) for name, p in self.membership.items()},
            "presence": {one.effect: round(one.presence, 6) for one in self.effects},
            "status": {one.effect: one.status.value for one in self.effects},
            "answer": list(self.answer),
            "set": [*self.answer, *(one.effect for one in self.possible)],
            "parameters": {
                one.effect: {each.parameter: _parameter(vars(each)) for each in one.parameters}
                for one in self.effects
            },
            "nearest_family": self.nearest_family,
            "hidden": list(self.hidden),
            "separations": [one.to_json() for one in self.evidence.separations],
            "next_test": None if self.next_test is None else self.next_test.to_json(),
        }


def _goodness(found: GoodnessOfFit | None) -> dict[str, Any] | None:
    if found is None:
        return None
    worst = {name: getattr(found.worst, name) for name in ("quantity", "statistic", "part", "begin", "end")}
    place = {"experiment": str(found.worst.experiment), **worst}
    return {"p": found.p, "level": found.level, "alarm": found.alarm, "worst": place}


def _parameter(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "estimate": fields["value"],
        **{n: v for n, v in fields.items() if n not in ("value", "parameter")},
    }


@dataclass(frozen=True, repr=False)
class Diagnosis(Result):
    """A whole diagnosis.

    Attributes:
        which: which effects, and what the verdict rests on.
        where: the gap over tests, time, formula and body; None when it was not asked for.
        tuned: effect → parameter → posterior mean.
        provenance: version, seed, hashes.
        assumptions: what the answer rests on.
        notes: limits of the real rollouts, a sentence each; those of the findings come first.
        passive: whether the data are tests of the specification alone, without a protocol.
        spec: the specification; None for a diagnosis that was put together by hand.
        real: name of the real machine; "" for rollouts without a name.
    """

    which: Which
    where: Where | None
    tuned: Values
    provenance: Mapping[str, Any]
    assumptions: tuple[str, ...]
    notes: tuple[str, ...] = ()
    passive: bool = False
    spec: Spec | None = field(default=None, compare=False)
    real: str = ""

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
        """The answer in a few sentences."""
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
        """Motion that no effect explains, the cause's place first."""
        return tuple(self.evidence.left)

    @property
    def patch(self) -> dict[str, dict[str, float]]:
        """Effect → parameter → value to add to the simulator; empty where nothing is named."""
        answer = self.which.answer
        return {one.effect: one.values for one in self.which.effects if one.effect in answer}

    @property
    def misread(self) -> tuple[str, ...]:
        """The channels that seem to be recorded wrongly, each once; "the tests" and "the clock", too."""
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

    def to_json(self) -> dict[str, Any]:
        """Return the object that ``s2r diagnose --json`` prints, as plain values."""
        where, far = self.where, self.how_far
        own = {
            "schema": SCHEMA,
            **self.provenance,
            "verdict": self.verdict.value,
            "rule": self.rule.value[0],
            "reason": self.reason,
            "which": self.which.to_json(),
            "where": None if where is None else where.to_json(),
            "how_far": None if far is None else far.to_json(),
            "materiality": None if self.materiality is None else self.materiality.to_json(),
            "goodness_of_fit": _goodness(self.evidence.goodness),
            "left": [each.to_json() for each in self.left],
            "patch": self.patch,
            "tuned": {name: dict(values) for name, values in self.tuned.items()},
            "passive": self.passive,
            "assumptions": list(self.assumptions),
            "notes": list(self.notes),
            "findings": [each.to_json() for each in self.evidence.findings],
            "misread": list(self.misread),
        }
        return own if self.spec is None else own | upper("report.results").added(self)
