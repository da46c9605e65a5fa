"""Scores of answers on machines with known causes: names, verdicts, sizes and probabilities.

Truth is by label, and by size: an effect of at least a quarter of typical must be named, one below an eighth must not.
Sizes are in typical sizes of the catalogue (``s2r_spec.diagnose.simulator.axes``), background included. The size of an
effect is that of its largest parameter, among those that act alone; others, such as a phase, say how it acts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from s2r_spec.backend import Backend
from s2r_spec.diagnose.simulator.axes import EffectAxis, effect_axes
from s2r_spec.diagnose.simulator.experiments import Experiment
from s2r_spec.diagnose.simulator.runs import acting_parameters
from s2r_spec.effects import catalogue_of
from s2r_spec.space import Space

MUST, MUST_NOT = 0.25, 0.125
"""Definition: size, in typical sizes, from which on an effect must be named, and below which it must not be."""
SETTLED = ("named", "no material gap")
"""Definition: the verdicts with exit code 0."""
NOTHING = ("no material gap", "no single cause")
"""Definition: verdicts that name no effect, and do not call the cause unknown."""
SMALLEST = 1e-3
"""Tolerance: smallest probability in the log score; smaller ones count as this."""

Label = Mapping[str, Any]
Answer = Mapping[str, Any]
Axes = Mapping[str, tuple[EffectAxis, ...]]
"""Effect → axes of the parameters that act alone."""


def acting_axes(backend: Backend, space: Space) -> Axes:
    """Return effect → axes of the parameters that act alone, in tests at the ends and the middle of a test space."""
    points = [space.lower + part * (space.upper - space.lower) for part in (0.0, 0.5, 1.0)]
    able = acting_parameters(backend, [Experiment.test(space.point(point)) for point in points])
    found: dict[str, tuple[EffectAxis, ...]] = {}
    for axis in effect_axes(catalogue_of(backend), able):
        if not axis.base:
            found[axis.effect] = (*found.get(axis.effect, ()), axis)
    return found


def ranked(answer: Answer) -> list[tuple[frozenset[str], float]]:
    """Return every set with its probability, most probable first, including {"none"}."""
    which = answer["which"]
    found = [(frozenset([name]), float(p)) for name, p in which["posterior"].items()]
    found += [(frozenset(pair["effects"]), float(pair["probability"])) for pair in which["pairs"]]
    return sorted(found, key=lambda item: -item[1])


def truth(label: Label) -> frozenset[str]:
    """Return the true answer."""
    if label["kind"] == "null":
        return frozenset(["none"])
    return frozenset(["unknown"]) if label["kind"] == "unknown" else frozenset(label["effects"])


@dataclass(frozen=True)
class Scored:
    """One case with its answer.

    Attributes:
        name: of the case.
        label: the truth.
        answer: the JSON object of a diagnosis, of this code or of older.
        axes: effect → axes of the parameters that act alone.
    """

    name: str
    label: Label
    answer: Answer
    axes: Axes

    @property
    def kind(self) -> str:
        """The kind of the case."""
        return str(self.label["kind"])

    @property
    def named(self) -> frozenset[str]:
        """The effects that the answer names."""
        return frozenset(self.answer["which"]["answer"])

    @property
    def exact(self) -> bool:
        """Whether the answer is the label: its effects, none, or *none of these*."""
        if self.kind == "unknown":
            return bool(self.answer["verdict"] == "none of these")
        if self.kind == "null":
            return not self.named and self.answer["verdict"] in NOTHING
        return self.named == truth(self.label)

    @property
    def coordinates(self) -> list[tuple[EffectAxis, float]]:
        """Axes and true sizes of all parameters that act alone and have a value in the label."""
        values = {**self.label.get("background", {}), **self.label["effects"]}
        return [
            (axis, axis.coordinate(values[effect][axis.parameter]))
            for effect, axes in self.axes.items()
            for axis in axes
            if axis.parameter in values.get(effect, {})
        ]

    @property
    def sizes(self) -> dict[str, float]:
        """Effect → true size: that of its largest parameter."""
        found: dict[str, float] = {}
        for axis, size in self.coordinates:
            if abs(size) >= abs(found.get(axis.effect, 0.0)):
                found[axis.effect] = size
        return found

    @property
    def by_size(self) -> bool:
        """Whether all is named that must be by its size, and nothing that must not."""
        must = {effect for effect, size in self.sizes.items() if abs(size) >= MUST}
        may = {effect for effect, size in self.sizes.items() if abs(size) >= MUST_NOT}
        return must <= self.named <= may

    @property
    def missed(self) -> frozenset[str]:
        """The effects that must be named, and are not."""
        return frozenset(effect for effect, size in self.sizes.items() if abs(size) >= MUST) - self.named

    @property
    def false(self) -> frozenset[str]:
        """The effects that must not be named, and are; of an unknown cause, all names."""
        if self.kind == "unknown":
            return self.named
        return self.named - {effect for effect, size in self.sizes.items() if abs(size) >= MUST_NOT}

    @property
    def surely_wrong(self) -> bool:
        """Whether the exit code is 0, although something large is missing or false."""
        missed = self.missed if self.kind != "unknown" else frozenset()
        return self.answer["verdict"] in SETTLED and bool(missed or self.false)

    @property
    def estimates(self) -> dict[str, tuple[float, float, float, float]]:
        """Parameter → true size, estimate, and both ends of its interval, where the answer has them.

        The name is the effect's, where no other of its parameters acts alone.
        """
        found, out = self.answer["which"]["parameters"], {}
        for axis, size in self.coordinates:
            one = found.get(axis.effect, {}).get(axis.parameter)
            if one is not None and None not in (one["low"], one["high"]):
                ends = sorted(axis.coordinate(one[end]) for end in ("low", "high"))
                name = axis.effect if len(self.axes[axis.effect]) == 1 else axis.name
                out[name] = (size, axis.coordinate(one["estimate"]), ends[0], ends[1])
        return out

    @property
    def log_score(self) -> float:
        """Minus the logarithm of the probability of the true set, at most that of :data:`SMALLEST`."""
        return -math.log(max(dict(ranked(self.answer)).get(truth(self.label), 0.0), SMALLEST))

    def to_json(self) -> dict[str, Any]:
        """Return what is kept of the case."""
        return {
            "kind": self.kind,
            "truth": {
                name: round(size, 3) for name, size in self.sizes.items() if name in self.label["effects"]
            }
            or sorted(self.label["effects"]),
            "answer": sorted(self.named),
            "verdict": self.answer["verdict"],
            "exact": self.exact,
            "by size": self.by_size,
            "log score": round(self.log_score, 3),
            "seconds": round(self.answer.get("seconds", math.nan), 1),
            "estimates": {
                name: [round(x, 3) for x in four]
                for name, four in self.estimates.items()
                if max(abs(four[0]), abs(four[1])) >= MUST_NOT
            },
        }


def scores(cases: Sequence[Scored]) -> dict[str, Any]:
    """Return every score of a set of cases."""
    known = [one for one in cases if one.kind in ("single", "pair", "triple")]
    closed = [one for one in cases if one.kind != "unknown"]

    def of(kind: str) -> list[Scored]:
        return [one for one in cases if one.kind == kind]

    estimates = [(effect, *four) for one in closed for effect, four in one.estimates.items()]
    errors: dict[str, list[float]] = {}
    for effect, size, estimate, _, _ in estimates:
        errors.setdefault(effect, []).append(estimate - size)
    rms = {effect: float(np.sqrt(np.mean(np.square(each)))) for effect, each in errors.items()}
    inside = [low - 1e-9 <= size <= high + 1e-9 for _, size, _, low, high in estimates]
    large = [is_in for is_in, (_, size, *_) in zip(inside, estimates, strict=True) if abs(size) >= MUST]
    seconds = [one.answer["seconds"] for one in cases if "seconds" in one.answer]
    return {
        "cases": len(cases),
        "exact, single": _share(of("single"), lambda one: one.exact),
        "exact, pair": _share(of("pair"), lambda one: one.exact),
        "exact, triple": _share(of("triple"), lambda one: one.exact),
        "in the answered set, known": _share(
            known, lambda one: truth(one.label) <= set(one.answer["which"]["set"])
        ),
        "unknown: none of these": _share(of("unknown"), lambda one: one.exact),
        "unknown: nothing named": _share(of("unknown"), lambda one: not one.named),
        "healthy: nothing named": _share(of("null"), lambda one: not one.named),
        "healthy: no gap": _share(of("null"), lambda one: one.exact),
        "right by size, known and healthy": _share(closed, lambda one: one.by_size),
        "must be named, and are": _effects(closed, lambda size: size >= MUST, True),
        "must not be named, and are not": _effects(closed, lambda size: size < MUST_NOT, False),
        "machines with a false name": _share(cases, lambda one: bool(one.false)),
        "exit 0, and something large is missing or false": _share(cases, lambda one: one.surely_wrong),
        "large sizes in the 90 % interval": f"{sum(large)} of {len(large)}",
        "log score, known and healthy": _mean([one.log_score for one in closed]),
        "size error, rms, median over effects": _rounded(np.median(list(rms.values())) if rms else None),
        "size error, rms, worst effect": _rounded(max(rms.values(), default=None)),
        "size error by effect": {effect: _rounded(each) for effect, each in sorted(rms.items())},
        "sizes": len(estimates),
        "in the 90 % interval": _rounded(np.mean(inside) if inside else None),
        "seconds of processor, median": _rounded(np.median(seconds) if seconds else None),
        "seconds of processor, most": _rounded(max(seconds, default=None)),
        "seconds of its stages, median": _stages(cases),
    }


def _stages(cases: Sequence[Scored]) -> dict[str, float | None]:
    found: dict[str, list[float]] = {}
    for one in cases:
        for stage, seconds in one.answer.get("stages", {}).items():
            found.setdefault(stage, []).append(seconds)
    return {stage: _rounded(np.median(each)) for stage, each in found.items()}


def _share(cases: Sequence[Scored], right: Callable[[Scored], bool]) -> str:
    return f"{sum(map(right, cases))} of {len(cases)}"


def _effects(cases: Sequence[Scored], which: Callable[[float], bool], named: bool) -> str:
    right = [(e in one.named) is named for one in cases for e, size in one.sizes.items() if which(abs(size))]
    return f"{sum(right)} of {len(right)}"


def _mean(values: Sequence[float]) -> float | None:
    return _rounded(np.mean(values)) if values else None


def _rounded(value: Any) -> float | None:
    return None if value is None else round(float(value), 4)


def paired(first: Sequence[Scored], second: Sequence[Scored]) -> dict[str, Any]:
    """Return how the first answers do against the second on the cases that both have."""
    others = {one.name: one for one in second}
    pairs = [(one, others[one.name]) for one in first if one.name in others]
    gain = [b.log_score - a.log_score for a, b in pairs if a.kind != "unknown"]
    error = float(np.std(gain, ddof=1) / math.sqrt(len(gain))) if len(gain) > 1 else None
    return {
        "cases": len(pairs),
        "log score gained, mean": _mean(gain),
        "its standard error": _rounded(error),
        "only the first right, by label": [a.name for a, b in pairs if a.exact and not b.exact],
        "only the second right, by label": [a.name for a, b in pairs if b.exact and not a.exact],
    }
