"""What each term of the error model buys: scores of a diagnosis with one term left out.

    python -m benchmarks.blind.ablation --cases 10 --seed 6401 [--machines turtlebot quad] [--write]

Machines and cases are those of :mod:`.development`, with laws of other authors. A diagnosis from tests alone has four
terms for what a simulator does not know of a machine (`s2r_spec/diagnose/inference/prediction.py`):

    scale      s_g: a group fits worse than scatter and instruments make it
    laws       ρ: effects have other shapes, and other sizes, than in the catalogue
    shared     σ_c: even healthy machines of two authors differ
    jackknife  quantities disagree about a size

The log score is minus the mean logarithm of the probability of the true set, at least of one in a thousand.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.development import MACHINES, axes, generate, simulator
from benchmarks.blind.scoring import Scored, scores
from benchmarks.machine import describe
from s2r_spec.backend import load_backend
from s2r_spec.diagnose import diagnose
from s2r_spec.diagnose.inference import prediction
from s2r_spec.diagnose.inference.hierarchical import DEGREES
from s2r_spec.diagnose.inference.prediction import Information, Tests
from s2r_spec.spec import load_spec

RESULT = Path(__file__).parents[1] / "results" / "ablation.json"
SHOWN = (
    "must be named, and are",
    "machines with a false name",
    "exit 0, and something large is missing or false",
    "large sizes in the 90 % interval",
    "log score, known and healthy",
)


def no_scales(tests: Tests, used: Any, step: Any) -> tuple[Any, Any]:
    """Return s_g² = 1, and many degrees of freedom."""
    size = np.bincount(tests.kind, np.where(used, tests.groups.size, 0.0))
    return np.ones(size.size), DEGREES + size


WITHOUT: Mapping[str, tuple[tuple[object, str, Any], ...]] = {
    "all terms": (),
    "without scale": ((Tests, "scales", no_scales),),
    "without laws": (
        (prediction, "part_left", lambda better, worse: 1.0),
        (Information, "law_variances", lambda self, theta: np.zeros_like(theta)),
    ),
    "without shared": ((prediction, "SHARED", 0.0),),
    "without jackknife": ((Tests, "disagreement", lambda self, prior, scales: 0.0),),
}
"""Definition: row of the table → what stands in place of a term: owner, name and value."""


@contextmanager
def without(row: str) -> Iterator[None]:
    """Leave out the term of a row."""
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in WITHOUT[row]]
    for owner, name, value in WITHOUT[row]:
        setattr(owner, name, value)
    try:
        yield
    finally:
        for owner, name, value in before:
            setattr(owner, name, value)


def scored(machine: str, folder: Path, name: str) -> Scored:
    """Diagnose a case from its recorded tests."""
    case = folder / "public" / name
    backend = load_backend(simulator(machine))
    real = f"log:{case}"
    found = diagnose(
        load_spec(case / "spec.stl"), backend, real, cache=folder / "cache", where=False, passive=True
    )
    label = json.loads((folder / "sealed" / f"{name}.json").read_text())
    return Scored(name, label, found.to_json(), axes(machine))


def main() -> None:
    """Print the table, one row for each term that is left out."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--machines", nargs="*", choices=MACHINES, default=MACHINES)
    parser.add_argument("--cases", type=int, default=10)
    parser.add_argument("--seed", type=int, default=6401)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "s2r-development")
    parser.add_argument("--write", action="store_true", help=f"keep the table in {RESULT.name}")
    given = parser.parse_args()
    every: dict[str, list[Scored]] = {row: [] for row in WITHOUT}
    for machine in given.machines:
        folder = given.folder / f"{machine}-{given.seed}"
        for name in generate(machine, given.cases, given.seed, folder):
            for row, cases in every.items():
                with without(row):
                    cases.append(scored(machine, folder, name))
    table = {row: {key: scores(cases)[key] for key in SHOWN} for row, cases in every.items()}
    result = {"machines": given.machines, "cases": given.cases, "seed": given.seed, "rows": table}
    print(json.dumps(result, indent=1))
    if given.write:
        RESULT.write_text(json.dumps(result | describe(), indent=1) + "\n")


if __name__ == "__main__":
    main()
