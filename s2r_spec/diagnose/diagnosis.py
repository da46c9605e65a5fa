"""The answer of a diagnosis: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from s2r_spec.diagnose.decision import Verdict as Verdict
from s2r_spec.diagnose.estimate import Estimate
from s2r_spec.diagnose.gap.materiality import Materiality
from s2r_spec.diagnose.gap.where import Where
from s2r_spec.diagnose.how_far import HowFar
from s2r_spec.diagnose.isolability import Isolability
from s2r_spec.diagnose.quality.finding import Finding
from s2r_spec.diagnose.remainder import Remainder
from s2r_spec.result import Result
from s2r_spec.spec import Spec
from s2r_spec.upper import upper

SCHEMA = "s2r/diagnosis/1"


@dataclass(frozen=True)
class NextTest:
    """The test that would best separate what cannot be told apart yet.

    Attributes:
        params: of the test, in the spec's units; with a ``protocol`` also parameters of the backend.
        protocol: what to do differently, in words; "" for nothing.
        separates: effects.
        sigma: by how many standard deviations one such test would.
    """

    params: Mapping[str, float]
    protocol: str
    separates: tuple[str, ...]
    sigma: float

    def to_json(self) -> dict[str, Any]:
        """Return the fields."""
        return {
            "params": dict(self.params),
            "protocol": self.protocol,
            "separates": list(self.separates),
            "sigma": round(self.sigma, 2),
        }


RULED_OUT = 0.05
"""A set this many times as likely as the first is ruled out, even where the two are hard to tell apart."""
LEAST = 1e-3
"""And one of this probability in any case."""


@dataclass(frozen=True)
class Which:
    """Which effects, with probabilities.

    Attributes:
        none: P(no effect of the catalogue is material).
        unknown: P(the cause is not in the catalogue).
        singles: effect → P(it alone).
        several: two effects and more → P(these); more than three only where three and more are the likeliest.
        answer: the effects named; () for none or unknown.
        confounded: what the data cannot tell from the answer, the answer included.
        spare: effects of the answer that may not be there: without them the others are nearly as likely.
        estimates: parameters of the answer; of *none of these*, those of the nearest effects.
        nearest_family: family of the likeliest effects, of each if they differ, also when none of them is it.
        isolability: of the simulator's effects, at the tests that were run.
        next_test: see there; None when the answer is sure.
    """

    none: float
    unknown: float
    singles: Mapping[str, float]
    several: Mapping[tuple[str, ...], float]
    answer: tuple[str, ...]
    confounded: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    nearest_family: str
    isolability: Isolability
    next_test: NextTest | None
    spare: tuple[str, ...] = ()

    @property
    def membership(self) -> dict[str, float]:
        """Return effect → probability that it is among the causes, likeliest first."""
        sets: dict[tuple[str, ...], float] = {(name,): p for name, p in self.singles.items()}
        sets |= self.several
        total = dict.fromkeys(self.singles, 0.0)
        for names, p in sets.items():
            for name in names:
                total[name] += p
        return dict(sorted(total.items(), key=lambda item: -item[1]))

    @property
    def instead(self) -> tuple[str, ...]:
        """Return those of ``confounded`` that may be in the place of one of the answer, and not beside it alone."""
        sets = {frozenset([name]): p for name, p in self.singles.items()}
        sets |= {frozenset(names): p for names, p in self.several.items()}
        named = frozenset(self.answer)
        least = RULED_OUT * sets.get(named, 0.0)
        return tuple(
            other
            for other in self.confounded
            if other not in named
            and any(sets.get(named - {name} | {other}, 0.0) > max(least, LEAST) for name in named)
        )

    @property
    def ranked(self) -> list[tuple[tuple[str, ...], float]]:
        """Return every answer with its probability, likeliest first: sets of effects, ("none",), ("unknown",)."""
        answers: dict[tuple[str, ...], float] = {("none",): self.none, ("unknown",): self.unknown}
        answers |= {(name,): p for name, p in self.singles.items()}
        answers |= self.several
        return sorted(answers.items(), key=lambda item: -item[1])

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object; sets of several below one in a thousand are summed up in ``others``."""
        rounded = {name: round(p, 6) for name, p in self.singles.items()}
        shown = {names: p for names, p in self.several.items() if p >= 1e-3}
        return {
            "posterior": {"none": round(self.none, 6), "unknown": round(self.unknown, 6), **rounded},
            "pairs": [
                {"effects": list(names), "probability": round(p, 6)}
                for names, p in sorted(shown.items(), key=lambda item: -item[1])
            ],
            "others": round(sum(self.several.values()) - sum(shown.values()), 6),
            "membership": {name: round(p, 6) for name, p in self.membership.items()},
            "answer": list(self.answer),
            "set": list(self.confounded),
            "spare": list(self.spare),
            "parameters": _parameters(self.estimates),
            "nearest_family": self.nearest_family,
            "isolability": self.isolability.to_json(),
            "next_test": None if self.next_test is None else self.next_test.to_json(),
        }


def _parameters(estimates: tuple[Estimate, ...]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for e in estimates:
        found.setdefault(e.effect, {})[e.parameter] = {
            "estimate": e.value,
            "low": e.low,
            "high": e.high,
            "unit": e.unit,
            "at_end": e.at_end,
        }
    return found


@dataclass(frozen=True, repr=False)
class Diagnosis(Result):
    """A whole diagnosis.

    Attributes:
        verdict: in one word.
        reason: in one sentence.
        where: the gap over tests, time, formula and body; None when it was not asked for.
        which: see there.
        how_far: None where too few rollouts were there to hold some out; see :mod:`s2r_spec.diagnose.parted`.
        left: what the equations of motion leave of the machine that they do not leave of the improved simulator, and
            where, the cause's place first; empty where residuals do not know the effects.
        patch: effects and values to add to the simulator; empty when none is named.
        tuned: the same with a little of every other effect, as the data want it.
        provenance: version, seed, hashes.
        assumptions: what the answer rests on.
        notes: what the real rollouts lack, a sentence each.
        by_falls: whether what is named rests on falls alone: no other rollout shows it.
        findings: mistakes that the recordings seem to have; what is said of causes is worth little until these are seen
            to. Their sentences are the first of the notes.
        materiality: whether the gap matters at any test; None for a diagnosis that was put together by hand.
        spec: the specification; None for a diagnosis that was put together by hand.
        real: name of the real machine; "" for rollouts without a name.
    """

    verdict: Verdict
    reason: str
    where: Where | None
    which: Which
    how_far: HowFar | None
    patch: Mapping[str, Mapping[str, float]]
    tuned: Mapping[str, Mapping[str, float]]
    provenance: Mapping[str, Any]
    assumptions: tuple[str, ...]
    notes: tuple[str, ...] = ()
    left: tuple[Remainder, ...] = ()
    by_falls: bool = False
    findings: tuple[Finding, ...] = ()
    materiality: Materiality | None = None
    spec: Spec | None = field(default=None, compare=False)
    real: str = ""

    @property
    def misread(self) -> tuple[str, ...]:
        """Return the channels that seem to be recorded wrongly, each once; "the tests" and "the clock", too."""
        return tuple(dict.fromkeys(each.channel for each in self.findings))

    def __str__(self) -> str:
        """Return verdict and reason; all else is in the fields."""
        return f"{self.verdict.value}: {self.reason}"

    def improved(self, tuned: bool) -> Mapping[str, Mapping[str, float]]:
        """Return what to add to the simulator, with a little of everything if asked; empty where nothing is to be."""
        if self.verdict is Verdict.SPREAD:
            return self.tuned if tuned else {}
        return self.tuned if tuned and self.patch else self.patch

    def to_json(self) -> dict[str, Any]:
        """Return the object that ``s2r diagnose --json`` prints, as plain values."""
        own = {
            "schema": SCHEMA,
            **self.provenance,
            "verdict": self.verdict.value,
            "by_falls": self.by_falls,
            "reason": self.reason,
            "which": self.which.to_json(),
            "where": None if self.where is None else self.where.to_json(),
            "how_far": None if self.how_far is None else self.how_far.to_json(),
            "materiality": None if self.materiality is None else self.materiality.to_json(),
            "left": [each.to_json() for each in self.left],
            "patch": {name: dict(values) for name, values in self.patch.items()},
            "tuned": {name: dict(values) for name, values in self.tuned.items()},
            "assumptions": list(self.assumptions),
            "notes": list(self.notes),
            "findings": [each.to_json() for each in self.findings],
            "misread": list(self.misread),
        }
        return own if self.spec is None else own | upper("report.results").added(self)
