"""A blind check of the diagnosis, in two steps with a commit between them.

    python -m benchmarks.blind.check freeze emps --cases 120 --folder /tmp/blind
    git add benchmarks/blind/results && git commit          # the manifest, before anything is opened
    python -m benchmarks.blind.check open emps --folder /tmp/blind

The first makes twins with withheld causes (another code path than the catalogue's,
seeded by the operating system), seals their labels, diagnoses every case from its logs
and keeps the manifest of the answers in ``results/<set>_manifest.json``. The second
holds everything against the manifest, opens the labels and keeps the scores and every
case's answer in ``results/<set>_scores.json``. Nothing here was measured on a robot.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.blind.development import axes
from benchmarks.blind.outsiders.generate import MACHINES as OUTSIDERS
from benchmarks.blind.scoring import Scored, scores

ROOT = Path(__file__).parents[2]
RESULTS = Path(__file__).parent / "results"
SETS = {
    "emps": (("benchmarks.blind.emps.generate",), "emps"),
    "a1": (("benchmarks.blind.a1.generate",), "sim"),
} | {name: (("benchmarks.blind.outsiders.generate", name), name) for name in OUTSIDERS}
"""Set → what makes it, and its simulator."""


def offered(name: str) -> dict[str, str]:
    """Return the environment in which a set's simulator is offered: one of a set's own lies beside its machine."""
    own = Path(__file__).parent / name / "simulator"
    if not own.exists():
        return dict(os.environ)
    before = os.environ.get("PYTHONPATH")
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (str(own), before)))}


def run(name: str, *words: object) -> str:
    done = subprocess.run(
        [sys.executable, "-m", *map(str, words)],
        cwd=ROOT,
        env=offered(name),
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return done.stdout.strip()


def freeze(name: str, cases: int, folder: Path, workers: int) -> None:
    generator, simulator = SETS[name]
    made = folder / name
    if not made.exists():
        # Nothing is scored on the generator's further rollouts: a diagnosis holds out some of its own.
        spread = ("--workers", workers) if name == "a1" else ()
        print(run(name, *generator, "--cases", cases, "--out", made, "--held-out", 0, *spread))
    if not list((made / "public").glob("*.commit")):
        sealing = (
            "seal",
            made / "public",
            "--labels",
            made / "sealed",
            "--keys",
            folder / f"{name}-keys",
        )
        print(run(name, "benchmarks.blind.protocol", *sealing))
    answers = folder / f"{name}-answers"
    begin = time.perf_counter()
    freezing = (
        "freeze",
        made / "public",
        "--answers",
        answers,
        "--sim",
        simulator,
        "--workers",
        workers,
    )
    print(run(name, "benchmarks.blind.protocol", *freezing))
    print(f"{time.perf_counter() - begin:.0f} s, bank and practice included where they were not on disk")
    RESULTS.mkdir(exist_ok=True)
    shutil.copy(answers / "manifest.json", RESULTS / f"{name}_manifest.json")


def committed(manifest: Path) -> None:
    """Refuse to open what git does not have: a set was once opened before its manifest was committed."""
    known = ["git", "ls-files", "--error-unmatch", manifest]
    same = ["git", "diff", "--quiet", "HEAD", "--", manifest]
    for command in (known, same):
        if subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode:
            raise SystemExit(f"{manifest} is not committed, or has changed since: commit it, then open")


def open_(name: str, folder: Path) -> None:
    committed(RESULTS / f"{name}_manifest.json")
    answers = folder / f"{name}-answers"
    if not (answers / "opened.json").exists():
        opening = ("open", folder / name / "public", "--keys", folder / f"{name}-keys", "--answers", answers)
        print(run(name, "benchmarks.blind.protocol", *opening))
    opened = json.loads((answers / "opened.json").read_text())
    machine = {"emps": "axis"}.get(name, name)
    cases = [
        Scored(case, label, json.loads((answers / f"{case}.json").read_text()), axes(machine))
        for case, label in sorted(opened["labels"].items())
    ]
    found = {
        "frozen": opened["frozen"],
        "opened": opened["opened"],
        "scores": scores(cases),
        "cases": {one.name: one.to_json() for one in cases},
    }
    (RESULTS / f"{name}_scores.json").write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n")
    print(json.dumps(found["scores"], indent=1, ensure_ascii=False))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("step", choices=("freeze", "open"))
    parser.add_argument("set", choices=tuple(SETS))
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    if given.step == "freeze":
        freeze(given.set, given.cases, given.folder.resolve(), given.workers)
    else:
        open_(given.set, given.folder.resolve())


if __name__ == "__main__":
    main()
