"""What every look at opened cases begins with: which set, where its public data are, and a pool."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

sys.path.insert(0, str(Path(__file__).parents[1]))
from machine import describe

from s2r_spec.backend import load_backend
from s2r_spec.diagnose.data.rollouts import recorded
from s2r_spec.diagnose.data.split import split
from s2r_spec.diagnose.simulate import Bench
from s2r_spec.spec import load_spec
from s2r_spec.trace import Trace

RESULTS = Path(__file__).parent / "results"
ROOT = Path(__file__).parents[2]
SETS = {"emps": ("specs/emps_tracking.stl", "emps"), "a1": ("specs/a1_velocity.stl", "sim")}
"""Set → its spec and its simulator."""

Found = TypeVar("Found")
Rollouts = list[tuple[dict[str, float], Trace]]


@dataclass(frozen=True)
class Opened:
    """A set whose labels are open.

    Attributes:
        name: of the set.
        folder: of ``check.py freeze``.
        workers: processes.
    """

    name: str
    folder: Path
    workers: int

    @classmethod
    def asked_for(cls, words: str) -> Opened:
        """Read the command line; ``words`` say what the command does."""
        parser = argparse.ArgumentParser(description=words.splitlines()[0])
        parser.add_argument("set", choices=tuple(SETS))
        parser.add_argument("folder", type=Path, help="folder of `check.py freeze`, after `open`")
        parser.add_argument("--workers", type=int, default=1)
        given = parser.parse_args()
        return cls(given.set, given.folder, given.workers)

    @property
    def answers(self) -> Path:
        """Return the folder of the frozen answers."""
        return self.folder / f"{self.name}-answers"

    def cases(self) -> dict[str, dict[str, Any]]:
        """Return case → its label and the frozen answer that is in this folder."""
        return kept(self.answers)

    def over(self, ask: Callable[..., Found], names: Iterable[str], *more: Sequence[Any]) -> list[Found]:
        """Return ``ask(public folder, set, ...)`` of every case, in order."""
        folders = [self.folder / self.name / "public" / name for name in names]
        with ProcessPoolExecutor(self.workers, mp_context=get_context("spawn")) as pool:
            return list(pool.map(ask, folders, [self.name] * len(folders), *more))

    def write(self, what: str, found: dict[str, Any], *packages: str) -> None:
        """Write results/<set>_<what>.json, with the machine."""
        text = json.dumps({"machine": describe(*packages), **found}, indent=1, ensure_ascii=False)
        (RESULTS / f"{self.name}_{what}.json").write_text(text + "\n")


def kept(answers: Path) -> dict[str, dict[str, Any]]:
    """Return of every opened case what is kept of it: its label and its frozen answer."""
    cases = {}
    for case, label in json.loads((answers / "opened.json").read_text())["labels"].items():
        answer = json.loads((answers / f"{case}.json").read_text())
        which = answer["which"]
        cases[case] = {
            "label": label,
            "verdict": answer["verdict"],
            "answer": which["answer"],
            "set": which["set"],
            "posterior": {k: p for k, p in which["posterior"].items() if p >= 0.05},
            "pairs": which["pairs"][:3],
            "parameters": which["parameters"],
            "status": which.get("status"),
            "how_far": answer["how_far"],
            "left": answer.get("left", [])[:1],
            "rollouts": answer["rollouts"],
        }
    return cases


@cache
def bench(name: str) -> Bench:
    """Return a set's simulator, set up."""
    path, simulator = SETS[name]
    spec = load_spec(ROOT / path)
    return Bench.of(spec, spec.requirements[0], simulator)


def held_out(of: Bench, case: Path) -> Rollouts:
    """Return the rollouts of a case that a diagnosis holds out."""
    made_with = load_spec(case / "spec.stl").hash
    if made_with != of.spec.hash:
        raise SystemExit(f"{case} was made with another spec, {made_with}; use the code of that time")
    return list(split(recorded(of, load_backend(f"log:{case}")), 0).held_out)
