"""Score the diagnosis on fresh development cases of a machine: sizes, names, verdicts and processor time.

    python -m benchmarks.blind.development car --cases 60 --seed 4601 [--workers 1] [--write]    # or a1, axis, arm, …

Cases come from the generators of the sealed sets, with known labels. Each is diagnosed from its recorded tests of the
specification alone. Answers are kept, one file a case, in a folder named after the code, so a second call resumes.
``--answers FOLDER`` scores existing answers instead, of other code too, and ``--against FOLDER`` compares them case by
case. The first cases of a larger set are those of a smaller one.

Scores: :mod:`.scoring`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
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
from benchmarks.blind.scoring import Axes, Scored, acting_axes, paired, scores
from s2r_spec.backend import load_backend
from s2r_spec.diagnose import diagnose
from s2r_spec.spec import load_spec

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent

MACHINES = ("a1", "axis", *OUTSIDERS)
ROLLOUTS = 30
"""Definition: rollouts of a case of the A1, at the same tests in every case, so that all share one library."""
BLOCK = 20
"""Definition: cases that have the mixture's shares of kinds; sets of more have several such blocks."""
RESULTS = HERE / "results"


def simulator(machine: str) -> str:
    """Return the name of the machine's simulator, after its folder, if it has one, is on the path."""
    if machine in ("a1", "axis"):
        return "sim" if machine == "a1" else "emps"
    folder = HERE / machine / "simulator"
    if folder.exists() and str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    return machine


def spec_of(machine: str) -> Path:
    """Return the file of the specification that a machine's cases have."""
    module = {"a1": "a1.cases", "axis": "emps.cases"}.get(machine, f"{machine}.machine")
    return Path(import_module(f"benchmarks.blind.{module}").SPEC)


@cache
def axes(machine: str) -> Axes:
    """Return effect → axes of the parameters of a machine's catalogue that act alone."""
    return acting_axes(load_backend(simulator(machine)), load_spec(spec_of(machine)).space)


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
                write_case(make_case(module, rng, kinds[n]), named(n), out, spec_of(machine))
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


def load(machine: str, folder: Path, answers: Path, names: Sequence[str]) -> list[Scored]:
    """Return every case that has an answer."""
    found = []
    for name in names:
        path = answers / f"{name}.json"
        if path.exists():
            label = json.loads((folder / "sealed" / f"{name}.json").read_text())
            found.append(Scored(name, label, json.loads(path.read_text()), axes(machine)))
    return found


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
