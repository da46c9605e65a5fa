"""Make a set of blind cases of the axis: public logs, and labels apart.

Run: python -m benchmarks.blind.emps.generate --cases 200 --out FOLDER [--seed N]

FOLDER/public/<id>/ is a folder of recorded rollouts with its spec, for ``s2r``;
FOLDER/sealed/<id>.json is its label, and FOLDER/sealed/<id>/ further rollouts for
scoring. Without --seed nobody, not even the author of this file, knows the set
before it is opened.
"""

from __future__ import annotations

import argparse
import csv
import json
import secrets
import shutil
import sys
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from benchmarks.blind.emps.cases import KINDS, MIX, SPEC, CaseKind, Rollouts, plan, realise
from s2r_spec import logs
from s2r_spec.spec import load_spec

BUDGETS = (20, 30, 60)
BATCH = 10
"""Cases that run side by side."""


class Written(Protocol):
    """What is written of a case, of this machine or of another."""

    @property
    def rollouts(self) -> Rollouts: ...

    @property
    def held_out(self) -> Rollouts: ...

    @property
    def label(self) -> dict[str, Any]: ...


def kinds_of(rng: np.random.Generator, count: int) -> list[CaseKind]:
    """Return the kinds of so many cases in the mixture's shares, shuffled."""
    ends = np.round(np.cumsum([MIX[kind] for kind in KINDS]) * count).astype(int)
    each = np.diff(ends, prepend=0)
    kinds = [kind for kind, number in zip(KINDS, each, strict=True) for _ in range(number)]
    return [kinds[int(k)] for k in rng.permutation(count)]


def write_folder(rollouts: Rollouts, folder: Path, spec: Path = SPEC) -> None:
    """Write rollouts as ``log:FOLDER`` reads them."""
    folder.mkdir(parents=True)
    units = load_spec(spec).space.units
    with (folder / "rollouts.csv").open("w", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["id", *(f"{name} [{unit}]" for name, unit in units.items())])
        for k, (test, trace) in enumerate(rollouts):
            logs.write(trace, folder / f"run-{k:02d}.npz")
            table.writerow([f"run-{k:02d}", *(test[name] for name in units)])


def write_case(case: Written, name: str, out: Path, spec: Path = SPEC) -> None:
    """Write what is public and what is not."""
    write_folder(case.rollouts, out / "public" / name, spec)
    shutil.copy(spec, out / "public" / name / "spec.stl")
    if case.held_out:
        write_folder(case.held_out, out / "sealed" / name, spec)
    (out / "sealed").mkdir(exist_ok=True)
    (out / "sealed" / f"{name}.json").write_text(json.dumps({"id": name, **case.label}, indent=1) + "\n")


def asked(parser: argparse.ArgumentParser) -> tuple[argparse.Namespace, np.random.Generator]:
    """Return what the command line asks for, of any machine, and the random numbers of the set."""
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, help="seed of a set that can be made again; random by default")
    parser.add_argument("--held-out", type=int, default=20, help="further rollouts of each case, for scoring")
    arguments = parser.parse_args()
    if arguments.out.exists() and any(arguments.out.iterdir()):
        parser.error(f"{arguments.out} is not empty; give a new folder for each set")
    seed = secrets.randbits(128) if arguments.seed is None else arguments.seed
    return arguments, np.random.default_rng(seed)


def main() -> None:
    arguments, rng = asked(argparse.ArgumentParser(description=__doc__.split("\n")[0]))
    kinds = kinds_of(rng, arguments.cases)
    for first in range(0, len(kinds), BATCH):
        batch = kinds[first : first + BATCH]
        plans = [plan(rng, kind, int(rng.choice(BUDGETS)), arguments.held_out) for kind in batch]
        for case in realise(plans):
            write_case(case, rng.bytes(6).hex(), arguments.out)
        print(f"{min(first + BATCH, len(kinds))} of {len(kinds)} cases", file=sys.stderr)


if __name__ == "__main__":
    main()
