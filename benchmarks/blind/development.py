"""Score the diagnosis on fresh development cases of a machine: sizes, names, verdicts and processor time.

    python -m benchmarks.blind.development car --cases 60 --seed 4601 [--workers 1] [--write]    # or a1, axis, arm, …

Cases come from the generators of the sealed sets, with known labels. Each is diagnosed from its recorded tests of the
specification alone. Answers are kept, one file a case, in a folder named after the code, so a second call resumes.
``--answers FOLDER`` scores existing answers instead, of other code too, and ``--against FOLDER`` compares them case by
case. The first cases of a larger set are those of a smaller one.

Truth is by label, and by size: an effect of at least a quarter of typical must be named, one below an eighth must not.
Sizes are in typical sizes of the catalogue (``s2r_spec.diagnose.simulator.axes``), background included. The size of an
effect is its first parameter; others, such as a phase, say how it acts.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.a1 import cases as a1
from benchmarks.blind.a1.generate import write_case as write_a1_case
from benchmarks.blind.emps.cases import plan, realise
from benchmarks.blind.emps.generate import BATCH, BUDGETS, kinds_of, write_case
from benchmarks.blind.outsiders.cases import make_case
from benchmarks.blind.outsiders.generate import MACHINES as OUTSIDERS
from benchmarks.blind.protocol.score import NOTHING, SMALLEST, ranked, truth
from s2r_spec.backend import load_backend
from s2r_spec.diagnose import diagnose
from s2r_spec.diagnose.simulator.axes import EffectAxis, effect_axis
from s2r_spec.effects import catalogue_of
from s2r_spec.spec import load_spec

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent

MACHINES = ("a1", "axis", *OUTSIDERS)
ROLLOUTS = 30
"""Definition: rollouts of a case of the A1, at the same tests in every case, so that all share one library."""
BLOCK = 20
"""Definition: cases that have the mixture's shares of kinds; sets of more have several such blocks."""
MUST, MUST_NOT = 0.25, 0.125
"""Definition: size, in typical sizes, from which on an effect must be named, and below which it must not be."""
SETTLED = ("named", "no material gap")
"""Definition: the verdicts with exit code 0."""
RESULTS = HERE / "results"

Label = Mapping[str, Any]
Answer = Mapping[str, Any]


def simulator(machine: str) -> str:
    """Return the name of the machine's simulator, after its folder, if it has one, is on the path."""
    if machine in ("a1", "axis"):
        return "sim" if machine == "a1" else "emps"
    folder = HERE / machine / "simulator"
    if folder.exists() and str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    return machine


@cache
def axes(machine: str) -> dict[str, EffectAxis]:
    """Return effect → axis of its first parameter."""
    catalogue = catalogue_of(load_backend(simulator(machine)))
    return {effect.name: effect_axis(effect, effect.parameters[0]) for effect in catalogue}


def generate(machine: str, count: int, seed: int, out: Path) -> list[str]:
    """Write the cases that are not in the folder yet; return the names of all."""
    blocks = [kinds_of(np.random.default_rng([seed, block]), BLOCK) for block in range(-(-count // BLOCK))]
    kinds = [kind for block in blocks for kind in block][:count]
    missing = [n for n in range(count) if not (out / "sealed" / f"{named(n)}.json").exists()]
    for first in range(0, len(missing), BATCH):
        batch = missing[first : first + BATCH]
        streams = [np.random.default_rng([seed, number, 1]) for number in batch]
        if machine == "axis":
            # The axis runs many cases side by side, which takes little more time than one.
            plans = [
                plan(rng, kinds[n], int(rng.choice(BUDGETS))) for n, rng in zip(batch, streams, strict=True)
            ]
            for n, case in zip(batch, realise(plans), strict=True):
                write_case(case, named(n), out)
        elif machine == "a1":
            commands = a1.tests(np.random.default_rng(seed), ROLLOUTS)
            for n, rng in zip(batch, streams, strict=True):
                own = a1.make_case(rng, kinds[n], ROLLOUTS, commands=commands)
                write_a1_case(out, named(n), own)
        else:
            module = import_module(f"benchmarks.blind.{machine}.machine")
            for n, rng in zip(batch, streams, strict=True):
                write_case(make_case(module, rng, kinds[n]), named(n), out, Path(module.SPEC))
    return [named(number) for number in range(count)]


def named(number: int) -> str:
    """Return the name of a case."""
    return f"case-{number:03d}"


class Stages:
    """Processor time of the stages of a diagnosis; a progress function."""

    def __init__(self) -> None:
        self.began = [("before", time.process_time())]

    def __call__(self, stage: str, done: int, of: int) -> None:
        if stage != self.began[-1][0]:
            self.began.append((stage, time.process_time()))

    def seconds(self) -> dict[str, float]:
        """Return stage → seconds, up to now."""
        ends = [*(begin for _, begin in self.began[1:]), time.process_time()]
        total: dict[str, float] = {}
        for (stage, begin), end in zip(self.began, ends, strict=True):
            total[stage] = total.get(stage, 0.0) + end - begin
        return total


def answered(machine: str, folder: Path, answers: Path, name: str) -> str:
    """Diagnose one case, unless its answer is there; return its name."""
    path = answers / f"{name}.json"
    if not path.exists():
        case, stages = folder / "public" / name, Stages()
        found = diagnose(
            load_spec(case / "spec.stl"),
            load_backend(simulator(machine)),
            f"log:{case}",
            cache=folder / "cache",
            where=False,
            passive=True,
            progress=stages,
        ).to_json()
        seconds = stages.seconds()
        part = path.with_suffix(".part")
        part.write_text(
            json.dumps({**found, "seconds": sum(seconds.values()), "stages": seconds}, default=float)
        )
        part.rename(path)
    return name


def code_hash() -> str:
    """Return a hash of the diagnosis' source."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "s2r_spec" / "diagnose").rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


@dataclass(frozen=True)
class Scored:
    """One case with its answer.

    Attributes:
        name: of the case.
        label: the truth.
        answer: the JSON object of a diagnosis, of this code or of older.
        axes: effect → axis of its first parameter.
    """

    name: str
    label: Label
    answer: Answer
    axes: Mapping[str, EffectAxis]

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
    def sizes(self) -> dict[str, float]:
        """Effect → true size, for all effects of the catalogue with a value in the label."""
        values = {**self.label.get("background", {}), **self.label["effects"]}
        return {
            effect: axis.coordinate(values[effect][axis.parameter])
            for effect, axis in self.axes.items()
            if effect in values
        }

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
        """Effect → true size, estimate, and both ends of its interval; older answers lack effects without a name."""
        found, out = self.answer["which"]["parameters"], {}
        for effect, size in self.sizes.items():
            axis = self.axes[effect]
            one = found.get(effect, {}).get(axis.parameter)
            if one is not None and None not in (one["low"], one["high"]):
                ends = sorted(axis.coordinate(one[end]) for end in ("low", "high"))
                out[effect] = (size, axis.coordinate(one["estimate"]), ends[0], ends[1])
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


def load(machine: str, folder: Path, answers: Path, names: Sequence[str]) -> list[Scored]:
    """Return every case that has an answer."""
    found = []
    for name in names:
        path = answers / f"{name}.json"
        if path.exists():
            label = json.loads((folder / "sealed" / f"{name}.json").read_text())
            found.append(Scored(name, label, json.loads(path.read_text()), axes(machine)))
    return found


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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("machine", choices=MACHINES)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=4601)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "s2r-development")
    parser.add_argument("--answers", type=Path, help="score these answers instead of diagnosing")
    parser.add_argument("--against", type=Path, help="compare with these answers")
    parser.add_argument("--write", action="store_true", help="keep scores and cases in results/")
    given = parser.parse_args()
    folder = given.folder / f"{given.machine}-{given.seed}"
    names = generate(given.machine, given.cases, given.seed, folder)
    answers = given.answers or folder / f"answers-{code_hash()}"
    if given.answers is None:
        answers.mkdir(exist_ok=True)
        job = partial(answered, given.machine, folder, answers)
        # A pool of one worker has the same processor time as one of several.
        with ProcessPoolExecutor(given.workers) as pool:
            for number, name in enumerate(pool.map(job, names)):
                (one,) = load(given.machine, folder, answers, [name])
                print(number + 1, "of", len(names), json.dumps(one.to_json()), file=sys.stderr, flush=True)
    cases = load(given.machine, folder, answers, names)
    result: dict[str, Any] = {"machine": given.machine, "seed": given.seed, "scores": scores(cases)}
    if given.against:
        others = load(given.machine, folder, given.against, names)
        result |= {"against": scores(others), "paired": paired(cases, others)}
    print(json.dumps(result, indent=1))
    if given.write:
        kept = result | {"cases": {one.name: one.to_json() for one in cases}}
        path = RESULTS / f"development_{given.machine}.json"
        path.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
