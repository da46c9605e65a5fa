"""The scores of sixty Go1 machines: what is frozen of an answer, when it is right, and how many are.

**Right** is an answer that names every visible cause (:mod:`.isolability`), and nothing that is none; for an unmodelled
cause, one that names nothing and says *none of these*. An answer names a mistake by its full words, and an effect by
its name. :mod:`.sixty` makes and answers the machines.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.scoring import MUST, SETTLED, Axes, Scored, acting_axes, scores
from benchmarks.machine import describe
from benchmarks.robots.go1 import Mistake
from benchmarks.robots.machines import MISTAKES, is_checked, is_named
from s2r_spec.backend import Backend
from s2r_spec.spec import load_spec

RESULT = Path(__file__).parents[1] / "results" / "go1_sixty.json"
KEPT = (
    "verdict", "rule", "reason", "exit_code", "rollouts", "held_out", "model_hash", "misfit", "loop", "findings",
    "named", "possible", "checked", "replayed", "seconds", "step of the A1",
)  # fmt: skip
"""Definition: what is frozen of an answer, beside :data:`WHICH`."""
WHICH = ("answer", "set", "status", "membership", "presence", "posterior", "pairs")
"""Definition: what is frozen of the effects, beside the estimates."""


def frozen(found: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is frozen of an answer; numbers have four digits."""
    which = found["which"]
    ends = ("estimate", "low", "high", "half_width", "at_end")
    sizes = {
        effect: {name: {end: one.get(end) for end in ends} for name, one in each.items()}
        for effect, each in which["parameters"].items()
    }
    kept = {name: found[name] for name in KEPT if name in found}
    own = {name: which[name] for name in WHICH if name in which}
    return dict(_short({**kept, "which": {**own, "parameters": sizes}}))


def _short(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.4g}")
    if isinstance(value, Mapping):
        return {name: _short(each) for name, each in value.items()}
    return [_short(each) for each in value] if isinstance(value, list) else value


@dataclass(frozen=True)
class Judged:
    """A machine with its answer, and whether it is right."""

    name: str
    label: Mapping[str, Any]
    answer: Mapping[str, Any]

    @property
    def kind(self) -> str:
        """The kind of the machine."""
        return str(self.label["kind"])

    @property
    def mistake(self) -> Mistake | None:
        """The mistake of its loop."""
        return next((one for one in MISTAKES if one.name == self.label["mistake"]), None)

    @property
    def causes(self) -> frozenset[str]:
        """Its causes that an answer can name."""
        return frozenset([*self.label["effects"], *([self.mistake.name] if self.mistake else [])])

    @property
    def visible(self) -> frozenset[str]:
        """Its visible causes, unmodelled ones included."""
        return frozenset(self.label["visible"])

    def said(self, what: str) -> frozenset[str]:
        """Return the causes that are named, or possible; the true mistake by its name, others in words."""
        own, found = self.mistake, self.answer[what]
        words = [own.name if own and is_named([one], own) else one for one in found["mistakes"]]
        return frozenset([*found["effects"], *words])

    @property
    def named(self) -> frozenset[str]:
        """The causes that are named."""
        return self.said("named")

    @property
    def false(self) -> frozenset[str]:
        """The names that are no cause."""
        return self.named - self.causes

    @property
    def right(self) -> bool:
        """Whether all visible causes are named, and nothing false; see the module."""
        if self.kind == "unknown" and self.visible:
            return not self.named and self.answer["verdict"] == "none of these"
        return not self.false and self.visible <= self.named

    @property
    def partly(self) -> bool:
        """Whether it is not right, but all causes are among those named and possible."""
        return bool(not self.right and self.causes and self.causes <= self.named | self.said("possible"))

    @property
    def ruled_out(self) -> frozenset[str]:
        """The visible effects that are ruled out."""
        status = self.answer["which"]["status"]
        return frozenset(one for one in self.causes & self.visible if status.get(one) == "ruled out")

    @property
    def surely_wrong(self) -> bool:
        """Whether exit code 0 leaves out a visible cause that breaks the requirement, or names a false one."""
        missing = (self.visible & {*self.label["breaks the requirement"]}) - self.named
        return self.answer["verdict"] in SETTLED and bool(missing or self.false)

    def scored(self, axes: Axes) -> Scored:
        """Return the machine for the scores of effects alone."""
        kind = {"interface": "null", "physics": "single", "pair": "single", "nothing": "null"}
        label = {**self.label, "kind": kind.get(self.kind, self.kind)}
        if self.kind == "unknown":
            label["effects"] = {}
        nominal = {effect: {axis.parameter: axis.nominal for axis in own} for effect, own in axes.items()}
        label["background"] = {e: own | self.label["background"].get(e, {}) for e, own in nominal.items()}
        return Scored(self.name, label, self.answer, axes)

    def to_json(self) -> dict[str, Any]:
        """Return what is kept of the machine."""
        return {
            "kind": self.kind,
            "causes": sorted(self.causes) or [one for one in [self.label["unmodelled"]] if one],
            "effects": self.label["effects"],
            "visible": sorted(self.visible),
            "breaks the requirement": self.label["breaks the requirement"],
            "verdict": self.answer["verdict"],
            "rule": self.answer["rule"],
            "named": sorted(self.named),
            "possible": sorted(self.said("possible") - self.named),
            "right": self.right,
            "partly": self.partly,
            "false": sorted(self.false),
            "ruled out": sorted(self.ruled_out),
            "exit 0, and wrong": self.surely_wrong,
            "seconds": self.answer["seconds"],
        }


def counts(cases: Sequence[Judged], axes: Axes) -> dict[str, Any]:
    """Return all counts of the study."""
    kinds = {
        kind: [one for one in cases if one.kind == kind]
        for kind in ("interface", "physics", "pair", "unknown", "nothing")
    }

    def share(every: Sequence[bool]) -> str:
        return f"{sum(every)} of {len(every)}"

    def each(what: str) -> dict[str, str]:
        return {kind: share([bool(getattr(one, what)) for one in own]) for kind, own in kinds.items()}

    loops = [one for one in cases if one.kind == "interface"]
    silent = [one for one in cases if one.mistake is None]
    alone = [*kinds["interface"], *kinds["physics"]]
    sizes = [
        low - 1e-9 <= size <= high + 1e-9
        for one in (*kinds["physics"], *kinds["pair"])
        for name, (size, _, low, high) in one.scored(axes).estimates.items()
        if name.partition(".")[0] in one.label["effects"] and abs(size) >= MUST
    ]
    named = [
        low - 1e-9 <= size <= high + 1e-9
        for one in (*kinds["physics"], *kinds["pair"])
        for name, (size, _, low, high) in one.scored(axes).estimates.items()
        if name.partition(".")[0] in one.named & {*one.label["effects"]} and abs(size) >= MUST
    ]
    effects = [one.scored(axes) for one in cases if one.kind != "unknown"]
    return {
        "right": each("right"),
        "right, single causes": share([one.right for one in alone]),
        "right, and the verdict is named": {
            kind: share([one.right and one.answer["verdict"] == "named" for one in own])
            for kind, own in kinds.items()
        },
        "visible causes": share([one in case.visible for case in cases for one in _all(case)]),
        "not right, but all causes are named or possible": each("partly"),
        "a false name": each("false"),
        "an effect named for a mistake alone": share(
            [bool(one.answer["named"]["effects"]) for one in kinds["interface"]]
        ),
        "pairs: both named, and nothing else": share([one.named == one.causes for one in kinds["pair"]]),
        "unknown: nothing named": share([not one.named for one in kinds["unknown"]]),
        "a visible effect ruled out": each("ruled_out"),
        "exit 0, and wrong": each("surely_wrong"),
        "true sizes of the effects in the 90 % interval": share(sizes),
        "true sizes of the named effects in the 90 % interval": share(named),
        "all sizes in the 90 % interval": scores(effects)["in the 90 % interval"],
        "with obs, action and target": {
            "mistakes, by the check": share([is_checked(x.answer["checked"], x.mistake) for x in loops]),
            "mistakes, by the replay": share([is_named(x.answer["replayed"], x.mistake) for x in loops]),
            "no mistake, by the check": share([is_checked(x.answer["checked"], None) for x in silent]),
            "no mistake, by the replay": share([is_named(x.answer["replayed"], None) for x in silent]),
        },
        "seconds of processor, median and most": [
            round(float(pick([one.answer["seconds"] for one in cases])), 1) for pick in (np.median, max)
        ],
        "step of the A1 [µs], median": round(
            float(np.median([one.answer["step of the A1"] for one in cases])), 1
        ),
    }


def _all(case: Judged) -> Iterator[str]:
    yield from case.causes
    if case.label["unmodelled"]:
        yield case.label["unmodelled"]


def score(folder: Path, robot: Backend, write: bool) -> None:
    """Open the labels, and print and count what is right."""
    axes = acting_axes(robot, load_spec(folder / "walk.stl").space)
    cases = []
    for path in sorted((folder / "answers").glob("*.json")):
        label, found = (json.loads((folder / of / path.name).read_text()) for of in ("labels", "answers"))
        cases.append(Judged(path.stem, label, frozen(found)))
        print(path.stem, json.dumps(cases[-1].to_json(), ensure_ascii=False), flush=True)
    every = counts(cases, axes)
    print(json.dumps(every, indent=1, ensure_ascii=False))
    if write:
        result = {"seed": json.loads((folder / "seed.json").read_text()), **describe("mujoco"), **every}
        result["cases"] = {one.name: one.to_json() for one in cases}
        RESULT.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n")
